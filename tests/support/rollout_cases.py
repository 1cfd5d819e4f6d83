"""A policy whose rollouts are known, and the comparison of traces."""

from __future__ import annotations

import numpy as np

from amusic_gym.policies.protocol import Needs
from amusic_gym.policies.trace import Trace

ARRAYS = (
    "predictions",
    "confidence",
    "similarity",
    "p_correct",
    "chosen",
    "ran",
    "late_runs",
    "selections",
    "correct",
    "has_place",
    "error",
)


def assert_same(one: Trace, other: Trace) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    assert (one.bank, one.techniques) == (other.bank, other.techniques)


class Cycle:
    """Runs one technique after the other; keeps what it is shown."""

    def __init__(self, **needs) -> None:
        self.needs = Needs(**needs)
        self.resets: list[np.ndarray] = []
        self.weights: list[np.ndarray] = []

    def reset(self, mask):
        self.resets.append(mask.copy())

    def act(self, observation, info):
        self.weights.append(info["compute_weight"].copy())
        turn = (info["frame"] + 1) % info["present"].sum(axis=1)
        actions = np.zeros(info["present"].shape, np.bool_)
        actions[np.arange(turn.size), turn] = True
        if self.needs.reselection is not None:
            actions = np.column_stack([actions, (info["frame"] + 1) % 7 == 3])
        return actions


def rows_of(bank, frame):
    """A `Run` of one frame of a bank, and the list of what it ran."""
    asked = []

    def run(technique):
        asked.append(technique)
        return bank.row(technique, frame)

    return run, asked


def localise(policy, bank):
    """Places and confidences of a whole bank."""
    policy.reset(bank.references, len(bank.techniques))
    frames = range(bank.queries)
    return zip(*(policy.locate(q, rows_of(bank, q)[0]) for q in frames), strict=True)
