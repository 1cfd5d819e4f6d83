"""An outcome's memory: what it says, and that it is used again only when nobody looks at it."""

from __future__ import annotations

import copy
import pickle
import sys
from typing import Any

import numpy as np
import pytest

from amusic_gym.envs.outcome import KEPT, Outcome, OutcomeShape, RouteResult


def filled(shape: OutcomeShape, seed: int) -> Outcome:
    out = Outcome(shape)
    rng = np.random.default_rng(seed)
    for array in (out.routes, out.slots):
        for name in array.dtype.names:
            array[name] = rng.integers(0, 2, array.shape)
    out.corrections[:] = rng.random(out.corrections.shape)
    out.observation[:] = rng.random(out.observation.shape)
    return out


def contents(out: Outcome) -> list[object]:
    return [array.tolist() for array in out.arrays()]


@pytest.mark.parametrize(
    ("routes", "slots", "block"), [(1, 1, 0), (1, 4, 7), (5, 3, 0), (64, 4, 2)]
)
def test_arrays_lie_apart_from_each_other_in_one_piece_of_memory(routes, slots, block):
    out = filled(OutcomeShape(routes, slots, block), 0)
    assert [a.shape[:2] for a in out.arrays()[1:3]] == [(routes, slots)] * 2
    assert out.corrections.shape[-1] == block
    before = contents(out)
    for number, array in enumerate(out.arrays()):
        array[...] = np.zeros((), array.dtype)
        after = contents(out)
        assert [a for i, a in enumerate(after) if i > number] == before[number + 1 :]
    assert not out.memory.any()


def test_first_gives_the_record_as_numbers():
    out = filled(OutcomeShape(1, 2, 0), 3)
    out.routes["confidence"], out.routes["frame"] = -0.25, 2**40
    assert out.first() == out.routes[0].item()
    assert [type(value) for value in out.first()] == [type(v) for v in out.routes[0].item()]
    assert len(out.first()) == len(RouteResult.dtype.names)


@pytest.mark.parametrize("mask", [[True, False, True], [False] * 3, [True] * 3])
def test_only_and_take_leave_the_other_routes(mask):
    shape, mask = OutcomeShape(3, 2, 2), np.array(mask)
    one, other = filled(shape, 1), filled(shape, 2)
    kept = one.only(mask)
    for ours, all_of_them in zip(kept.arrays(), one.arrays(), strict=True):
        assert ours[mask].tolist() == all_of_them[mask].tolist()
        assert ours[~mask].tolist() == np.zeros_like(ours[~mask]).tolist()
    before = one.copy()
    one.take(other, mask)
    for ours, old, new in zip(one.arrays(), before.arrays(), other.arrays(), strict=True):
        assert ours[mask].tolist() == new[mask].tolist()
        assert ours[~mask].tolist() == old[~mask].tolist()


def test_memory_is_used_again_once_nothing_refers_to_it():
    shape = OutcomeShape(2, 2, 0)
    source = filled(shape, 0)
    addresses = {source.copy().memory.ctypes.data for _ in range(50)}
    assert len(addresses) == 1


@pytest.mark.parametrize(
    "keep",
    [
        lambda out: out.memory,
        lambda out: out.observation,
        lambda out: out.observation[0],
        lambda out: out.observation[1:, ::2].T,
        lambda out: out.routes["frame"],
        lambda out: memoryview(out.observation),
        lambda out: {"deep": [out.slots["place"][0]]},
    ],
)
def test_memory_that_someone_looks_at_is_left_alone(keep):
    shape = OutcomeShape(2, 2, 0)
    kept, saved = [], []
    for number in range(3 * KEPT):
        source = filled(shape, number)
        saved.append(pickle.dumps(_plain(keep(source))))
        kept.append(keep(source.copy()))
    for number in range(3 * KEPT):
        filled(shape, 100 + number).copy()
    assert [pickle.dumps(_plain(view)) for view in kept] == saved


def _plain(view: object) -> object:
    return view["deep"][0] if isinstance(view, dict) else np.asarray(view).copy()


def test_a_tracer_that_looks_at_variables_does_not_free_what_is_held():
    """Debuggers hold a reference to every variable of the functions that they stop in."""
    shape = OutcomeShape(2, 2, 0)
    before = sys.gettrace()

    def trace(frame: Any, event: str, argument: Any) -> Any:
        assert frame.f_locals is not None
        return trace

    sys.settrace(trace)
    try:
        kept = [filled(shape, number).copy() for number in range(2)]
    finally:
        sys.settrace(before)
    saved = [contents(out) for out in kept]
    for number in range(2 * KEPT):
        filled(shape, 100 + number).copy()
    assert [contents(out) for out in kept] == saved


def test_a_deep_copy_has_memory_of_its_own():
    shape = OutcomeShape(2, 2, 0)
    out = filled(shape, 0).copy()
    twin = copy.deepcopy(out)
    before = contents(twin)
    out.memory.fill(0)
    twin.shape.memory().fill(7)
    assert contents(twin) == before
