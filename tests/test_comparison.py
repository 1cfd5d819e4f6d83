"""Comparisons: rows, means, names, what is kept and what is run again, tables and figures."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import amusic_baselines
import numpy as np
import pytest
from amusic_baselines import make_policy
from comparison_cases import Lineup
from env_cases import random_bank
from rollout_cases import Cycle, assert_same

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation import figures, store
from amusic_gym.evaluation.audit import audit
from amusic_gym.evaluation.comparison import (
    SHOWN,
    Comparison,
    compare,
    distinct,
    file_stem,
    partings,
    table,
)
from amusic_gym.evaluation.contestants import Contestant, all_subsets, check_weights, contestants
from amusic_gym.evaluation.figures import draw
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.evaluation.tables import COLUMNS
from amusic_gym.extraction.code import key_of
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.imports import PACKAGE

pytestmark = pytest.mark.slow

ROW_KEYS = [
    "bank",
    "policy",
    "compute_weight",
    "statistic",
    "carry",
    "costs",
    "queries",
    "accuracy",
    "auc",
    "auc_vprbench",
    "auc_paper",
    "ptr",
    "compute",
    "seconds_per_frame",
    "reselections",
    "idle",
    "median_error",
    "lost",
    *(f"recall_at_{n}" for n in (1, 5, 10, 20)),
    "recall_at_100_precision",
]  # as other programs read them


SETTINGS = {"statistic", "carry", "discount", "seed"}


@pytest.fixture
def said() -> list[str]:
    return []


def two_banks() -> list[ScoreBank]:
    return [random_bank(1, queries=20), random_bank(2, queries=30)]


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_row_for_every_policy_weight_and_bank(tmp_path, said):
    banks = two_banks()
    lineup = Lineup("music", "weighted", "raw:T0", weights=[1.0, 3.0])
    result = compare(banks, lineup, tmp_path, report=said.append)
    named = ("bank", "policy", "compute_weight", "statistic", "carry")
    seen = [tuple(row[name] for name in named) for row in result.rows]
    assert seen == [
        (bank.name, *rest)
        for bank in banks
        for rest in [
            ("music", None, SICSettings.statistic, True),
            ("weighted", 1.0, "mean", False),
            ("weighted", 3.0, "mean", False),
            ("raw:T0", None, "none", False),
        ]
    ]
    assert [len(row) for row in result.rows] == [len(ROW_KEYS)] * 8
    assert result.rows[1]["ptr"] == pytest.approx(1 / 3)
    assert result.rows[2]["ptr"] == 1
    assert [line.split("]")[0] for line in said] == [f"[{n}/8" for n in range(1, 9)]


def test_a_policy_without_carried_candidates_says_so_and_none_without_a_choice_does(tmp_path):
    lineup = Lineup("music", "amusic", "amusic:evidence", "amusic:belief", "raw:T0")
    rows = {}
    for carry in (None, False):
        result = compare([random_bank(1)], lineup, tmp_path, carry=carry, report=len)
        rows[carry] = {row["policy"]: row for row in result.rows}
        shown = {line.split()[0]: line for line in table(result).splitlines() if line.strip()}
        for policy in ("music", "amusic:evidence"):
            assert ("evidence, no carry" in shown[policy]) == (carry is False)
        assert "carry" not in shown["amusic"] + shown["amusic:belief"]
    assert [row["carry"] for row in rows[None].values()] == [True, False, True, False, False]
    assert not any(row["carry"] for row in rows[False].values())
    assert [row["statistic"] for row in rows[False].values()][1:4] == ["mean", "evidence", "belief"]
    others = ("amusic", "amusic:belief", "raw:T0")
    assert all(rows[None][name] == rows[False][name] for name in others)


def test_what_a_statistic_has_no_use_for_is_refused(tmp_path):
    with pytest.raises(ValueError, match="carry is True, but 'belief' has no candidates"):
        compare([random_bank(1)], Lineup("music"), tmp_path, statistic="belief", carry=True)


def test_results_file_is_what_other_programs_read(tmp_path):
    result = compare(two_banks(), Lineup("music", "amusic"), tmp_path, report=len)
    stored = json.loads((tmp_path / "results.json").read_text("utf-8"))
    assert list(stored) == ["rows", "mean"]
    assert stored == {"rows": result.rows, "mean": result.mean}
    assert all(list(row) == ROW_KEYS for row in stored["rows"] + stored["mean"])
    for row in stored["mean"]:
        of_banks = [r for r in stored["rows"] if r["policy"] == row["policy"]]
        assert row["bank"] == "mean"
        assert row["auc"] == pytest.approx(np.mean([r["auc"] for r in of_banks]))


def test_traces_are_the_rollouts_and_lie_beside_the_results(tmp_path):
    bank = random_bank(4, queries=25)
    result = compare([bank], Lineup("amusic", "single:T1"), tmp_path, statistic="mean", report=len)
    context = Context.of(bank, statistic="mean")
    for trace in result.traces:
        policy = make_policy(trace.policy, context)
        assert_same(trace, rollout(policy, bank, name=trace.policy, statistic="mean"))
    names = ["bank4-amusic.csv", "bank4-single_T1.csv"]
    assert sorted(path.name for path in (tmp_path / "traces").iterdir()) == names
    with (tmp_path / "traces" / names[1]).open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file))
    assert [int(line["prediction"]) for line in lines] == result.traces[1].predictions.tolist()
    assert {line["techniques"] for line in lines} == {"T1"}


def test_what_is_finished_is_not_run_again(tmp_path, said):
    lineup = Lineup("amusic", "weighted", "raw:T0", weights=[1.0, 2.0])
    first = compare(two_banks(), lineup, tmp_path, report=len)
    assert len(lineup.runs) == 8
    before = files(tmp_path)
    again = compare(two_banks(), lineup, tmp_path, report=said.append)
    assert len(lineup.runs) == 8
    assert all(line.endswith("(was finished)") for line in said)
    assert files(tmp_path) == before
    assert again.rows == first.rows
    for one, other in zip(first.traces, again.traces, strict=True):
        assert_same(one, other)


def test_what_is_added_is_run_alone(tmp_path):
    compare(two_banks()[:1], Lineup("music"), tmp_path, report=len)
    lineup = Lineup("single:T0", "music")
    result = compare(two_banks(), lineup, tmp_path, report=len)
    assert lineup.runs == ["bank1 single:T0", "bank2 single:T0", "bank2 music"]
    fresh = compare(two_banks(), Lineup("single:T0", "music"), tmp_path / "fresh", report=len)
    assert result.rows == fresh.rows


@pytest.mark.parametrize(
    "change",
    [
        {"statistic": "mean"},
        {"carry": False},
        {"discount": False},
        {"seed": 1},
        {"version": "other weights"},
        {"banks": [random_bank(1, queries=20, levels=13)]},
        {"banks": [random_bank(1, queries=20, tolerance=1)]},
        {"banks": [random_bank(1, queries=20).with_costs("runs")]},
        {"banks": [random_bank(1, queries=20, names=["T0", "T1", "X"])]},
        {"code": "changed"},
        {"release": "9.9"},
    ],
)
def test_25_whatever_may_change_a_row_makes_it_run_again(tmp_path, monkeypatch, change):
    bank = random_bank(1, queries=20)
    compare([bank], Lineup("random:0.5"), tmp_path, report=len)
    if "code" in change:
        monkeypatch.setattr(store, "code_digest", lambda *files: "changed")
    if "release" in change:
        monkeypatch.setattr("amusic_gym.evaluation.comparison.__version__", "9.9")
    lineup = Lineup("random:0.5", version=change.get("version", ""))
    options = {key: change[key] for key in change.keys() & SETTINGS}
    compare(change.get("banks", [bank]), lineup, tmp_path, report=len, **options)
    assert len(lineup.runs) == 1


def test_bank_on_disk_is_known_by_its_content(tmp_path):
    bank = random_bank(1)
    stored = ScoreBank.load(bank.save(tmp_path / "bank"))
    other = ScoreBank.load(random_bank(2, name="bank1").save(tmp_path / "other"))
    identity = store.bank_identity
    assert identity(stored) == identity(ScoreBank.load(tmp_path / "bank"))
    assert identity(stored) != identity(other)
    assert identity(stored) != identity(stored.subset(["T0", "T1"]))
    assert identity(stored) != identity(stored.with_costs("runs"))


def test_53_a_policy_s_version_is_that_of_its_own_file_and_of_all_that_it_imports():
    folder = Path(amusic_baselines.__file__).parent
    sources = store.sources(folder / "voi.py", folder, PACKAGE)
    names = {path.name for path in sources}
    assert {"voi.py", "costs.py", "registry.py", "observation.py", "calibration.json"} <= names
    assert "cascade.py" not in names
    cascade, voi, idle = contestants(["cascade", "voi", "voi:idle"])
    assert cascade.version != voi.version == idle.version


def test_23_a_row_that_lacks_something_is_computed_again(tmp_path, said):
    bank = random_bank(1, queries=20)
    first = compare([bank], Lineup("music"), tmp_path, report=len)
    (path,) = (tmp_path / "rows").iterdir()
    content = path.read_bytes()
    body = json.loads(content)
    del body["checksum"], body["trace"]["similarity"]
    body = {"checksum": key_of(**body), **body}
    path.write_text(json.dumps(body), encoding="utf-8")
    lineup = Lineup("music")
    again = compare([bank], lineup, tmp_path, report=said.append)
    assert len(lineup.runs) == 1
    assert ["damaged" in line for line in said] == [True, False]
    assert again.rows == first.rows
    assert path.read_bytes() == content


@pytest.mark.parametrize("damage", ["truncated", "empty", "garbage", "flipped", "other"])
def test_23_damaged_row_is_noticed_and_computed_again(tmp_path, said, damage):
    bank = random_bank(1, queries=20)
    first = compare([bank], Lineup("music"), tmp_path, report=len)
    (path,) = (tmp_path / "rows").iterdir()
    content = path.read_bytes()
    at = content.index(b'"predictions": [') + len(b'"predictions": [')
    path.write_bytes(
        {
            "truncated": content[: len(content) // 2],
            "empty": b"",
            "garbage": b"\xff\x00garbage",
            "flipped": content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :],
            "other": b"[1, 2]",
        }[damage]
    )
    lineup = Lineup("music")
    again = compare([bank], lineup, tmp_path, report=said.append)
    assert len(lineup.runs) == 1
    assert f"{path} is damaged" in said[0]
    assert "computed again" in said[0]
    assert again.rows == first.rows
    assert path.read_bytes() == content


class Interrupted(Cycle):
    """Ctrl-C in the middle of a route."""

    def act(self, observation, info):
        if info["frame"][0] == 4:
            raise KeyboardInterrupt
        return super().act(observation, info)


def test_34_interrupt_keeps_what_is_finished(tmp_path):
    bank = random_bank(1, queries=20)

    def interrupted(bank):
        stop = Contestant("stop", lambda context: Interrupted())
        return [*Lineup("music", "amusic")(bank), stop, *Lineup("cascade")(bank)]

    with pytest.raises(KeyboardInterrupt):
        compare([bank], interrupted, tmp_path, report=len)
    kept = files(tmp_path)
    assert len(kept) == 4  # two rows, two traces
    lineup = Lineup("music", "amusic", "cascade")
    compare([bank], lineup, tmp_path, report=len)
    assert lineup.runs == ["bank1 cascade"]
    assert kept.items() <= files(tmp_path).items()


def test_nothing_runs_when_a_policy_is_wrong(tmp_path):
    lineup = Lineup("music", "single:T9")
    banks = two_banks()
    with pytest.raises(ValueError, match=f"bank '{banks[0].name}': unknown technique 'T9'"):
        compare(banks, lineup, tmp_path / "out", report=len)
    lacking = [banks[0], banks[1].subset(["T0"])]
    with pytest.raises(ValueError, match=f"bank '{banks[1].name}': unknown technique 'T1'"):
        compare(lacking, Lineup("single:T1"), tmp_path / "out", report=len)
    assert lineup.runs == []
    assert not (tmp_path / "out").exists()


def test_what_cannot_be_compared_is_refused(tmp_path):
    one, other = two_banks()
    with pytest.raises(ValueError, match="no score bank to compare on"):
        compare([], Lineup("music"), tmp_path)
    with pytest.raises(ValueError, match="no policy to compare"):
        compare([one], Lineup(), tmp_path)
    with pytest.raises(ValueError, match=r"different costs \(measured, runs\)"):
        compare([one, other.with_costs("runs")], Lineup("music"), tmp_path)
    with pytest.raises(ValueError, match="seed is -1; give a whole number >= 0"):
        compare([one], Lineup("music"), tmp_path, seed=-1)


def test_mean_is_over_the_policies_that_every_bank_has(tmp_path):
    one, other = random_bank(1, queries=20), random_bank(2, queries=20, names=["A", "B", "C"])

    def lineup(bank):
        return Lineup("music", f"single:{bank.techniques[0]}")(bank)

    result = compare([one, other], lineup, tmp_path, report=len)
    assert [row["policy"] for row in result.mean] == ["music"]
    rows_of_tables = table(result).partition("WARNING")[0]
    assert rows_of_tables.count("single:A") == 1
    draw(result, tmp_path / "figures")


def test_banks_of_one_name_are_numbered(tmp_path):
    banks = [random_bank(seed, queries=20, name="bank") for seed in (1, 2)]
    banks += [random_bank(3, queries=20, name=name) for name in ("", "mean", "Bank")]
    result = compare(banks, Lineup("music"), tmp_path, report=len)
    names = ["bank", "bank (2)", "bank (3)", "mean (2)", "Bank (4)"]
    assert [row["bank"] for row in result.rows] == names
    assert [bank.name for bank in banks[:2]] == ["bank", "bank"]
    assert len(list((tmp_path / "traces").iterdir())) == 5


def test_distinct_names_and_file_stems():
    assert distinct(["a", "A", "a (2)", "a"]) == ["a", "A (2)", "a (2) (2)", "a (3)"]
    assert file_stem("ppo:../run 1/x") == "ppo_.._run_1_x"
    assert file_stem("subset:A+B") == "subset_A+B"
    assert file_stem("../..") == "unnamed"
    assert len(file_stem("x" * 500)) <= 80
    assert file_stem("Straße") == "Straße"


def test_repeated_policies_and_weights_run_once(tmp_path):
    bank = random_bank(1, queries=20)
    once = Lineup("music")(bank)
    result = compare([bank], lambda bank: [*once, *once], tmp_path, report=len)
    assert len(result.rows) == 1
    assert check_weights([1, 0.5, 1.0]) == (1.0, 0.5)
    for wrong in (-1.0, float("nan"), float("inf")):
        with pytest.raises(ValueError, match="compute weight is .*; give numbers >= 0"):
            check_weights([1.0, wrong])


def test_all_subsets_of_a_bank():
    assert all_subsets(["A"]) == ["single:A"]
    assert all_subsets(["A", "B"]) == ["single:A", "single:B", "music"]
    assert all_subsets(["A", "B", "C"])[3:] == ["subset:A+B", "subset:A+C", "subset:B+C", "music"]
    six = all_subsets("ABCDEF")
    assert len(set(six)) == len(six) == 63
    with pytest.raises(ValueError, match="7 techniques have 127 subsets, too many"):
        all_subsets("ABCDEFG")


def test_table_says_what_the_rows_say(tmp_path):
    lineup = Lineup("amusic", "weighted", weights=[0.1])
    result = compare(two_banks(), lineup, tmp_path, report=len)
    blocks = table(result).split("\n\n")
    assert [block.splitlines()[0] for block in blocks[:3]] == [
        "bank1 (20 frames, measured costs)",
        "bank2 (30 frames, measured costs)",
        "mean over 2 banks (50 frames, measured costs)",
    ]
    heads, amusic, weighted_line = (line.split() for line in blocks[0].splitlines()[1:])
    assert heads[:4] == ["policy", "λ", "SIC", "Accuracy"]
    said = " ".join(blocks[3].split())  # of every column that is no policy's name, what it means
    assert said.startswith("λ: compute weight of a policy that weighs compute. SIC: statistic of")
    for name in SHOWN:
        assert f" {COLUMNS[name].heading}: {COLUMNS[name].meaning}." in said
    row = result.rows[0]
    assert amusic[:3] == ["amusic", "mean", f"{row['accuracy']:.4f}"]
    assert weighted_line[:3] == ["weighted", "0.1", "mean"]


def estimated(correct: list[bool], p_correct: list[float], **options) -> Trace:
    """A trace with these outcomes and estimates; nothing else about it matters."""
    frames = len(correct)
    bank = random_bank(1, techniques=1, queries=frames, tolerance=0, name=options["bank"])
    return Trace.join(
        bank,
        predictions=np.where(correct, np.arange(frames), -1),
        confidence=np.zeros(frames),
        similarity=np.zeros(frames),
        ran=np.ones((frames, 1)),
        p_correct=p_correct,
        policy=options.get("policy", "ppo:run"),
        statistic="evidence",
        compute_weight=options.get("weight"),
    )


def test_partings_of_estimate_and_truth_are_told_once_per_policy_and_bank():
    half = [True, False, True, False]
    traces = [
        estimated(half, [0.9, 0.9, 0.8, 0.8], bank="a", weight=0.1),
        estimated(half, [0.7] * 4, bank="a", weight=0.3),
        estimated(half, [0.55] * 4, bank="a", weight=1.0),
        estimated(half, [0.6] * 4, bank="b", weight=0.1),  # by .1 exactly
        estimated(half, [0.4, 0.3, 0.4, 0.3], bank="b", policy="music"),
        estimated(half, [np.nan] * 4, bank="b", policy="raw:T0"),
    ]
    assert partings(traces) == [
        "WARNING: ppo:run on a: mean p̂ 0.850 is 0.350 above the accuracy 0.500"
        " (λ 0.1; 2 of 3 part so)",
        "WARNING: music on b: mean p̂ 0.350 is 0.150 below the accuracy 0.500",
    ]
    rows = [summarise(trace) for trace in traces]
    blocks = table(Comparison(traces, rows, [])).split("\n\n")
    assert blocks[-1] == "\n".join(partings(traces))
    calm = [traces[2], traces[3]]
    assert "WARNING" not in table(Comparison(calm, [rows[2], rows[3]], []))


def test_audit_is_over_the_frames_that_have_an_estimate():
    nan = float("nan")
    trace = estimated([True, False, True, True], [0.9, 0.2, nan, 0.1], bank="a")
    held = audit(trace)
    assert held is not None
    assert held.accuracy == pytest.approx(2 / 3)
    assert held.p_correct == pytest.approx(0.4)
    assert held.gap == pytest.approx(0.4 - 2 / 3)
    assert held.auroc == pytest.approx(0.5)
    assert held.calibration_error == pytest.approx((0.1 + 0.2 + 0.9) / 3)
    alike = audit(estimated([True, True], [0.9, 0.8], bank="a"))
    assert alike is not None
    assert alike.auroc is None
    assert audit(estimated([True], [nan], bank="a")) is None


def figure_names(tmp_path, *names, weights=(1.0,), banks=None) -> set[str]:
    result = compare(banks or two_banks(), Lineup(*names, weights=weights), tmp_path, report=len)
    drawn = draw(result, tmp_path)
    for figure in drawn:
        assert Path(figure.path).read_bytes().startswith(b"\x89PNG")
        assert figure.caption.endswith(".")
    assert {Path(figure.path) for figure in drawn} == set(tmp_path.glob("*.png"))
    return {Path(figure.path).name for figure in drawn}


def test_figures_of_every_bank_and_of_their_mean(tmp_path):
    assert figure_names(tmp_path, "amusic", "music", "weighted", weights=[1.0, 2.0]) == {
        "front-mean.png",
        "shares.png",
        *(
            f"{kind}-bank{n}.png"
            for kind in ("front", "precision_recall", "selections")
            for n in (1, 2)
        ),
    }


def test_figures_leave_out_what_there_is_not(tmp_path):
    bank = [random_bank(1, queries=20)]
    assert figure_names(tmp_path / "a", "raw:T0", banks=bank) == {"precision_recall-bank1.png"}
    assert figure_names(tmp_path / "b", "single:T0", "periodic:3/T2+T1/T2", banks=bank) == {
        "front-bank1.png",
        "precision_recall-bank1.png",
    }


def test_figures_of_many_policies(tmp_path):
    bank = random_bank(1, techniques=5, queries=20)
    names = [*all_subsets(bank.techniques), *(f"random:0.{n}" for n in range(1, 10)), "weighted"]
    weights = [0.1, 0.2, 0.5, 1.0, 2.0, 3.0]
    assert len(figure_names(tmp_path, *names, weights=weights, banks=[bank])) == 4


def test_a_figure_of_curves_holds_the_ends_and_the_middle_of_many_weights(tmp_path):
    bank = random_bank(1, techniques=5, queries=20)
    names = [*all_subsets(bank.techniques), "weighted"]
    weights = [0.1, 0.2, 0.5, 1.0, 2.0]
    result = compare([bank], Lineup(*names, weights=weights), tmp_path, report=len)
    shown = figures._curves(result.traces)
    weighted = [trace.compute_weight for trace in shown if trace.policy == "weighted"]
    assert weighted == [0.1, 0.5, 2.0]
    assert {trace.policy for trace in shown} == {
        *("music", "weighted"),
        *(f"single:{name}" for name in bank.techniques),
    }
    assert len(figures._curves(result.traces[:31])) <= figures.MOST_CURVES


def test_a_headline_names_the_best_and_the_cheapest_that_is_near():
    def row(policy: str, auc: float, compute: float, weight: float | None = None) -> dict:
        return {"policy": policy, "auc": auc, "compute": compute, "compute_weight": weight}

    rows = [row("music", 0.9, 1.0), row("single:A", 0.5, 0.1), row("oracle", 1.0, 0.1)]
    assert figures.headline(rows) == (
        "Of 2 policies, MuSIC has the highest AUC, 0.900, at 100% of the compute of all techniques;"
        " nothing cheaper comes within 0.02 of it."
    )
    rows += [row("ppo", 0.89, 0.4, 0.3), row("ppo", 0.885, 0.3, 0.6), row("amusic", 0.9004, 0.9)]
    said = figures.headline(rows)
    assert "A-MuSIC has the highest AUC, 0.900, at 90%" in said  # equal to three digits: cheaper
    assert said.endswith("selector (ppo), λ 0.6 comes within 0.02 of it at 30%.")
    rows += [row("ppo", 0.95, 0.1, 2.0), row("single:A", 0.95, 0.1)]  # as good and as cheap
    assert "A has the highest AUC, 0.950, at 10%" in figures.headline(rows)


def test_summary_of_a_kept_row_is_stored_beside_its_trace(tmp_path):
    result = compare([random_bank(1)], Lineup("amusic"), tmp_path, report=len)
    (path,) = (tmp_path / "rows").iterdir()
    stored = json.loads(path.read_text("utf-8"))
    assert stored["row"] == result.rows[0] == summarise(result.traces[0])
