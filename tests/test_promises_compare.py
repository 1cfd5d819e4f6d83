"""What the project promises of scripts/compare.py and scripts/correctness.py."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from env_cases import random_bank
from script_cases import run_and_stop

from amusic_gym.estimation.settings import SICSettings

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def banks(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    folder = tmp_path_factory.mktemp("banks")
    first = random_bank(1, queries=60, name="first").save(folder / "first")
    return first, random_bank(2, queries=30, name="second").save(folder / "second")


def rows(out: Path) -> dict[str, bytes]:
    """What is finished, file by file."""
    return {
        path.name: path.read_bytes()
        for kind in ("rows/*.json", "traces/*.csv")
        for path in out.glob(kind)
    }


def results(out: Path) -> dict:
    return json.loads((out / "results.json").read_text("utf-8"))


@pytest.mark.parametrize(
    ("number", "status"),
    [
        *((signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129)),
        (signal.SIGKILL, -signal.SIGKILL),
    ],
)
def test_34_35_52_a_stopped_comparison_keeps_and_skips_what_is_finished(
    run_script, tmp_path, banks, number, status
):
    out = tmp_path / "out"
    policies = ["music", "amusic", "random:0.3", "cascade", "oracle"]
    arguments = ["--bank", banks[0], "--policy", *policies, "--out"]
    stopped = run_and_stop(number, 3, "compare.py", *arguments, out)
    assert stopped.returncode == status
    assert stopped.stdout.splitlines()[2].startswith("[3/5] first random:0.3: auc ")
    if number != signal.SIGKILL:
        assert stopped.stderr == "interrupted; what was finished is kept\n"
    kept = rows(out)
    assert len(kept) == 6  # three rows, three traces
    assert not (out / "results.json").exists()

    again = run_script("compare.py", *arguments, out)
    assert again.returncode == 0, again.stderr
    lines = again.stdout.splitlines()[:5]
    assert [line.endswith("(was finished)") for line in lines] == [True] * 3 + [False] * 2
    assert kept.items() <= rows(out).items()
    whole = run_script("compare.py", *arguments, tmp_path / "whole")
    assert "(was finished)" not in whole.stdout
    assert results(out) == results(tmp_path / "whole")
    assert rows(out) == rows(tmp_path / "whole")


def test_compare_writes_table_results_traces_and_figures(run_script, tmp_path, banks):
    done = run_script(
        "compare.py",
        *("--bank", banks[0], "--bank", banks[1], "--policy", "amusic", "--policy", "raw:T0"),
        *("cascade", "--all-subsets", "--statistic", "mean", "--costs", "runs"),
        *("--seed", 3, "--out", tmp_path),
    )
    assert (done.returncode, done.stderr) == (0, "")
    policies = ["amusic", "raw:T0", "cascade", "single:T0", "single:T1", "single:T2"]
    policies += ["subset:T0+T1", "subset:T0+T2", "subset:T1+T2", "music"]
    stored = results(tmp_path)
    assert [row["policy"] for row in stored["rows"]] == policies * 2
    assert [row["policy"] for row in stored["mean"]] == policies
    assert {row["statistic"] for row in stored["rows"]} == {"mean", "none"}
    assert {row["costs"] for row in stored["rows"]} == {"runs"}
    assert all(row["compute_weight"] is None for row in stored["rows"])
    assert len(list(tmp_path.glob("traces/*.csv"))) == 20
    assert len(list(tmp_path.glob("*.png"))) == 8
    assert "second (30 frames, runs costs)" in done.stdout
    assert "mean over 2 banks" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--policy", "amusci"], "unknown policy 'amusci': did you mean 'amusic'?"),
        (["--policy", "subset:T0+T9"], "unknown technique 'T9'"),
        (
            ["--policy", "periodic:5/T0/T1/T2"],
            "is not of the form periodic:N[/A+B[/C]]; write it so",
        ),
        (["--policy", "voi:much"], "voi:much: LAMBDA is 'much'; give a number >= 0"),
        (["--policy", "random:0.5/idel"], "is not of the form random:P[/idle]; write it so"),
        (["--policy", "ppo:nowhere"], "nowhere is no run folder"),
        (["--policy", "music", "--statistic", "evidance"], "did you mean 'evidence'?"),
        (["--policy", "music", "--costs", "paper"], "the paper gives no time for technique 'T0'"),
        (["--policy", "music", "--seed", "-1"], "seed is -1; give a whole number >= 0"),
        (["--policy", "music", "--seed", "1.5"], "argument --seed: invalid int value: '1.5'"),
        (["--polcy", "music"], "did you mean '--policy'?"),
        ([], "no policy; give --policy, --all-subsets or both"),
        (["--policy", "music", "--bank", "nowhere"], "nowhere"),
    ],
)
def test_10_bad_arguments_are_one_line_and_status_2(
    run_script, tmp_path, banks, arguments, sentence
):
    out = tmp_path / "out"
    refused = run_script("compare.py", "--bank", banks[0], "--out", out, *arguments)
    assert refused.returncode == 2
    assert refused.stdout == ""
    assert refused.stderr.count("\n") == 1
    assert sentence in refused.stderr
    assert not out.exists()


def test_38_learned_selector_has_a_row_per_compute_weight_and_keeps_its_statistic(
    run_script, tmp_path, banks, trained
):
    policy = f"ppo:{trained}"
    arguments = ["--bank", banks[1], "--policy", policy, "music", "--out", tmp_path / "out"]
    done = run_script("compare.py", *arguments, "--compute-weight", 0.1, 2)
    assert (done.returncode, done.stderr) == (0, "")
    found = [
        (r["policy"], r["compute_weight"], r["statistic"])
        for r in results(tmp_path / "out")["rows"]
    ]
    assert found == [
        (policy, 0.1, "evidence"),
        (policy, 2.0, "evidence"),
        ("music", None, SICSettings.statistic),
    ]
    more = run_script("compare.py", *arguments, "--compute-weight", 2, 4)
    assert more.stdout.count("(was finished)") == 2

    refused = run_script("compare.py", *arguments, "--statistic", "mean")
    assert refused.returncode == 2
    assert "was trained with the statistic 'evidence' and takes no other" in refused.stderr
    assert refused.stderr.count("\n") == 1


def test_the_selector_that_ships_needs_no_run_folder(run_script, tmp_path, banks):
    done = run_script(
        "compare.py", "--bank", banks[1], "--policy", "ppo", "--out", tmp_path / "out"
    )
    assert (done.returncode, done.stderr) == (0, "")
    rows = results(tmp_path / "out")["rows"]
    assert {row["policy"] for row in rows} == {"ppo"}
    assert {row["statistic"] for row in rows} == {SICSettings.statistic}
    weights = [row["compute_weight"] for row in rows]
    assert len(weights) == len(set(weights)) > 1
    assert rows[0]["compute"] > rows[-1]["compute"]  # dearer runs, fewer of them


def test_what_is_turned_off_is_in_the_rows_and_a_trained_selector_refuses_it(
    run_script, tmp_path, banks
):
    words = ["--bank", banks[1], "--policy", "music", "amusic", "ppo@belief", "--no-carry"]
    words += ["--compute-weight", 1]
    done = run_script("compare.py", *words, "--out", tmp_path / "out")
    assert (done.returncode, done.stderr) == (0, "")
    rows = results(tmp_path / "out")["rows"]
    assert [(row["policy"], row["statistic"], row["carry"]) for row in rows] == [
        ("music", "evidence", False),
        ("amusic", "mean", False),
        ("ppo@belief", "belief", False),
    ]
    assert done.stdout.count("evidence, no carry") == 1
    again = run_script("compare.py", *words, "--out", tmp_path / "out", "--no-discount")
    # the paper's and the belief's know no discount
    assert again.stdout.count("(was finished)") == 2
    for option in ("--no-carry", "--no-discount"):
        words = ["--bank", banks[1], "--policy", "ppo", "--out", tmp_path / "new", option]
        refused = run_script("compare.py", *words)
        assert refused.returncode == 2
        assert f"leave out {option} or compare it apart" in refused.stderr
        assert refused.stderr.count("\n") == 1
        assert not (tmp_path / "new").exists()


def test_correctness_reports_every_technique(run_script, tmp_path, banks):
    done = run_script("correctness.py", "--bank", *banks, "--out", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    report = json.loads((tmp_path / "correctness.json").read_text("utf-8"))
    assert report["statistic"] == SICSettings.statistic
    assert [(part["bank"], part["technique"]) for part in report["techniques"]] == [
        (bank, f"T{t}") for bank in ("first", "second") for t in range(3)
    ]
    assert report["pooled"]["frames"] == 3 * (60 + 30)
    assert (tmp_path / "reliability.png").read_bytes().startswith(b"\x89PNG")
    assert "pooled" in done.stdout
    missing = run_script("correctness.py", "--bank", tmp_path / "none", "--out", tmp_path / "out")
    assert missing.returncode == 2
    assert missing.stderr.count("\n") == 1
    assert os.fspath(tmp_path / "none") in missing.stderr
