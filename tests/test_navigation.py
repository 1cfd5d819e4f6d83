"""Navigation: a policy along a live route, frame by frame, says what it says on a bank."""

from __future__ import annotations

import csv
import gc
import tracemalloc
from dataclasses import fields
from functools import cache
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from amusic_baselines import POLICIES
from live_cases import (
    NAMES,
    CountingMap,
    Stream,
    bank_of,
    live_of,
    maps_of,
    pair,
    policy_on,
    traverse,
)

from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.live.drives import FrameResult
from amusic_gym.live.navigation import TraceWriter, navigate
from amusic_gym.policies.protocol import Localiser
from amusic_gym.policies.trace import CSV_COLUMNS, Trace

ARGUMENTS = {
    "raw": ["CALC"],
    "single": ["HOG"],
    "subset": ["HOG+CoHOG"],
    "music": [None],
    "amusic": [None, "evidence"],
    "random": ["0.4", "0.4/idle"],
    "periodic": ["5", "4/HOG/idle"],
    "cascade": [None],
    "voi": [None, "idle"],
    "mpf": [None],
    "hmpf": [None],
    "dynmpf": [None],
    "switchhit": [None],
    "plurality": [None],
    "borda": [None],
    "hmm": [None],
    "xu": [None],
    "lazygraph": [None],
}
SPECS = [
    name if argument is None else f"{name}:{argument}"
    for name, arguments in ARGUMENTS.items()
    for argument in arguments
]
BOUNDS = ("oracle",)

cached_pair = cache(pair)


def ppo():
    """A selector as training makes it, but with weights by chance."""
    import torch
    from amusic_agents.network import NetworkConfig, SelectorNetwork
    from amusic_agents.selector import TrainedSelector

    network = SelectorNetwork(NetworkConfig())
    torch.manual_seed(7)
    for weights in network.parameters():
        torch.nn.init.normal_(weights, std=0.5)
    return TrainedSelector(network, "evidence")


def assert_same_traces(one: Trace, other: Trace) -> None:
    for field in fields(Trace):
        if field.name == "true_rank":  # of a live route it is not known
            continue
        first, second = getattr(one, field.name), getattr(other, field.name)
        np.testing.assert_array_equal(first, second, field.name)


# ---- the same as on a bank ---------------------------------------------------------------------


def test_every_policy_of_the_registry_is_tested():
    assert {*ARGUMENTS, *BOUNDS} == set(POLICIES)


@pytest.mark.parametrize("spec", [*SPECS, "ppo"])
def test_every_policy_says_what_it_says_on_a_bank(spec):
    bank, live = cached_pair(60, 40)
    first, second = (ppo() if spec == "ppo" else policy_on(spec, b) for b in (bank, live))
    wanted = rollout(first, bank, name=spec, compute_weight=0.5)
    assert_same_traces(rollout(second, live, name=spec, compute_weight=0.5), wanted)
    if spec in ("cascade", "amusic", "random:0.4", "periodic:5", "voi", "voi:idle"):
        assert len(np.unique(wanted.ran, axis=0)) > 1


@pytest.mark.parametrize("spec", BOUNDS)
def test_what_needs_all_scores_beforehand_is_refused(spec):
    _, live = cached_pair(60, 40)
    with pytest.raises(ValueError, match="live route 'pair': a policy that needs all scores and"):
        policy_on(spec, live)


def test_several_routes_banks_and_live_ones():
    bank, live = cached_pair(60, 40)
    jobs = [Job(live, 0.1), Job(bank, 0.1), Job(live, 2.0)]
    traces = rollouts(policy_on("amusic", bank), jobs, name="a")
    for trace, job in zip(traces, jobs, strict=True):
        alone = rollout(
            policy_on("amusic", bank), bank, name="a", compute_weight=job.compute_weight
        )
        assert_same_traces(trace, alone)


def test_a_trace_needs_ground_truth_and_an_end():
    maps, images = maps_of(9), traverse(5, 2)
    for frames in (images, Stream(images)):
        live = live_of(maps, frames)
        with pytest.raises(ValueError, match="'pair' has no ground truth, which a trace is"):
            rollout(policy_on("music", live), live, name="m")


# ---- frame by frame ----------------------------------------------------------------------------


def test_frames_come_when_they_are_asked_for():
    maps = [CountingMap(one) for one in maps_of(20)]
    stream = Stream(traverse(30, 2))
    live = live_of(maps, stream)
    drive = navigate(policy_on("subset:HOG+CALC", live), live)
    assert stream.next == 0
    for frame, seen in enumerate(islice(drive, 7)):
        assert seen.frame == frame == stream.next - 1
        assert seen.image is stream.images[frame]
        assert seen.active == ("HOG", "CALC")
        assert [one.calls for one in maps] == [frame + 1, frame + 1, 0]


@pytest.mark.parametrize("spec", ["amusic", "raw:CALC"])
@pytest.mark.parametrize("knows", [True, False])
def test_a_stream_is_driven_to_its_end(spec, knows):
    maps, images = maps_of(20), traverse(45, 2)
    bank, live = bank_of(maps, images), live_of(maps, Stream(images, knows))
    wanted = rollout(policy_on(spec, bank), bank, name=spec)
    policy = policy_on(spec, live)
    for _ in range(2):
        seen = list(navigate(policy, live))
        assert [s.frame for s in seen] == list(range(45))
        assert [s.prediction for s in seen] == wanted.predictions.tolist()
        assert [s.confidence for s in seen] == wanted.confidence.tolist()
        assert [s.similarity for s in seen] == wanted.similarity.tolist()
        assert [s.technique for s in seen] == wanted.chosen.tolist()
        np.testing.assert_array_equal([s.ran for s in seen], wanted.ran)
        np.testing.assert_array_equal([s.late_runs for s in seen], wanted.late_runs)
        assert [s.selection for s in seen] == wanted.selections.tolist()
        estimates = [np.nan if s.p_correct is None else s.p_correct for s in seen]
        np.testing.assert_array_equal(estimates, wanted.p_correct)


def test_the_times_of_a_frame_are_told():
    _, live = cached_pair(60, 40)
    for seen in navigate(policy_on("amusic", live), live):
        np.testing.assert_array_equal(seen.run_milliseconds > 0, seen.ran | (seen.late_runs > 0))
        assert seen.milliseconds > seen.run_milliseconds.sum()
        assert seen.read_milliseconds > 0


@pytest.mark.parametrize("spec", [*SPECS, "ppo"])
def test_navigation_adds_less_than_two_milliseconds(spec):
    _, live = cached_pair(60, 40)
    policy = ppo() if spec == "ppo" else policy_on(spec, live)
    over = [s.milliseconds - 1.15 * s.run_milliseconds.sum() for s in navigate(policy, live)]
    assert np.quantile(over, 0.25) < 2.0  # a busy machine delays some frames by more


class Keeps:
    """A localiser that keeps all rows, and asks for each twice."""

    def reset(self, references: int, techniques: int) -> None:
        self.rows: list[np.ndarray] = []

    def locate(self, frame, run):
        self.rows.append(run(0))
        np.testing.assert_array_equal(run(0), self.rows[-1])
        return int(np.argmax(self.rows[-1])), 0.0


def test_a_localisers_rows_stay_and_are_charged_once():
    maps = [CountingMap(one) for one in maps_of(6)]
    images = traverse(120, 2)
    live = live_of(maps, images)
    policy = Keeps()
    assert isinstance(policy, Localiser)
    assert sum(len(s.active) for s in navigate(policy, live)) == 120
    assert maps[0].calls == 120
    for row, image in zip(policy.rows, images, strict=True):
        np.testing.assert_array_equal(row, maps[0].inner.scores(maps[0].describe_query(image)))


# ---- traces as they go -------------------------------------------------------------------------


def read(path: Path) -> list[list[str]]:
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


@pytest.mark.parametrize("spec", ["amusic", "raw:CALC"])
def test_the_csv_is_that_of_a_trace_and_the_milliseconds(spec, tmp_path):
    _, live = cached_pair(60, 40)
    whole = read(rollout(policy_on(spec, live), live, name=spec).write_csv(tmp_path / "whole.csv"))
    path = tmp_path / "new" / "live.csv"
    seen: list[FrameResult] = []
    with TraceWriter(path, live) as writer:
        for result in navigate(policy_on(spec, live), live):
            writer.write(result)
            seen.append(result)
            assert len(read(path)) == 1 + len(seen)  # at once
    head, *lines = read(path)
    count = len(CSV_COLUMNS)
    names = [f"{name}_milliseconds" for name in NAMES]
    assert head[count:] == ["milliseconds", "read_milliseconds", *names]
    assert [line[:count] for line in (head, *lines)] == [line[:count] for line in whole]
    for line, result in zip(lines, seen, strict=True):
        times = [result.milliseconds, result.read_milliseconds, *result.run_milliseconds]
        assert line[count:] == [f"{value:.3f}" for value in times]


def test_the_csv_is_whole_after_ctrl_c_and_needs_no_truth(tmp_path):
    live = live_of(maps_of(9), traverse(9, 2))
    policy = policy_on("music", live)
    writer = TraceWriter(tmp_path / "t.csv", live)

    def drive() -> None:
        with writer:
            for result in navigate(policy, live):
                if result.frame == 4:
                    raise KeyboardInterrupt
                writer.write(result)

    with pytest.raises(KeyboardInterrupt):
        drive()
    head, *lines = read(tmp_path / "t.csv")
    assert [line[head.index("frame")] for line in lines] == ["0", "1", "2", "3"]
    assert {line[head.index("correct")] for line in lines} == {""}
    writer.close()


# ---- for hours ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["amusic", "subset:HOG+CALC"])
def test_a_drive_of_8000_frames_keeps_nothing_after_the_first_2000(spec):
    images = traverse(40, 2)

    class Endless(Stream):
        def read(self, frame):
            return images[frame % 40]

    route = live_of(maps_of(20), Endless(images))
    drive = navigate(policy_on(spec, route), route)
    for _ in range(2_000):
        next(drive)
    tracemalloc.start()
    try:
        for _ in range(6_000):
            next(drive)
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] < 0.1e6
    finally:
        tracemalloc.stop()
