"""Studies: which cells there are, what is kept, and every number that is reckoned from them."""

from __future__ import annotations

import json
import shutil
import signal
import sys
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from amusic_baselines import make_policy, subset
from env_cases import random_bank
from script_cases import run_and_stop
from study_cases import (
    EVERYBODY,
    FIXED,
    WEIGHTS,
    banks,
    entrant,
    learned,
    make_killer,
    plan_of,
)

from amusic_gym.evaluation import store, study
from amusic_gym.evaluation.audit import audit
from amusic_gym.evaluation.contestants import Contestant
from amusic_gym.evaluation.metrics import AVERAGED, mean_rows, summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.evaluation.study import Entrant, cells
from amusic_gym.evaluation.study.cells import LABELS
from amusic_gym.evaluation.study.field import BOTH, SEEDS, Field
from amusic_gym.evaluation.study.figures import _without_worse_peers, draw
from amusic_gym.evaluation.study.findings import EVERYONE, ahead
from amusic_gym.evaluation.study.fronts import GRID, front_at, hypervolume
from amusic_gym.evaluation.study.tables import tables, text, write_markdown
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.protocol import Context
from amusic_gym.routes.retime import retime
from amusic_gym.utils.imports import PACKAGE, digest_of

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> SimpleNamespace:
    """A study of everybody on two banks, finished."""
    out = tmp_path_factory.mktemp("study")
    plan, said = plan_of(EVERYBODY), []
    finished = study.run(plan, out, report=said.append)
    findings = study.find(plan, finished, rivals=["imitation"])
    return SimpleNamespace(out=out, plan=plan, said=said, finished=finished, findings=findings)


# ---- which cells there are -------------------------------------------------------------------


def cells_of(plan: study.Plan, policy: str, condition: str) -> list[tuple]:
    return [
        (cell.labels["bank"], cell.labels["compute_weight"], cell.labels["member"], cell.retiming)
        for cell in plan.cells
        if (cell.labels["policy"], cell.labels["condition"]) == (policy, condition)
    ]


def test_a_policy_has_a_cell_for_all_that_may_change_it():
    plan = plan_of([*FIXED[:1], entrant("random:0.5", draws=True), learned("PPO")], banks(1))
    one = "single:T0", "random:0.5"
    assert cells_of(plan, one[0], "recorded") == [("bank1", None, one[0], None)]
    assert cells_of(plan, one[0], "kidnapped") == [("bank1", None, one[0], s) for s in (0, 1)]
    assert cells_of(plan, one[1], "recorded") == [("bank1", None, one[1], None)] * 2
    assert [c.seed for c in plan.cells if c.labels["policy"] == one[1]] == [0, 1] * 3
    assert len({cell.path for cell in plan.cells}) == len(plan.cells)
    for condition, seeds in (
        ("recorded", (None, None)),
        ("paced", (0, 1)),
        ("kidnapped", (0, 1)),
    ):
        assert cells_of(plan, "PPO", condition) == [
            ("bank1", weight, f"PPO{number}", seed)
            for number, seed in enumerate(seeds)
            for weight in WEIGHTS
        ]
    assert plan.routes[0]["cheapest"] == pytest.approx(1 / 6)


def test_seeds_and_conditions_are_those_asked_for():
    plan = plan_of([*FIXED[:1], learned("PPO", 3)], seeds=(4, 7, 9), conditions=["kidnapped"])
    assert {cell.labels["condition"] for cell in plan.cells} == {"kidnapped"}
    assert [c.retiming for c in plan.cells if c.labels["bank"] == "bank1"] == [
        *([4] * 4 + [7] * 4 + [9] * 4)
    ]
    members = {
        (c.labels["member"], c.labels["seed"]) for c in plan.cells if c.labels["policy"] == "PPO"
    }
    assert members == {("PPO0", 4), ("PPO1", 7), ("PPO2", 9)}


def renamed(name: str) -> Entrant:
    return Entrant(name, "learned", learned("PPO").contestants)


@pytest.mark.parametrize(
    ("entrants", "options", "sentence"),
    [
        ([], {}, "no policy to study"),
        (FIXED, {"seeds": ()}, r"seeds are \[\]; give at least one"),
        (FIXED, {"seeds": (1, 1)}, r"seeds are \[1, 1\]; give at least one, each once"),
        (FIXED, {"seeds": (-1,)}, "seed is -1"),
        (FIXED, {"conditions": ()}, "no condition; give some of recorded, paced, kidnapped"),
        (FIXED, {"conditions": ("kidnaped",)}, "did you mean 'kidnapped'?"),
        ([learned("PPO", 3)], {}, "PPO has 3 runs for 2 seeds; give one run, or one for each"),
        ([learned("PPO", 2, tuple(range(9)))], {}, "PPO has 9 compute weights; give 1 to 8"),
        ([renamed("cascade")], {}, "'cascade' is what tables call a front; take another name"),
        ([FIXED[0], renamed("single:T0")], {}, "two policies are called 'single:T0'"),
        ([entrant("music", "fix")], {}, "unknown family 'fix': did you mean 'fixed'?"),
        ([entrant("single:T9")], {}, "unknown technique 'T9'"),
        ([entrant("amusic", statistic="evidence")], {}, "a statistic of its own, 'mean'"),
        ([entrant("raw:T0", statistic="mean")], {}, "'none', and takes no other; leave out @mean"),
    ],
)
def test_what_cannot_be_studied_is_refused_before_anything_runs(entrants, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        plan_of(entrants, **options)


def test_banks_of_one_name_are_told_apart_and_costs_must_agree():
    same = [random_bank(seed, queries=20, name="bank") for seed in (1, 2)]
    assert [route["bank"] for route in plan_of(FIXED, same).routes] == ["bank", "bank (2)"]
    with pytest.raises(ValueError, match="different costs"):
        plan_of(FIXED, [same[0], same[1].with_costs("runs")])


def test_a_study_without_carried_candidates_says_so(tmp_path):
    mean = next(one for one in EVERYBODY if one.name == "music@mean")
    everybody = [*FIXED, entrant("amusic", "amusic"), mean, learned("PPO", seeds=1)]
    options = {"seeds": (0,), "conditions": ("recorded",), "carry": False, "discount": False}
    plan = plan_of(everybody, banks(1), **options)
    findings = study.find(plan, study.run(plan, tmp_path, report=len))
    assert (findings.settings["carry"], findings.settings["discount"]) == (False, False)
    assert not any(row["carry"] for row in findings.cells + findings.points)
    (shown, *_) = tables(findings)
    labels = {row[0]: row[2] for row in shown.rows}
    assert (labels["music"], labels["PPO"]) == ("evidence, no carry", "evidence, no carry")
    assert (labels["amusic"], labels["music@mean"]) == ("mean", "mean")


# ---- cells and what is kept ------------------------------------------------------------------


def test_a_cell_holds_what_the_rollout_gives(whole):
    first, second = banks()
    for bank, motion, retiming, policy in (
        (first, "recorded", None, "cascade"),
        (second, "paced", 1, "cascade"),
        (second, "kidnapped", 0, "amusic"),
    ):
        route = bank if retiming is None else retime(bank, retiming, motion)
        made = make_policy(policy, Context.of(route, statistic="evidence"))
        trace = rollout(made, route, name=policy, statistic="evidence")
        (cell,) = [
            cell
            for cell in whole.finished
            if (cell["bank"], cell["condition"]) == (bank.name, motion)
            and (cell["policy"], cell["seed"]) == (policy, retiming)
        ]
        row, held = summarise(trace), audit(trace)
        measured = {key: value for key, value in row.items() if key not in LABELS}
        assert measured.items() <= cell.items()
        assert (cell["statistic"], cell["carry"]) == (row["statistic"], row["carry"])
        assert cell["costs"] == "measured"
        assert (cell["p_correct"], cell["gap"]) == (held.p_correct, held.gap)
        assert (cell["auroc"], cell["calibration_error"]) == (held.auroc, held.calibration_error)
    raw = [cell for cell in whole.finished if cell["policy"] == "raw:T0"]
    assert {cell["p_correct"] for cell in raw} == {None}


def test_a_seed_of_a_policy_that_draws_is_its_own(whole):
    drawn = [
        (cell["accuracy"], cell["ptr"])
        for cell in whole.finished
        if (cell["policy"], cell["bank"], cell["condition"]) == ("random:0.5", "bank1", "recorded")
    ]
    assert len(set(drawn)) == 2


def files_of(out: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in (out / "cells").iterdir()}


def test_numbers_do_not_depend_on_the_executor(whole, tmp_path):
    said: list[str] = []
    finished = study.run(whole.plan, tmp_path, executor="process:2", report=said.append)
    assert finished == whole.finished
    assert len(said) == len(whole.plan.cells)
    assert files_of(tmp_path) == files_of(whole.out)


def killing(marker: Path) -> study.Plan:
    """A study of which one cell kills its worker, once; where the marker is, none does."""
    made = Contestant("killer", partial(make_killer, marker), WEIGHTS)
    return plan_of([FIXED[0], Entrant("killer", "learned", (made,))])


@pytest.mark.usefixtures("two_ray_workers")
def test_37_a_killed_ray_worker_changes_no_cell(tmp_path):
    (tmp_path / "done").touch()
    serial = study.run(killing(tmp_path / "done"), tmp_path / "serial", report=str)
    said: list[str] = []
    plan = killing(tmp_path / "marker")
    assert study.run(plan, tmp_path / "ray", executor="ray", report=said.append) == serial
    assert (tmp_path / "marker").exists()
    assert len(said) == len(plan.cells)
    assert files_of(tmp_path / "ray") == files_of(tmp_path / "serial")


def test_lines_of_progress_count_all_cells(whole):
    count = len(whole.plan.cells)
    assert [line.split("]")[0] for line in whole.said] == [
        f"[{n}/{count}" for n in range(1, count + 1)
    ]
    assert whole.said[0].startswith(f"[1/{count}] bank1, recorded: single:T0: auc 0.")
    assert whole.said[-1].startswith(f"[{count}/{count}] bank2, kidnapped 1: PPO λ 8: auc 0.")
    assert whole.said[-1].endswith("(about 0 s left)")


def test_34_35_a_stopped_study_loses_the_running_cell_and_no_other(tmp_path):
    plan = plan_of([*FIXED, learned("PPO")], banks(1))
    lines: list[str] = []

    def stop(line: str) -> None:
        lines.append(line)
        if len(lines) == 3:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        study.run(plan, tmp_path, report=stop)
    kept = {path.name: path.read_bytes() for path in (tmp_path / "cells").iterdir()}
    assert len(kept) == 3
    counts = study.count_finished(plan, tmp_path)
    assert [counts[name] for name in ("single:T0", "single:T2", "music")] == [
        (1, 5),
        (1, 5),
        (0, 5),
    ]
    lines.clear()
    study.run(plan, tmp_path, report=lines.append)
    count = len(plan.cells)
    assert lines[0] == f"3 of {count} cells were finished"
    assert lines[1].startswith(f"[1/{count - 3}] bank1, recorded: subset:T0+T1")
    assert all((tmp_path / "cells" / name).read_bytes() == kept[name] for name in kept)
    again: list[str] = []
    study.run(plan, tmp_path, report=again.append)
    assert again == [f"{count} of {count} cells were finished"]


def one_cell(
    bank=None, spec="random:0.5", name="", costs="measured", version="", weights=(None,), **options
) -> str:
    """Where the only cell of a study is kept."""
    made = Contestant(spec, partial(make_policy, spec), weights, version)
    given = {key: options.pop(key) for key in ("draws", "statistic") if key in options}
    who = Entrant(name or spec, "peer", (made,), **given)
    options = {"seeds": (0,), "conditions": ("recorded",), **options}
    plan = plan_of([who], [(bank or random_bank(1, queries=20)).with_costs(costs)], **options)
    (only,) = plan.cells
    return only.path


@pytest.mark.parametrize(
    "change",
    [
        {"version": "other weights"},
        {"spec": "random:0.4"},
        {"weights": (2.0,)},
        {"statistic": "mean"},
        {"carry": False},
        {"discount": False},
        {"costs": "runs"},
        {"conditions": ("paced",)},
        {"conditions": ("kidnapped",)},
        {"draws": True},
        {"bank": random_bank(1, queries=20, levels=13)},
        {"bank": random_bank(1, queries=20, tolerance=1)},
    ],
)
def test_25_whatever_may_change_a_cell_changes_its_key(change):
    assert one_cell() == one_cell()
    assert one_cell(**change) != one_cell()


def test_25_every_motion_has_cells_of_its_own():
    assert one_cell(conditions=("paced",)) != one_cell(conditions=("kidnapped",))


def test_names_are_no_part_of_a_cell():
    assert one_cell(name="other") == one_cell()
    assert one_cell(random_bank(1, queries=20, name="other")) == one_cell()
    assert one_cell(seeds=(3,)) == one_cell()  # a seed that changes nothing
    assert one_cell(seeds=(3,), draws=True) != one_cell(seeds=(4,), draws=True)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """A copy of the package's text and data."""
    ignored = shutil.ignore_patterns("__pycache__", "*.nb?")
    return shutil.copytree(PACKAGE, tmp_path_factory.mktemp("copy") / "amusic_gym", ignore=ignored)


def changed(path, stamp):
    """Whether one more byte in a file changes a stamp."""
    before, text = stamp(), path.read_bytes()
    path.write_bytes(text + b"\n")
    after = stamp()
    path.write_bytes(text)
    return before != after


def stamp_of(package):
    """Stamp of the cells that a copy of the package computes."""
    return digest_of(*store.sources(package / CELLS, package))


CELLS = Path(cells.__file__).relative_to(PACKAGE)
ESTIMATION = PACKAGE / "estimation"


def test_53_every_file_that_a_cell_depends_on_is_in_its_stamp(package):
    measuring = store.sources(package / CELLS, package)
    names = {path.relative_to(package).as_posix() for path in measuring}
    data = {path.relative_to(PACKAGE).as_posix() for path in ESTIMATION.rglob("*.json")}
    assert {CELLS.as_posix(), "estimation/sic/update.py", *data} <= names
    for path in [*measuring[::6], *(package / name for name in data)]:
        assert changed(path, partial(stamp_of, package)), path


def test_53_what_a_cell_runs_is_in_its_stamp():
    ran, plan = set(), plan_of(FIXED[:1], banks(1))

    def note(frame, *_):
        if frame.f_code.co_name != "<module>":  # of a parent package that is imported on the way
            ran.add(frame.f_code.co_filename)

    sys.setprofile(note)
    try:
        for cell in plan.cells[:2]:
            cell.run(plan.bench)
    finally:
        sys.setprofile(None)
    files = {path for path in map(Path, ran) if PACKAGE in path.parents}
    assert {"episode.py", "retime.py"} <= {path.name for path in files}
    policy = store.sources(Path(subset.__file__), Path(subset.__file__).parent, PACKAGE)
    assert files <= {*store.sources(PACKAGE / CELLS, PACKAGE), *policy}


def test_code_that_only_shows_is_no_part_of_a_cell(package):
    for name in ("evaluation/plots/curves.py", "evaluation/study/tables.py", "worlds/facades.py"):
        assert (package / name).exists()
        assert not changed(package / name, partial(stamp_of, package)), name


@pytest.mark.parametrize(
    "damage", ["truncated", "empty", "garbage", "flipped", "other", "less", "list"]
)
def test_23_a_damaged_cell_is_noticed_and_computed_again(tmp_path, damage):
    plan = plan_of(FIXED[:1], banks(1), conditions=("recorded",))
    first = study.run(plan, tmp_path, report=len)
    (path,) = (tmp_path / "cells").iterdir()
    content = path.read_bytes()
    at = content.index(b'"auc": ') + 9
    path.write_bytes(
        {
            "truncated": content[: len(content) // 2],
            "empty": b"",
            "garbage": b"\xff\x00garbage",
            "flipped": content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :],
            "other": store.save(tmp_path, "0" * 24, {"measures": first[0]}).read_bytes(),
            "less": store.save(tmp_path, path.stem, {"measures": {"auc": 1.0}}).read_bytes(),
            "list": b"[1, 2]",
        }[damage]
    )
    said: list[str] = []
    assert study.run(plan, tmp_path, report=said.append) == first
    assert f"{path} is damaged" in said[0]
    assert "computed again" in said[0]
    assert path.read_bytes() == content


# ---- fronts ----------------------------------------------------------------------------------

COMPUTE, AUC = [0.5, 0.1, 1.0, 0.2], [0.8, 0.6, 0.7, 0.55]


def test_a_front_is_the_best_auc_at_no_more_than_that_compute():
    at = front_at(COMPUTE, AUC, [0.05, 0.1, 0.3, 0.5, 1.0])
    np.testing.assert_array_equal(at, [np.nan, 0.6, 0.6, 0.8, 0.8])
    both = front_at([COMPUTE, COMPUTE], [AUC, np.add(AUC, 0.1)], [0.2, 2.0])
    np.testing.assert_allclose(both, [[0.6, 0.8], [0.7, 0.9]])
    rounded = front_at([0.1 * 3], [1.0], [0.3])
    assert rounded == 1.0
    assert np.isnan(front_at(np.zeros((2, 0)), np.zeros((2, 0)), [1.0])).all()


def test_hypervolume_is_the_area_over_log_compute():
    # From 10 % to 50 % at .6, from there to 1 at .8; above .5, of a decade times .5.
    expected = (0.1 * np.log(5) + 0.3 * np.log(2)) / (np.log(10) * 0.5)
    assert hypervolume(COMPUTE, AUC, 0.1) == pytest.approx(expected)
    assert hypervolume([0.05, 2.0], [1.0, 1.0], 0.1) == pytest.approx(1.0)
    assert hypervolume([1.0], [1.0], 0.1) == 0.0
    assert hypervolume([0.1], [0.4], 0.1) == 0.0
    assert np.isnan(hypervolume([1.0], [1.0], 1.0))
    twice = hypervolume([COMPUTE, COMPUTE[::-1]], [AUC, AUC[::-1]], 0.1)
    np.testing.assert_allclose(twice, expected)


def test_hypervolume_against_a_fine_grid():
    rng = np.random.default_rng(0)
    for _ in range(20):
        compute, auc = 10 ** rng.uniform(-2, 0.1, 6), rng.uniform(0.3, 1, 6)
        grid = np.geomspace(0.02, 1, 20001)
        heights = front_at(np.maximum(compute, 0.02), auc, grid)
        area = np.maximum(np.nan_to_num(heights, nan=0.5) - 0.5, 0).mean() / 0.5
        assert hypervolume(compute, auc, 0.02) == pytest.approx(area, abs=1e-3)


# ---- fields and intervals --------------------------------------------------------------------


def cell(policy, bank, auc, compute=0.5, family="peer", weight=None):
    return {
        "policy": policy,
        "family": family,
        "compute_weight": weight,
        "statistic": "evidence",
        "carry": True,
        "bank": bank,
        "auc": auc,
        "compute": compute,
    }


def field_of(*cells, routes=("a", "b"), seeds=3) -> Field:
    return Field.of(cells, routes, seeds)


def test_a_field_spreads_a_single_cell_over_the_seeds():
    field = field_of(
        *(cell("one", "a", value) for value in (0.1, 0.2, 0.6)),
        cell("one", "b", 0.5),
        cell("two", "a", 0.9, compute=0.2),
    )
    np.testing.assert_array_equal(field.auc[0], [[0.1, 0.2, 0.6], [0.5] * 3])
    assert np.isnan(field.auc[1, 1]).all()
    assert field.varied.tolist() == [True, False]
    both, only_b = field.at(None), field.at("b")
    assert [point.policy for point in both.points] == ["one"]
    assert [point.policy for point in only_b.points] == ["one"]
    compute, auc = both.means()
    assert (compute, auc) == (pytest.approx([0.5]), pytest.approx([0.4]))
    two = field.at("a").where(lambda point: point.policy == "two")
    assert two.means() == (pytest.approx([0.2]), pytest.approx([0.9]))


def test_bootstrap_resamples_what_it_says_and_pairs_policies():
    rng = np.random.default_rng(1)
    values = rng.normal(size=(2, 40))
    cells = [
        cell(policy, route, value + shift)
        for policy, shift in (("one", 0.0), ("two", 0.25))
        for route, row in zip("ab", values, strict=True)
        for value in row
    ]
    field = field_of(*cells, seeds=40)
    by_seed, by_both = field.replicates(SEEDS)[1], field.replicates(BOTH)[1]
    np.testing.assert_allclose(by_seed[:, 1] - by_seed[:, 0], 0.25)
    mean = values.mean()
    assert by_seed[:, 0].mean() == pytest.approx(mean, abs=0.02)
    assert by_seed[:, 0].std() == pytest.approx(values.mean(axis=0).std() / np.sqrt(40), rel=0.1)
    between = values.mean(axis=1).std() / np.sqrt(2)
    spread = np.hypot(values.mean(axis=0).std() / np.sqrt(40), between)
    assert by_both[:, 0].std() == pytest.approx(spread, rel=0.15)
    assert field.resampled(SEEDS).all()
    still = field_of(cell("one", "a", 0.5), cell("one", "b", 0.7))
    assert not still.resampled(SEEDS).any()
    assert still.resampled(BOTH).all()
    assert not still.at("a").resampled(BOTH).any()
    np.testing.assert_allclose(still.replicates(SEEDS)[1], 0.6)
    assert set(np.round(still.replicates(BOTH)[1].ravel(), 9)) == {0.5, 0.6, 0.7}


# ---- findings --------------------------------------------------------------------------------


def pick(rows, **labels):
    (row,) = [r for r in rows if labels.items() <= r.items()]
    return row


def test_points_are_means_over_seeds_then_routes(whole):
    cells = [
        c
        for c in whole.finished
        if (c["policy"], c["compute_weight"], c["condition"]) == ("PPO", 1.0, "kidnapped")
    ]
    assert len(cells) == 4
    for route in ("bank1", "bank2"):
        there = [c for c in cells if c["bank"] == route]
        row = pick(
            whole.findings.points,
            policy="PPO",
            compute_weight=1.0,
            condition="kidnapped",
            bank=route,
        )
        expected = mean_rows(there)[0]
        for name in ("auc", "compute", "accuracy", "lost", "ptr"):
            assert row[name] == pytest.approx(expected[name])
        low, high = row["auc_interval"]
        values = [c["auc"] for c in there]
        assert (low, high) == pytest.approx((min(values), max(values)))  # of two, both ends come up
        assert row["interval_over"] == "seeds"
        assert row["routes"] == 1
        assert "p_correct" not in row
    mean = pick(
        whole.findings.points, policy="PPO", compute_weight=1.0, condition="kidnapped", bank="mean"
    )
    assert mean["auc"] == pytest.approx(np.mean([c["auc"] for c in cells]))
    assert (mean["routes"], mean["interval_over"]) == (2, "seeds and routes")
    low, high = mean["auc_interval"]
    inner_low, inner_high = mean["auc_interval_seeds"]
    assert low <= inner_low <= mean["auc"] <= inner_high <= high


def test_what_no_seed_changes_has_no_interval_on_a_route(whole):
    labels = {"policy": "music", "condition": "recorded"}
    assert pick(whole.findings.points, bank="bank1", **labels)["auc_interval"] is None
    mean = pick(whole.findings.points, bank="mean", **labels)
    assert mean["auc_interval"] is not None
    assert mean["auc_interval_seeds"] is None


def test_fronts_are_of_families_and_of_single_policies(whole):
    names = [
        row["front"]
        for row in whole.findings.fronts
        if (row["condition"], row["bank"]) == ("kidnapped", "mean")
    ]
    assert names == [
        "fixed subsets",
        "A-MuSIC",
        "cascade",
        "random",
        "oracle",
        "raw",
        "imitation",
        "PPO",
    ]
    fixed = pick(whole.findings.fronts, front="fixed subsets", condition="kidnapped", bank="bank1")
    points = [
        row
        for row in whole.findings.points
        if (row["family"], row["condition"], row["bank"]) == ("fixed", "kidnapped", "bank1")
    ]
    compute, auc = ([row[name] for row in points] for name in ("compute", "auc"))
    assert fixed["points"] == len(points) == 5
    assert fixed["begins"] == pytest.approx(1 / 6)
    assert fixed["auc_at"][:3] == [None, None, pytest.approx(auc[0])]
    assert fixed["auc_at"][-1] == pytest.approx(max(auc))
    assert fixed["hypervolume"] == pytest.approx(float(hypervolume(compute, auc, 1 / 6)))
    low, high = fixed["hypervolume_interval"]
    assert low <= fixed["hypervolume"] <= high


def made_up(aucs: dict[str, list[tuple[float, float]]], families: dict[str, str], seeds=(0,)):
    """Findings of one route on which every policy has these points (compute, AUC)."""
    plan = SimpleNamespace(
        routes=[{"bank": "a", "queries": 9, "references": 9, "cheapest": 0.1}],
        settings={
            "conditions": ["recorded"],
            "seeds": list(seeds),
            "statistic": "evidence",
            "carry": None,
            "discount": None,
            "costs": "runs",
            "needs_truth": {},
        },
    )
    numbers = {**dict.fromkeys(AVERAGED, 0.0), "queries": 9, "auroc": None}
    finished = [
        {
            **{**numbers, "p_correct": None, "gap": None, "calibration_error": None},
            **cell(policy, "a", auc, compute, families[policy], weight=float(number)),
            **{"condition": "recorded", "seed": None, "member": policy, "costs": "runs"},
        }
        for policy, points in aucs.items()
        for number, (compute, auc) in enumerate(points)
    ]
    return study.find(plan, finished, rivals=["imitation"])


def test_margins_are_differences_of_step_functions_on_the_grid():
    findings = made_up(
        {
            "music": [(0.1, 0.6), (1.0, 0.9)],
            "cascade": [(0.2, 0.7)],
            "imitation": [(0.3, 0.75)],
            "peer": [(0.1, 1.0)],
            "PPO": [(0.12, 0.65), (0.25, 0.8), (0.6, 0.85)],
        },
        {
            "music": "fixed",
            "cascade": "cascade",
            "imitation": "learned",
            "peer": "peer",
            "PPO": "learned",
        },
    )
    of = {row["rival"]: row for row in findings.margins if row["policy"] == "PPO"}
    assert list(of) == ["fixed subsets", "cascade", "imitation", EVERYONE]
    fixed = of["fixed subsets"]
    assert fixed["least"] == pytest.approx(0.85 - 0.9)
    assert fixed["least_at"] == pytest.approx(1.0)
    assert fixed["greatest"] == pytest.approx(0.2)  # .8 against .6, from 25 % on
    assert fixed["greatest_at"] == pytest.approx(GRID[GRID >= 0.25][0])
    assert (fixed["begins"], fixed["rival_begins"]) == (0.12, 0.1)
    everyone = of[EVERYONE]
    assert everyone["least"] == pytest.approx(-0.05)  # at 20 %: .65 against the cascade's .7
    assert everyone["greatest"] == pytest.approx(0.1)  # at 25 %: .8 against the cascade's .7
    assert of["cascade"]["least"] == pytest.approx(-0.05)
    assert of["cascade"]["greatest"] == pytest.approx(0.1)
    late = of["imitation"]
    assert (late["least"], late["greatest"]) == (pytest.approx(0.05), pytest.approx(0.05))
    assert late["greatest_interval"] is None
    assert [row["rival"] for row in findings.margins if row["policy"] == "imitation"] == [
        "fixed subsets",
        "cascade",
        EVERYONE,
    ]


def test_matches_are_the_best_of_each_kind_at_no_more_compute():
    findings = made_up(
        {
            "music": [(0.1, 0.6), (0.3, 0.9), (1.0, 0.95)],
            "cascade": [(0.2, 0.7998), (0.25, 0.79), (0.28, 0.8)],
            "voi:idle": [(0.3, 0.8004)],
            "periodic:2": [(0.4, 1.0)],
            "peer": [(0.1, 1.0)],
            "PPO": [(0.1, 0.5), (0.3, 0.8)],
        },
        {
            **{"music": "fixed", "cascade": "cascade", "voi:idle": "idle"},
            **{"periodic:2": "periodic", "peer": "peer", "PPO": "learned"},
        },
    )
    found = {(row["compute_weight"], row["kind"]): row for row in findings.matches}
    assert set(found) == {
        (float(weight), kind)
        for weight in (0, 1)
        for kind in ("fixed subsets", "cascade", "may idle", "periodic")
    }
    subset = found[1.0, "fixed subsets"]
    assert (subset["rival"], subset["rival_weight"], subset["rival_auc"]) == ("music", 1.0, 0.9)
    assert subset["difference"] == pytest.approx(-0.1)
    assert subset["difference_interval"] is None  # one seed, one route
    assert found[0.0, "fixed subsets"]["rival_auc"] == 0.6
    assert found[0.0, "cascade"]["rival"] is None  # dearer
    assert found[1.0, "periodic"]["difference"] is None
    assert ahead(subset) is False
    assert ahead(found[1.0, "cascade"]) is None  # equal
    assert found[1.0, "cascade"]["rival_compute"] == 0.2  # the cheaper of equals
    assert ahead(found[1.0, "may idle"]) is None  # to three digits
    (shown,) = (t for t in tables(findings) if t.title.startswith("The best of each kind"))
    dear = ["PPO", "1", "30.0 %", "0.800", "", "0.900 > (MuSIC, λ 1)", "0.800 = (cascade, λ 0)"]
    assert [line[: len(dear)] for line in shown.rows][1] == dear
    assert list(shown.heads[5:]) == ["fixed subsets", "cascade", "periodic", "may idle"]
    assert shown.rows[1][7] == "–"


def test_ahead_needs_an_interval_without_0(whole):
    rows = [row for row in whole.findings.matches if row["difference_interval"] is not None]
    assert rows
    for row in rows:
        low, high = row["difference_interval"]
        assert low <= row["difference"] <= high
        assert ahead(row) is (True if low > 0 else False if high < 0 else None)


def test_ahead_only_beyond_the_band_is_no_lead_within_it():
    aucs = {"music": [(0.1, 0.6)], "PPO": [(0.1, 0.6), (0.45, 0.9)]}
    (row,) = made_up(aucs, {"music": "fixed", "PPO": "learned"}).margins
    assert (row["least"], row["greatest"]) == (0.0, 0.0)
    never = {"music": [(0.5, 0.6)], "PPO": [(0.6, 0.6)]}
    (row,) = made_up(never, {"music": "fixed", "PPO": "learned"}).margins
    assert (row["greatest"], row["greatest_at"]) == (None, None)
    assert row["least"] == 0.0


def test_gap_closed_is_between_single_and_virtual_best(whole):
    for condition in ("recorded", "kidnapped"):
        fixed = [
            row
            for row in whole.findings.points
            if (row["family"], row["condition"]) == ("fixed", condition) and row["bank"] != "mean"
        ]
        names = {row["policy"] for row in fixed}
        by_name = {
            name: np.mean([row["auc"] for row in fixed if row["policy"] == name]) for name in names
        }
        single = max(by_name.values())
        virtual = np.mean(
            [max(r["auc"] for r in fixed if r["bank"] == bank) for bank in ("bank1", "bank2")]
        )
        row = pick(whole.findings.points, policy="raw:T0", condition=condition, bank="mean")
        cheap = {"single:T0"}  # what costs no more than the uncorrected T0
        assert row["gap_closed"] is None, cheap
        every = pick(
            whole.findings.points,
            policy="PPO",
            compute_weight=0.1,
            condition=condition,
            bank="mean",
        )
        if virtual - single >= 0.02:
            expected = (every["auc"] - single) / (virtual - single)
            assert every["gap_closed"] == pytest.approx(expected)
        else:
            assert every["gap_closed"] is None


def test_audit_holds_every_front_against_the_truth_and_says_loudly_where_they_part(whole):
    for row in whole.findings.audit:
        cells = [
            c
            for c in whole.finished
            if (c["condition"], c["bank"]) == (row["condition"], row["bank"])
            and c["policy"]
            in {"fixed subsets": [e.name for e in FIXED], "random": ["random:0.5"]}.get(
                row["front"], [row["front"], row["front"].lower().replace("-", "")]
            )
        ]
        assert row["cells"] == len(cells) > 0
        assert row["gap"] == pytest.approx(np.mean([c["gap"] for c in cells]))
        assert row["greatest_gap"] == pytest.approx(max(c["gap"] for c in cells))
        told = f"WARNING: {row['front']} on {row['bank']}, "
        told += {"recorded": "as recorded"}.get(row["condition"], row["condition"])
        lines = [line for line in whole.findings.warnings if line.startswith(f"{told}:")]
        assert len(lines) == (row["greatest_gap"] > 0.1)
    fronts = [row["front"] for row in whole.findings.audit]
    assert fronts[0] == "imitation"  # learned ones first
    assert "oracle" not in fronts
    assert "raw" not in fronts
    assert whole.findings.warnings  # re-timed, p̂ of a steady robot is far too high


# ---- tables, files, figures ------------------------------------------------------------------


def test_study_json_holds_everything(whole):
    path = whole.findings.write(whole.out)
    stored = json.loads(path.read_text("utf-8"))
    assert stored["cells"] == whole.finished
    assert stored["points"] == whole.findings.points
    assert stored["settings"]["rivals"] == ["imitation"]
    assert stored["settings"]["seeds"] == [0, 1]
    assert [route["bank"] for route in stored["routes"]] == ["bank1", "bank2"]


def test_tables_show_every_point_once_and_mark_what_needs_ground_truth(whole):
    made = tables(whole.findings)
    titles = [table.title for table in made]
    assert titles == [
        "Mean over 2 routes (measured costs)",
        "bank1: 30 frames, 40 places (measured costs)",
        "bank2: 30 frames, 40 places (measured costs)",
        "Fronts, as recorded",
        "Fronts, paced",
        "Fronts, kidnapped",
        *(
            f"The best of each kind at no more compute, {condition}: {where}"
            for where in ("mean over 2 routes", "bank1", "bank2")
            for condition in ("as recorded", "paced", "kidnapped")
        ),
        "Margins: AUC of the selector's front minus the rival's",
        "Audit: estimated correctness p̂ against the truth",
    ]
    first = made[1]
    points = [
        r for r in whole.findings.points if (r["bank"], r["condition"]) == ("bank1", "recorded")
    ]
    assert len(first.rows) == len(points) == 11 + 2 * 3
    for line, point in zip(first.rows, points, strict=True):
        assert line[0].removesuffix(" †") == point["policy"]
        assert line[3] == f"{point['auc']:.3f}"
        assert len(line) == len(first.heads)
    assert sum(line[0] == "oracle †" for line in first.rows) == 1
    assert "† has seen ground truth: oracle of the route itself." in first.note
    assert all(len(line) == len(table.heads) for table in made for line in table.rows)


def test_text_ends_with_the_warnings_and_markdown_has_them_too(whole, tmp_path):
    lines = text(whole.findings).splitlines()
    assert lines[-len(whole.findings.warnings) :] == whole.findings.warnings
    page = write_markdown(whole.findings, tmp_path).read_text("utf-8")
    assert page.count("\n### ") == len(tables(whole.findings)) - 1
    for warning in whole.findings.warnings:
        assert f"- **{warning}**" in page


def test_markdown_of_a_table():
    table = Table("T", ["name", "n"], [["a|b", "1"]], "Note.")
    assert table.markdown() == "### T\n\n| name | n |\n| :-- | --: |\n| a\\|b | 1 |\n\nNote."
    assert table.text() == "T\nname  n\na|b   1\nNote."


def test_policies_that_are_not_everywhere_are_left_out_of_the_mean(tmp_path):
    one, other = banks(1)[0], random_bank(5, queries=20, names=["A", "B", "C"])

    def entrants(bank):
        return [entrant("music", "fixed"), entrant(f"single:{bank.techniques[0]}", "fixed")]

    options = {"statistic": "evidence", "seeds": (0,), "conditions": ("recorded",)}
    plan = study.make_plan([one, other], entrants, **options)
    findings = study.find(plan, study.run(plan, tmp_path, report=len))
    assert [row["policy"] for row in findings.points if row["bank"] == "mean"] == ["music"]
    assert "2 policies that are not on every route are left out." in tables(findings)[0].note


def test_figures_of_the_mean_and_of_every_route(whole, tmp_path):
    figures = draw(whole.findings, tmp_path)
    assert [Path(figure.path).name for figure in figures] == ["fronts.png", "routes.png"]
    for figure in figures:
        assert Path(figure.path).read_bytes().startswith(b"\x89PNG")
        assert figure.caption.endswith("95 % bootstrap intervals over seeds.")


def test_a_figure_draws_a_large_family_as_one_front_whatever_is_in_it(tmp_path):
    names = ["cascade", "cascade:1/3/0.5", "cascade:1/9/0.5"]
    points = {name: [(0.2 + 0.1 * i, 0.7 + 0.1 * i)] for i, name in enumerate(names)}
    of = dict.fromkeys(names, "cascade")
    few = made_up({**points, "music": [(1.0, 0.9)]}, {**of, "music": "fixed"})
    worse = {**points, "cascade:2/9/0.5": [(0.9, 0.75)]}  # beyond the front: not drawn
    families = {**dict.fromkeys(worse, "cascade"), "music": "fixed"}
    more = made_up({**worse, "music": [(1.0, 0.9)]}, families)
    pictures = []
    for i, findings in enumerate((few, more)):
        (figure,) = draw(findings, tmp_path / str(i))
        pictures.append(Path(figure.path).read_bytes())
    assert pictures[0] == pictures[1]


def test_a_figure_shows_a_peer_where_no_other_setting_of_it_is_better_for_less():
    def point(policy: str, compute: float, auc: float, family: str = "peer") -> dict:
        labels = {"bank": "hall", "condition": "paced", "policy": policy, "family": family}
        return {**labels, "compute": compute, "auc": auc}

    rows = [
        point("xu:0/2/5", 0.5, 0.6),
        point("xu:2/9/5", 0.5, 0.4),
        point("xu:A/0/2/5", 0.1, 0.3),
        point("hmm", 1.0, 0.2),
        point("cascade", 0.5, 0.1, "cascade"),
    ]
    shown = [row["policy"] for row in _without_worse_peers(rows)]
    assert shown == ["xu:0/2/5", "xu:A/0/2/5", "hmm", "cascade"]


def test_figures_of_one_route_and_of_nothing_to_draw(tmp_path):
    plan = plan_of([*FIXED[:1], entrant("raw:T0")], banks(1), conditions=("kidnapped",))
    findings = study.find(plan, study.run(plan, tmp_path, report=len))
    (figure,) = draw(findings, tmp_path)
    assert Path(figure.path).name == "fronts.png"
    nothing = plan_of([entrant("raw:T0")], banks(1), seeds=(0,), conditions=("recorded",))
    assert draw(study.find(nothing, study.run(nothing, tmp_path, report=len)), tmp_path) == []


# ---- the command -----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folders(tmp_path_factory) -> list[Path]:
    folder = tmp_path_factory.mktemp("banks")
    return [bank.save(folder / bank.name) for bank in banks()]


def test_command_runs_prints_and_resumes(run_script, tmp_path, folders, trained):
    out = tmp_path / "out"
    words = [
        *("--bank", folders[0], "--out", out, "--seeds", 2, "--first-seed", 5, "--costs", "runs"),
        *("--statistic", "evidence"),
        *("--policy", "single:T0", "music@mean", "random:0.5", f"ppo:{trained}"),
        *("--selector", f"imitation={trained}", "--compute-weight", 0.1, 1),
    ]
    dry = run_script("study.py", *words, "--dry-run")
    assert (dry.returncode, dry.stderr) == (0, "")
    assert dry.stdout.splitlines()[-1] == "0 of 36 cells finished, 36 to compute"
    assert not out.exists()
    done = run_script("study.py", *words)
    assert (done.returncode, done.stderr) == (0, "")
    stored = json.loads((out / "study.json").read_text("utf-8"))
    families = {row["policy"]: row["family"] for row in stored["points"]}
    assert families == {
        "single:T0": "fixed",
        "music@mean": "variant",
        "random:0.5": "random",
        f"ppo:{trained}": "learned",
        "imitation": "learned",
    }
    assert {row["statistic"] for row in stored["points"] if row["policy"] == "music@mean"} == {
        "mean"
    }
    assert stored["settings"]["seeds"] == [5, 6]
    assert stored["settings"]["rivals"] == ["imitation"]
    assert {row["rival"] for row in stored["margins"]} == {
        "fixed subsets",
        "random",
        "imitation",
        EVERYONE,
    }
    made = {path.name for path in out.iterdir()}
    assert made == {
        "cells",
        "study.json",
        "tables.md",
        "fronts.png",
        "index.html",
        ".amusic-written.json",
    }
    assert "Audit: estimated correctness" in done.stdout
    dry = run_script("study.py", *words, "--dry-run")
    assert dry.stdout.splitlines()[-1] == "36 of 36 cells finished, 0 to compute"


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_34_52_a_stopped_study_keeps_the_finished_cells(tmp_path, folders, number, status):
    out = tmp_path / "out"
    words = ["--bank", folders[0], "--out", out, "--seeds", 1, "--policy", "music", "single:T0"]
    words += ["--statistic", "evidence"]
    stopped = run_and_stop(number, 2, "study.py", *words)
    assert stopped.returncode == status
    assert stopped.stderr == "interrupted; what was finished is kept\n"
    assert len(list((out / "cells").glob("*.json"))) == 2
    assert not (out / "study.json").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "no policy; give --policy, --all-subsets or --selector"),
        (["--policy", "musc"], "unknown policy 'musc': did you mean 'music'?"),
        (["--policy", "music@evidance"], "unknown statistic 'evidance': did you mean 'evidence'?"),
        (["--policy", "amusic@evidence"], "has a statistic of its own, 'mean'"),
        (["--policy", "ppo@mean"], "no selector ships for the statistic 'mean'"),
        (["--policy", "ppo", "--no-carry"], "leave out --no-carry"),
        (["--selector", "PPO"], "--selector 'PPO' is not of the form NAME=VALUE"),
        (["--selector", "PPO=nowhere"], "nowhere is no run folder"),
        (["--policy", "music", "--rival", "PPO"], "--rival 'PPO' is no selector of this study"),
        (["--policy", "music", "--seeds", "0"], "--seeds is 0"),
        (["--policy", "music", "--executor", "rya"], "did you mean 'ray'?"),
        (["--policy", "music", "--costs", "paper"], "the paper gives no time for technique 'T0'"),
        (["--policy", "music", "--conditions", "kidnaped"], "did you mean 'kidnapped'?"),
        (["--policy", "music", "--compute-weight", "-1"], "compute weight is -1.0"),
        (["--policy", "music", "--bank", "nowhere"], "nowhere"),
    ],
)
def test_10_bad_arguments_are_one_line_and_status_2(run_script, tmp_path, folders, words, sentence):
    out = tmp_path / "out"
    refused = run_script("study.py", "--bank", folders[0], "--out", out, *words)
    assert refused.returncode == 2
    assert refused.stdout == ""
    assert refused.stderr.count("\n") == 1
    assert sentence in refused.stderr
    assert not out.exists()
