"""SIC and MuSIC as the estimator of an environment: one frame of a batch of routes.

SIC corrects each technique that ran (A-MuSIC, III-A; :mod:`amusic_gym.estimation.sic.sums`), MuSIC
chooses among them (III-B), and p̂ says how likely the place is a true one.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from typing import Any

from amusic_gym.banks.rows import correlation, prepared_at
from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.prediction import (
    choose_technique,
    logit_of,
    predict_only,
    relate,
    set_prediction,
    sigmoid,
)
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic.look_back import look_back
from amusic_gym.estimation.sic.state import (
    CARRIED,
    SLACK,
    SICState,
    begin_sums,
    factors_of,
    state_at,
)
from amusic_gym.estimation.sic.sums import (
    best_rival,
    correct_frame,
    count_runs,
    score_places,
    store_result,
)
from amusic_gym.kernels.compiling import apart, compiled, inner, spliced

SUPPORT_MEMORY = 0.98
"""Factor per frame on what a technique's last match counts for or against the prediction."""


@spliced
def correct_techniques(state: SICState, i: int, frame: int) -> None:
    """Run SIC for the techniques that run on the frame."""
    batch = state.batch
    for s in range(batch.slots[i].size):
        slot = batch.slots[i, s]
        if slot.present:
            count_runs(state, i, s, frame, frame + 1)
        if slot.ran:
            own = slot.place + frame - slot.last_run if slot.last_run >= 0 else -1
            prediction = batch.routes[i].prediction
            fused = prediction + 1 if prediction >= 0 else -1
            winner = correct_frame(state, i, s, frame, own, fused)
            store_result(state, i, s, frame, winner)
            if batch.block:
                state.places[i, s, frame] = slot.place


@apart
def weigh_others(state: SICState, i: int, frame: int) -> None:
    """Weigh what the techniques that were not chosen say of the prediction.

    A technique counts less the longer ago it ran, and less the more its row was like the chosen
    one's, where they last ran together; a constant row says nothing at all. ``heard`` is the
    highest weight of all, ``support`` that of those whose last match, moved on, is the prediction;
    both in [0, 1].
    """
    slots, route = state.batch.slots[i], state.batch.routes[i]
    chosen = route.technique
    route.heard, route.support = 0.0, 0.0
    for s in range(slots.size):
        slot = slots[s]
        if s == chosen or slot.last_run < 0 or not slot.present:
            continue
        if slot.ran:
            one, other = state.batch.runs[i, chosen], state.batch.runs[i, s]
            slot.likeness = correlation(one, frame, other, frame, 0)
            if prepared_at(one, frame).scale == 0.0 or prepared_at(other, frame).scale == 0.0:
                slot.likeness = 1.0  # a constant row says nothing
        age = frame - slot.last_run
        weight = (1.0 - min(max(slot.likeness, 0.0), 1.0)) * SUPPORT_MEMORY**age
        route.heard = max(route.heard, weight)
        if abs(slot.place + age - route.prediction) <= route.tolerance:
            route.support = max(route.support, weight)


@inner
def fuse(state: SICState, i: int, frame: int) -> bool:
    """Take the match of the technique with the highest statistic (MuSIC, III-B).

    Returns:
        Whether a candidate beyond the tolerance stands against the prediction.
    """
    slots, route = state.batch.slots[i], state.batch.routes[i]
    chosen = choose_technique(state.batch, i)
    place = slots[chosen].place
    rival = -math.inf
    for s in range(slots.size):
        if not slots[s].ran:
            continue
        best = slots[s].rival
        if slots[s].place != place:  # else it is that of the technique itself
            best = best_rival(state, i, s, place)
        rival = max(rival, best * slots[s].discount)
    set_prediction(route, place)
    route.confidence = slots[chosen].statistic
    discounted = slots[chosen].statistic * slots[chosen].discount
    route.margin = discounted - rival if rival > -math.inf else 0.0
    weigh_others(state, i, frame)
    return rival > -math.inf


@inner
def store_fused(state: SICState, i: int, frame: int) -> None:
    """Store the statistic that the diagonal of the prediction had at each technique's last run."""
    slots, route = state.batch.slots[i], state.batch.routes[i]
    for s in range(slots.size):
        slot = slots[s]
        if slot.present and slot.last_run >= 0 and route.prediction >= 0:
            place = route.prediction - (frame - slot.last_run)
            slot.stored = 0.0
            if place >= 0:
                places, values = state.candidates[s], state.values[s]
                places[0] = place
                slot.stored = score_places(state, i, s, slot.last_run, places, 1, values)


@inner
def estimate_correctness(state: SICState, i: int, has_rival: bool) -> None:
    """Estimate the correctness p̂ of the prediction: see amusic_gym.estimation.calibration."""
    route, b = state.batch.routes[i], state.calibration
    slot = state.batch.slots[i, route.technique]
    first, late = (0, 6) if has_rival else (8, 11)
    drive = b[first] + b[first + 1] * math.asinh(slot.statistic * slot.discount)
    drive += b[first + 2] * math.log1p(10.0 * route.track)
    if has_rival:
        drive += b[3] * route.heard + b[4] * route.support + b[5] * math.asinh(route.margin)
    route.p_correct = sigmoid(drive) * sigmoid(b[late] + b[late + 1] * route.on_map)
    route.logit = logit_of(route.p_correct)


@compiled
def update_routes(address: int) -> None:
    """Take the active routes' next frame: correct what ran, fuse, and estimate correctness.

    Args:
        address: of the words of a :class:`~amusic_gym.estimation.sic.state.SICState`.
    """
    state = state_at(address)
    batch = state.batch
    for i in range(batch.active.size):
        if batch.active[i]:
            route = batch.routes[i]
            frame = route.frame + 1
            has_rival = False
            correct_techniques(state, i, frame)
            if route.idle:
                predict_only(route)
            else:
                has_rival = fuse(state, i, frame)
            store_fused(state, i, frame)
            relate(batch, i, frame)
            if not route.idle:
                estimate_correctness(state, i, has_rival)
            if batch.block:
                state.predictions[i, frame] = route.prediction
            route.frame = frame


@compiled
def count_frame(address: int, frame: int) -> None:
    """Count the runs of a frame of a batch of one technique (:class:`SIC`)."""
    count_runs(state_at(address), 0, 0, frame, frame + 1)


@compiled
def correct_one(address: int, frame: int, own: int, fused: int) -> int:
    """As :func:`correct_frame`, of a batch of one technique (:class:`SIC`)."""
    return correct_frame(state_at(address), 0, 0, frame, own, fused)


class SICEstimator:
    """See :class:`~amusic_gym.estimation.estimator.Estimator`.

    Args:
        settings: statistic, K, F and γ.
        block: M, 0 without re-selection.
        threads: not used: a frame is too short to share.

    Attributes:
        address: of the words that the kernels read.
    """

    state: SICState

    def __init__(self, settings: SICSettings, *, block: int, threads: int = 1) -> None:
        self.settings = settings
        self._block = block

    def allocate(self, batch: Batch, sizes: Mapping[str, int]) -> None:
        """Make room."""
        settings, evidence = self.settings, self.settings.statistic == "evidence"
        factors = factors_of(min(settings.history, sizes["references"]) + 1, evidence)
        calibration = coefficients(settings.statistic).copy()
        sizes = {
            **sizes,
            "coefficients": len(calibration),
            "factors": len(factors),
            "sets": 2 if self._block else 1,
            "sums": sizes["references"] + SLACK,
            "counts": sizes["frames"] + 1,
            "prefix": 0 if settings.gamma == 1.0 else sizes["frames"] + 1,
            "replayed": sizes["frames"] if self._block else 0,
            "values": sizes["candidates"] + CARRIED,
        }
        given = {"batch": batch, "factors": factors, "calibration": calibration}
        if hasattr(self, "state"):
            self.state = self.state.grown(sizes, **given)
        else:
            self.state = SICState(
                sizes,
                history=settings.history,
                gamma=settings.gamma,
                ratio=settings.gamma * settings.gamma if evidence else settings.gamma,
                evidence=evidence,
                carry=settings.carry,
                **given,
            )
        self.link(batch)

    def begin(self, i: int, references: int) -> None:
        """Forget route ``i``."""
        state = self.state
        for array in (state.sums[:, i], state.counts[i], state.prefix[i]):
            array.fill(0)
        begin_sums(state.marks[:, i], references, state.sums.shape[-1], self.settings)

    def update(self) -> None:
        """Take the next frame of every active route."""
        update_routes(self.address)

    def look_back(self) -> None:
        """Run all techniques on the last block of the routes that want it."""
        look_back(self.address)

    def link(self, batch: Batch) -> None:
        """Write the addresses of all arrays anew."""
        self.state.batch = batch
        self._words = self.state.write()
        self.address: int = self._words.ctypes.data

    def repeated(self, batch: Batch, copies: int) -> SICEstimator:
        """For a batch in which every route stands ``copies`` times in a row."""
        twin = copy.copy(self)
        twin.state = self.state.repeated(copies, batch=batch)
        twin.link(batch)
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """All but the addresses, which :meth:`link` writes again."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_words", "address")}
