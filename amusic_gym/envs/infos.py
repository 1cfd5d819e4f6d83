"""Infos of a step: what the outcome holds, by name, in arrays of their own."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.outcome import Outcome, RouteResult

Infos = dict[str, Any]
Terms = dict[str, NDArray[np.float64]]

_RESULTS = list(RouteResult.dtype.names or ())
ROUTE_INFOS = _RESULTS[: 1 + _RESULTS.index("compute_weight")]
TECHNIQUE_INFOS = ("ran", "place", "statistic", "correction", "present", "run_seconds")
SELECTION_INFOS = ("tally", "selected", "late_runs")


def batch_infos(out: Outcome, terms: Terms, mask: NDArray[np.bool_] | None = None) -> Infos:
    """Infos as Gymnasium's vector environments give them: name → array with leading N.

    Args:
        out: what the step gave.
        terms: of the reward.
        mask: (N,) routes that they are of; zero and unset outside. None: all.
    """
    if mask is not None and not mask.all():
        out = out.only(mask)
        terms = {name: np.where(mask, term, 0.0) for name, term in terms.items()}
    routes, slots = out.routes, out.slots
    infos: Infos = {name: routes[name].copy() for name in ROUTE_INFOS}
    for name in TECHNIQUE_INFOS:
        infos[name] = slots[name].copy()
    infos["reward_terms"] = _with_masks(dict(terms), mask, len(routes))
    if out.shape.block:
        selection = {"happened": routes["happened"].copy(), "corrections": out.corrections}
        for name in SELECTION_INFOS:
            selection[name] = slots[name].copy()
        infos["selection"] = _with_masks(selection, mask, len(routes))
    return _with_masks(infos, mask, len(routes))


def _with_masks(infos: Infos, mask: NDArray[np.bool_] | None, routes: int) -> Infos:
    """Infos with a mask (N,) after each, an array of its own."""
    masks = np.empty((len(infos), routes), np.bool_)
    masks[:] = True if mask is None else mask
    result: Infos = {}
    for (name, value), its in zip(infos.items(), masks, strict=True):
        result[name], result["_" + name] = value, its
    return result


def single_info(out: Outcome, results: tuple[Any, ...], terms: Mapping[str, float]) -> Infos:
    """Infos of a batch of one as a single environment gives them: numbers and (T,) arrays.

    Args:
        out: what the step gave.
        results: what its ``first`` says.
        terms: of the reward.
    """
    slots = out.slots[0]
    infos: Infos = dict(zip(ROUTE_INFOS, results, strict=False))
    for name in TECHNIQUE_INFOS:
        infos[name] = slots[name].copy()
    infos["reward_terms"] = terms
    if out.shape.block:
        happened = results[_RESULTS.index("happened")]
        infos["selection"] = {"happened": happened, "corrections": out.corrections[0]}
        for name in SELECTION_INFOS:
            infos["selection"][name] = slots[name].copy()
    return infos
