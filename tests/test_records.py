"""An outcome: records and arrays in one piece of memory, which belongs to whoever gets it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from amusic_gym.envs.outcome import Outcome, OutcomeTable


def filled(routes: int, slots: int, block: int, seed: int) -> tuple[NDArray[Any], Outcome]:
    """Random bytes, and the outcome that lies in them."""
    sizes = {"routes": routes, "slots": slots, "block": block, "entries": 7 * slots + 3}
    layout = OutcomeTable.one_record(sizes)
    memory = np.random.default_rng(seed).integers(0, 2, layout.itemsize, np.uint8)
    record: Any = np.ndarray((), layout, memory)
    return memory, Outcome(*(record[name] for name in Outcome._fields))


def contents(out: Outcome) -> list[object]:
    return [array.tolist() for array in out]


@pytest.mark.parametrize(
    ("routes", "slots", "block"), [(1, 1, 0), (1, 4, 7), (5, 3, 0), (64, 4, 2)]
)
def test_arrays_lie_apart_from_each_other_in_one_piece_of_memory(routes, slots, block):
    memory, out = filled(routes, slots, block, 0)
    assert [a.shape[:2] for a in out[1:3]] == [(routes, slots)] * 2
    assert out.corrections.shape[-1] == block
    assert all(array.flags.c_contiguous for array in out)  # as the kernels want them
    before = contents(out)
    for number, array in enumerate(out):
        array[...] = np.zeros((), array.dtype)
        assert np.shares_memory(array, memory) == (array.size > 0)
        assert contents(out)[number + 1 :] == before[number + 1 :]


@pytest.mark.parametrize("mask", [[True, False, True], [False] * 3, [True] * 3])
def test_only_and_take_leave_the_other_routes(mask):
    (_, one), (_, other), mask = filled(3, 2, 2, 1), filled(3, 2, 2, 2), np.array(mask)
    before = contents(one)
    for ours, all_of_them in zip(one.only(mask), one, strict=True):
        assert ours[mask].tolist() == all_of_them[mask].tolist()
        assert ours[~mask].tolist() == np.zeros_like(ours[~mask]).tolist()
    assert contents(one) == before
    taken = one.copy()
    taken.take(other, mask)
    for ours, old, new in zip(taken, one, other, strict=True):
        assert ours[mask].tolist() == new[mask].tolist()
        assert ours[~mask].tolist() == old[~mask].tolist()
    assert contents(one) == before
