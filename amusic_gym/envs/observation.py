"""The observation: what a robot would know, one group per technique and one for the route.

The names below are the layout; :func:`observe_technique` and :func:`observe_route` write them in
this order, and the environment's docstring explains each.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.batch import RouteState, SlotState
from amusic_gym.estimation.prediction import sigmoid
from amusic_gym.estimation.settings import COMPUTE_WEIGHT_RANGE
from amusic_gym.kernels.compiling import inner

VERSION = 6
"""Rises whenever the meaning or the order of an entry changes; trained runs store it."""

TECHNIQUE_FEATURES = (
    "present",
    "ran",
    "statistic",
    "margin",
    "correction",
    "agrees",
    "agreement",
    "support",
    "support_mean",
    "stored",
    "weight",
    "age",
    "chosen",
    "cost_share",
    "cost_log",
    "price",
    "confirms",
    "confirmation",
    "support_usual",
    "dissent",
)
ROUTE_FEATURES = (
    "compute_weight",
    "has_prediction",
    "statistic",
    "margin",
    "p_correct",
    "p_correct_mean",
    "continues",
    "since_doubt",
    "elapsed",
    "compute",
    "compute_mean",
    "agreeing",
    "p_steady",
    "log_likelihood",
    "log_likelihood_mean",
    "size",
    "logit",
    "since_confirmed",
    "track",
    "supported",
    "on_map",
)

WIDTH = len(TECHNIQUE_FEATURES)
"""Entries of a technique's group."""

SQUASH_HALF = 4.0
"""The number that squash maps to one half."""

TINY = 1e-9
"""Stands for 0 where a logarithm is taken."""

_LOG_LOW = math.log10(COMPUTE_WEIGHT_RANGE[0])
_LOG_SPAN = math.log10(COMPUTE_WEIGHT_RANGE[1]) - _LOG_LOW


def observation_size(slots: int) -> int:
    """Length of the flat observation for a number of technique slots."""
    return slots * WIDTH + len(ROUTE_FEATURES)


@inner
def squash(value: float) -> float:
    """Map any number to (−1, 1): value / (|value| + 4).

    One division: forty of them are written per route and step.
    """
    return value / (abs(value) + SQUASH_HALF)


@inner
def observe_technique(slot: SlotState, route: RouteState, out: NDArray[np.float32]) -> None:
    """Write one technique's group to ``out``."""
    out[0] = 1.0
    out[1] = slot.ran
    out[2] = squash(slot.statistic)
    out[3] = squash(slot.margin)
    out[4] = squash(slot.correction)
    out[5] = slot.agrees
    out[6] = slot.agreement
    out[7] = squash(slot.support)
    out[8] = squash(slot.support_mean)
    out[9] = squash(slot.stored)
    out[10] = slot.weight
    out[11] = squash(route.frame - slot.last_run) if slot.last_run >= 0 else 1.0
    out[12] = slot.chosen
    out[13] = slot.cost_share
    out[14] = slot.cost_log
    out[15] = slot.price
    out[16] = slot.confirms
    out[17] = slot.confirmation
    out[18] = squash(slot.support_usual)
    out[19] = squash(slot.statistic - slot.stored)


@inner
def observe_route(route: RouteState, out: NDArray[np.float32]) -> None:
    """Write the route's group to ``out``."""
    out[0] = route.weight_log
    out[1] = 1.0 if route.prediction >= 0 else 0.0
    out[2] = squash(route.confidence)
    out[3] = squash(route.margin)
    out[4] = route.p_correct
    out[5] = route.p_correct_mean
    out[6] = route.continues
    out[7] = squash(route.since_doubt)
    out[8] = squash(route.frame + 1)
    out[9] = squash(route.compute)
    out[10] = squash(route.compute_mean)
    out[11] = route.agreeing
    out[12] = route.p_steady
    out[13] = squash(route.log_likelihood)
    out[14] = squash(route.log_likelihood_mean)
    out[15] = route.size_log
    out[16] = squash(route.logit)
    out[17] = squash(route.since_confirmed)
    out[18] = squash(route.track)
    out[19] = route.support
    out[20] = sigmoid(route.on_map)


def weight_entry(weight: Any) -> Any:
    """λ as the observation has it, on a logarithmic scale."""
    place = (np.log10(np.maximum(weight, TINY)) - _LOG_LOW) / _LOG_SPAN
    return np.clip(2.0 * place - 1.0, -1.0, 1.0)


def price_entry(weight: Any, share: Any) -> Any:
    """λ times a technique's share of the costs as the observation has it."""
    price = np.log10(np.maximum(weight * share, TINY))
    return np.clip(0.5 * price + 0.5, -1.0, 1.0)


def declare_costs(route: NDArray[Any], slots: NDArray[Any]) -> None:
    """Write the entries that hold for an episode to its route (1,) and slots (S,)."""
    present = slots["present"] > 0
    share = slots["seconds"][present] / route["total_seconds"]
    slots["cost_share"][present] = share
    slots["cost_log"][present] = np.maximum(1.0 + np.log10(share) / 4.0, -1.0)
    slots["price"][present] = price_entry(route["compute_weight"], share)
    route["size_log"] = np.clip(np.log10(route["references"]) / 3.0 - 1.0, -1.0, 1.0)
    route["weight_log"] = weight_entry(route["compute_weight"])


def limit_compute_weight(
    observation: NDArray[np.float32], low: float, high: float
) -> NDArray[np.float32]:
    """Observations (N, D) of λ below or above a range, as they are at its nearest end."""
    width, place = len(ROUTE_FEATURES), ROUTE_FEATURES.index("compute_weight")
    entry = observation[:, -width + place]
    nearest = np.where(entry < np.float32(weight_entry(low)), low, np.nan)
    nearest = np.where(entry > np.float32(weight_entry(high)), high, nearest)
    outside = ~np.isnan(nearest)
    if not outside.any():
        return observation
    limited = observation.copy()
    limited[outside, -width + place] = weight_entry(nearest[outside])
    present, share, price = (
        limited[:, TECHNIQUE_FEATURES.index(name) : -width : WIDTH]  # views, (N, S)
        for name in ("present", "cost_share", "price")
    )
    changed = (present > 0) & outside[:, None]
    price[changed] = price_entry(nearest[:, None], share.astype(np.float64))[changed]
    return limited


def observation_names(techniques: tuple[str, ...]) -> list[str]:
    """Name of every entry of the observation, in order."""
    names = [f"{t}.{feature}" for t in techniques for feature in TECHNIQUE_FEATURES]
    return names + [f"route.{feature}" for feature in ROUTE_FEATURES]


def bounds(slots: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lower and upper bounds (D,) float32 of the observation."""
    size = observation_size(slots)
    return np.full(size, -1.0, np.float32), np.full(size, 1.0, np.float32)
