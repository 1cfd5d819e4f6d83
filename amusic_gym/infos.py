"""Infos of a step: what the outcome holds, by name.

Their arrays are views of the outcome, whose memory belongs to the one step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.records import RESULT, Outcome

Infos = dict[str, Any]
Terms = dict[str, NDArray[np.float64]]

_RESULTS = list(RESULT.names or ())
ROUTE_INFOS = _RESULTS[: 1 + _RESULTS.index("compute_weight")]
TECHNIQUE_INFOS = ("ran", "place", "statistic", "correction", "present", "run_seconds")
SELECTION_INFOS = ("tally", "selected", "late_runs")


def batch_infos(out: Outcome, terms: Terms) -> Infos:
    """Infos of a batch: name → array with leading N; the same names at every step."""
    routes, slots = out.routes, out.slots
    infos: Infos = {name: routes[name] for name in ROUTE_INFOS}
    for name in TECHNIQUE_INFOS:
        infos[name] = slots[name]
    infos["reward_terms"] = dict(terms)
    if out.shape.block:
        infos["selection"] = {"happened": routes["happened"], "corrections": out.corrections}
        for name in SELECTION_INFOS:
            infos["selection"][name] = slots[name]
    return infos


def single_infos(
    out: Outcome, results: tuple[Any, ...], terms: Mapping[str, float]
) -> Infos:
    """Infos of a batch of one as a single environment gives them: numbers and (T,) arrays.

    Args:
        out: what the step gave.
        results: what its ``first`` says.
        terms: of the reward.
    """
    slots = out.slots[0]
    infos: Infos = dict(zip(ROUTE_INFOS, results, strict=False))
    for name in TECHNIQUE_INFOS:
        infos[name] = slots[name]
    infos["reward_terms"] = terms
    if out.shape.block:
        happened = results[_RESULTS.index("happened")]
        infos["selection"] = {"happened": happened, "corrections": out.corrections[0]}
        for name in SELECTION_INFOS:
            infos["selection"][name] = slots[name]
    return infos


def masked(infos: Infos, mask: NDArray[np.bool_]) -> Infos:
    """Infos as Gymnasium's vector environments give them: zero and unset outside ``mask``."""
    count = sum(1 + (len(value) if isinstance(value, dict) else 0) for value in infos.values())
    masks = list(np.repeat(mask[np.newaxis], count, axis=0))  # a row each: none is shared
    return _masked(infos, None if mask.all() else mask, masks)


def _masked(infos: Infos, mask: NDArray[np.bool_] | None, masks: list[Any]) -> Infos:
    result: Infos = {}
    for name, value in infos.items():
        if isinstance(value, dict):
            value = _masked(value, mask, masks)
        elif mask is not None:
            kept = mask.reshape(-1, *[1] * (value.ndim - 1))
            value = np.where(kept, value, np.zeros_like(value))
        result[name], result["_" + name] = value, masks.pop()
    return result
