"""The belief in explicit loops: every formula written out, nothing shared with the kernels.

A route's belief is a dictionary from a way of moving to its line of R numbers. A way is a speed
(0, 0.5, 1, 1.5 or 2 places per frame, with jumps), "locked" (steady motion in which images look
like the place they are of), or ("wander", off): steady motion in which they look like the place
`off` places ahead.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import oracle
from numpy.typing import NDArray

from amusic_gym.estimation.belief import Rates

Floats = NDArray[np.float64]
Row = Any  # (R,) scores, or None: the technique did not run

SPEEDS = {0.0: 1 / 8, 0.5: 1 / 8, 1.0: 1 / 2, 1.5: 1 / 8, 2.0: 1 / 8}  # and how often each is drawn
OFFS = range(-3, 4)
WAYS: list[Any] = [*SPEEDS, "locked", *(("wander", off) for off in OFFS)]
LEAST = 1e-12  # of what a logarithm is taken of
EQUAL = 1e-9  # numbers that differ by less, relatively, are ties


@dataclass
class Technique:
    """What is known of a technique."""

    usual: Floats  # of each place: mean and variance of its z-scores
    spread: Floats
    kinds: Floats  # probabilities that its rows say nothing, or are of sharpness 1, 2 and 4
    count: int = 0
    last: Row = None
    last_frame: int = -1
    novelty: float = 0.0
    contrast: float = 0.0
    weight: float = 0.0


@dataclass
class Own:
    """What one technique's row made of the belief."""

    place: int
    statistic: float
    correction: float
    margin: float
    weight: float
    trust: float = 0.0
    once: float = 0.0
    twice: float = 0.0
    fourfold: float = 0.0
    said: float = 0.0


@dataclass
class Frame:
    """What a frame came to."""

    place: int
    share: float
    rival: float
    steady: float
    strange: float
    said: float
    heard: int
    places: Floats
    own: list[Any] = field(default_factory=list)  # an Own of each technique that ran, else None


def log(share: float) -> float:
    return math.log(max(share, LEAST))


def log_odds(share: float) -> float:
    return log(share) - log(1.0 - share)


def offs_chance(off: int) -> float:
    return math.comb(6, off + 3) / 2**6


def start_of(rates: Rates, way: Any) -> float:
    """Belief in a way of moving before anything is seen."""
    if way in SPEEDS:
        return (1 - rates.steady) * SPEEDS[way]
    if way == "locked":
        return rates.steady * (1 - rates.wandering)
    return rates.steady * rates.wandering * offs_chance(way[1])


def clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


def clip_place(place: int, size: int) -> int:
    """What would look beyond an end of the map looks like that end."""
    return int(clamp(place, 0, size - 1))


# ---- rows --------------------------------------------------------------------------------


def candidates(row: Floats) -> Floats:
    """The scores of a row but -inf, which is for no candidate; 0 where there is none."""
    return row[row > -math.inf] if (row > -math.inf).any() else np.zeros(1)


def is_constant(row: Floats) -> bool:
    return bool(candidates(row).min() == candidates(row).max())


def z_scores(row: Floats) -> Floats:
    """Zero also for places that are no candidates."""
    if is_constant(row):
        return np.zeros_like(row)
    z: Floats = (row - candidates(row).mean()) / candidates(row).std()
    return np.where(row > -math.inf, z, 0.0)


def novelty_of(row: Floats, before: Floats | None) -> float | None:
    """1 - correlation; None for a technique's first row, and with a constant one."""
    if before is None or is_constant(row) or is_constant(before):
        return None
    both = (row > -math.inf) & (before > -math.inf)
    alike = float((z_scores(row) * z_scores(before)).sum()) / max(both.sum(), 1)
    return clamp(1.0 - alike, 0.0, 2.0)


def weight_of(rates: Rates, known: Technique, row: Floats, novelty: float | None) -> float:
    """How much a row says; takes in its deviation."""
    constant = is_constant(row)
    contrast = 0.0 if constant else float(candidates(row).std())
    weight = 0.0 if constant else 1.0
    if known.last is None:
        known.contrast = contrast
        return weight
    if novelty is not None:
        weight *= rates.repeat + (1 - rates.repeat) * min(1.0, novelty / rates.novel)
    if contrast < known.contrast:
        weight *= (contrast / known.contrast) ** rates.contrast
    known.contrast = 0.9 * known.contrast + 0.1 * contrast
    return weight


def without_hubs(rates: Rates, known: Technique, row: Floats) -> Floats:
    """Clipped z-scores less what each place usually gets, which they then add to."""
    z, values = z_scores(row), np.zeros(len(row))
    surely = known.count / (known.count + rates.hub_count)
    step = 1.0 / (min(known.count, rates.hub_memory) + 1.0)
    for place in range(len(row)):
        variance = 1.0 + surely * rates.hub_spread * (known.spread[place] - 1.0)
        value = z[place] - surely * rates.hub * known.usual[place]
        value /= math.sqrt(max(variance, 0.05))
        values[place] = clamp(value, -rates.most, rates.most)
        if row[place] == -math.inf:
            values[place] = 0.0 if is_constant(row) else -1000.0
        if is_constant(row) or row[place] == -math.inf:
            continue  # it tells of no place, or not of this one
        off = z[place] - known.usual[place]
        known.usual[place] += step * off
        known.spread[place] += step * (off * (z[place] - known.usual[place]) - known.spread[place])
    return values


def kinds_of(rates: Rates) -> Floats:
    """Probabilities of the kinds of rows before any is known."""
    sharper = rates.trust * rates.sharper
    sharpest = sharper * rates.sharpest
    return np.array([1.0 - rates.trust, rates.trust - sharper, sharper - sharpest, sharpest])


def likelihoods(rates: Rates, known: Technique, values: Floats) -> Floats:
    """Likelihood (4, R) of every place if rows say nothing, or are of sharpness 1, 2 and 4."""
    logs = []
    for value in values:
        bent = value + (rates.convexity * value**2 if value > 0 else 0.0)
        logs.append(rates.sharpness * known.weight * bent)
    soft = np.array(
        [(1.0 + max(x - max(logs), -60.0) / 1024.0) ** 1024 for x in logs]
    )  # e^, nearly
    by_kind = [soft**sharpness / np.mean(soft**sharpness) for sharpness in (1, 2, 4)]
    return np.array([np.ones(len(values)), *by_kind])


def learned(rates: Rates, known: Technique, by_kind: Floats, looks: Floats) -> Floats:
    """Probabilities of the kinds, after a row and the belief that it led to."""
    others = looks / (known.kinds @ by_kind)  # what the past and the other techniques say
    fits = by_kind @ others
    new: Floats = known.kinds * (fits / fits[0]) ** (rates.learn * known.weight)
    new = (1.0 - rates.relearn) * new / new.sum() + rates.relearn * kinds_of(rates)
    nothing = max(1.0 - new[1:].sum(), 0.01)
    new[1:] *= (1.0 - nothing) / new[1:].sum()
    new[0] = nothing
    return new


# ---- places ------------------------------------------------------------------------------


def windows_of(values: Floats, tolerance: int) -> list[float]:
    """Share of each place's surroundings."""
    whole = math.fsum(values)
    return [
        math.fsum(values[max(place - tolerance, 0) : place + tolerance + 1]) / whole
        for place in range(len(values))
    ]


def first_most(places: Sequence[int], values: Any) -> int:
    """Place of the highest value; of equal ones the first named."""
    most = max(values[place] for place in places)
    return next(place for place in places if values[place] >= most * (1 - EQUAL))


def likeliest(values: Floats, tolerance: int) -> tuple[int, float, float]:
    """Place that holds most of those with (almost) the best surroundings; their share; rival's."""
    windows = windows_of(values, tolerance)
    best = first_most(range(len(values)), windows)
    around = [c for c in range(len(values)) if c != best and abs(c - best) <= tolerance]
    good = [c for c in around if windows[c] >= 0.99 * windows[best]]
    place = first_most([best, *good], values)
    apart = [w for c, w in enumerate(windows) if abs(c - place) > 2 * tolerance]
    return place, min(windows[place], 1.0), max(apart, default=0.0)


def own_word(values: Floats, row: Floats, tolerance: int, weight: float) -> Own:
    """A technique's own place, and what it gains over the row's best place."""
    place, share, rival = likeliest(values, tolerance)
    statistic = log_odds(share)
    uncorrected = log_odds(min(windows_of(values, tolerance)[int(np.argmax(row))], 1.0))
    gain = max(statistic - uncorrected, 0.0)
    return Own(place, statistic, gain, log(share) - log(rival), weight)


# ---- motion ------------------------------------------------------------------------------


def moves_of(rates: Rates, speed: float, stand: float) -> dict[int, float]:
    """Chances of the places that a speed moves in a frame."""
    whole = int(speed)
    if speed != whole:
        moves = {whole: 0.5, whole + 1: 0.5}
    elif speed == 0.0:
        moves = {0: 1 - rates.slack, 1: rates.slack}
    else:
        moves = {whole - 1: rates.slack, whole: 1 - 2 * rates.slack, whole + 1: rates.slack}
    return {places: p * (stand if places == 0 else 1.0) for places, p in moves.items()}


def moved(line: Floats, moves: dict[int, float]) -> Floats:
    """A line moved on; what moves off the map is lost."""
    out = np.zeros(len(line))
    for place, value in enumerate(line):
        for places, p in moves.items():
            if place + places < len(line):
                out[place + places] += p * value
    return out


def mixed(rates: Rates, lines: dict[Any, Floats]) -> dict[Any, Floats]:
    """Speeds change, looks drift as in Ehrenfest's urns, steady motion ends and begins."""
    fast = sum(lines[way] for way in SPEEDS)
    even = sum(lines[way] for way in WAYS if way not in SPEEDS)
    out: dict[Any, Floats] = {}
    for speed, often in SPEEDS.items():
        changed = (1 - rates.change) * lines[speed] + rates.change * often * fast
        out[speed] = (1 - rates.settle) * changed + rates.leave * often * even
    gained = rates.settle * fast
    out["locked"] = (1 - rates.leave) * lines["locked"] + (1 - rates.wandering) * gained
    for off in OFFS:
        line = (1 - rates.wander) * lines["wander", off]
        if off > -3:
            line = line + rates.wander * (3 - (off - 1)) / 6 * lines["wander", off - 1]
        if off < 3:
            line = line + rates.wander * (3 + (off + 1)) / 6 * lines["wander", off + 1]
        begun = rates.wandering * offs_chance(off) * gained
        out["wander", off] = (1 - rates.leave) * line + begun
    return out


# ---- the filter --------------------------------------------------------------------------


class Belief:
    """The filter of one route: feed it the rows of each frame, None for what did not run."""

    def __init__(self, rates: Rates, techniques: int, references: int, tolerance: int) -> None:
        self.rates, self.size, self.tolerance = rates, references, tolerance
        self.frame = -1
        even = np.full(references, 1 / references)
        self.lines = {way: start_of(rates, way) * even for way in WAYS}
        self.known = [
            Technique(np.zeros(references), np.ones(references), kinds_of(rates))
            for _ in range(techniques)
        ]

    def hear(self, rows: Sequence[Row]) -> Frame:
        """Take in the next frame."""
        self.frame += 1
        rows = [None if row is None else np.asarray(row, np.float64) for row in rows]
        same, strange = self._compare(rows)
        values = [
            None if row is None else without_hubs(self.rates, known, row)
            for known, row in zip(self.known, rows, strict=True)
        ]
        for known, row in zip(self.known, rows, strict=True):
            if row is not None:
                known.count, known.last, known.last_frame = known.count + 1, row, self.frame
        if self.frame > 0:
            self._move(self.rates.stand if same else 1.0, strange)
        return self._weigh(rows, values, strange)

    def _compare(self, rows: Sequence[Row]) -> tuple[bool, float]:
        """Whether a row is that of the frame before; change of the rows over the usual one."""
        same, ratios = False, []
        for known, row in zip(self.known, rows, strict=True):
            if row is None:
                continue
            novelty = novelty_of(row, known.last)
            known.weight = weight_of(self.rates, known, row, novelty)
            if novelty is None:
                continue
            if known.last_frame == self.frame - 1:
                if novelty < 1e-4:
                    same = True
                elif known.novelty > 0:
                    ratios.append(novelty / known.novelty)
            if novelty >= 1e-4:
                usual = known.novelty or novelty
                known.novelty = 0.9 * usual + 0.1 * min(novelty, 3.0 * usual)
        return same, (math.fsum(ratios) / len(ratios) if ratios else 0.0)

    def _move(self, stand: float, strange: float) -> None:
        rates, size = self.rates, self.size
        lines = mixed(rates, self.lines)
        for way in WAYS:
            moves = moves_of(rates, way, stand) if way in SPEEDS else {1: 1.0}
            lines[way] = moved(lines[way], moves)
        whole = sum(line.sum() for line in lines.values())
        if whole < 1e-200:  # driven off the map
            self.lines = {way: np.full(size, start_of(rates, way) / size) for way in WAYS}
            return
        lines = {way: line / whole for way, line in lines.items()}
        rise = rates.jump_novel * (strange - rates.jump_usual) if strange > 0 else 0.0
        factor = math.exp(clamp(rise, -3.0, 3.0))
        often, seldom = (min(p * factor, 0.9) for p in (rates.jump, rates.steady_jump))
        lost = 0.0
        for way in WAYS:
            p = often if way in SPEEDS else seldom
            lost += p * lines[way].sum()
            lines[way] = (1 - p) * lines[way]
        for speed, share in SPEEDS.items():
            lines[speed] = lines[speed] + lost * share / size
        self.lines = lines

    def _looks(self) -> Floats:
        """Belief over the places that the image looks like."""
        out = np.zeros(self.size)
        for way, line in self.lines.items():
            off = way[1] if isinstance(way, tuple) else 0
            for place, value in enumerate(line):
                out[clip_place(place + off, self.size)] += value
        return out

    def _weigh(self, rows: Sequence[Row], values: Sequence[Any], strange: float) -> Frame:
        looks = self._looks()
        own: list[Any] = []
        factors: dict[int, Floats] = {}
        by_kind: dict[int, Floats] = {}
        for t, (known, row) in enumerate(zip(self.known, rows, strict=True)):
            own.append(None)
            if row is not None:
                by_kind[t] = likelihoods(self.rates, known, values[t])
                factors[t] = known.kinds @ by_kind[t]
                own[t] = own_word(looks * factors[t], row, self.tolerance, known.weight)
        said = np.zeros(self.size)
        for factor in factors.values():
            said = said + np.log(factor)
        together = np.exp(said - said.max())  # of many factors the product itself may vanish
        for way, line in self.lines.items():
            off = way[1] if isinstance(way, tuple) else 0
            for place in range(self.size):
                line[place] *= together[clip_place(place + off, self.size)]
        whole = sum(line.sum() for line in self.lines.values())
        self.lines = {way: line / whole for way, line in self.lines.items()}
        places = np.sum(list(self.lines.values()), axis=0)
        place, share, rival = likeliest(places, self.tolerance)
        looks = self._looks()
        for t, factor in factors.items():
            own[t].said = math.log(factor[place])
            known = self.known[t]
            known.kinds = learned(self.rates, known, by_kind[t], looks)
            own[t].trust = 1.0 - known.kinds[0]
            own[t].once, own[t].twice, own[t].fourfold = known.kinds[1:]
        steady = sum(float(line.sum()) for way, line in self.lines.items() if way not in SPEEDS)
        heard = math.fsum(one.said for one in own if one is not None)
        return Frame(place, share, rival, steady, strange, heard, len(factors), places, own)


# ---- routes ------------------------------------------------------------------------------


@dataclass
class Selection:
    """What a selection did."""

    tally: list[int]
    chosen: list[int]
    late_runs: list[int]
    corrections: list[list[float]]  # per frame, per technique


@dataclass
class Step:
    """A frame of a route."""

    frame: Frame
    ran: list[bool]
    prediction: int
    confidence: float
    margin: float
    p_correct: float
    selection: Selection | None


@dataclass
class Settings:
    """Of a route."""

    rates: Rates
    coefficients: Sequence[float]
    tolerance: int
    seconds: Sequence[float]
    block: int = 0
    coverage: float = 0.7
    allow_idle: bool = False


def heard(
    scores: Any, ran: Sequence[Sequence[bool]], chosen: Settings
) -> tuple[Belief, list[Frame]]:
    """The belief after the frames of `ran`, from scratch, and what each came to."""
    belief = Belief(chosen.rates, len(scores), scores.shape[2], chosen.tolerance)
    return belief, [belief.hear(rows_of(scores, q, row)) for q, row in enumerate(ran)]


def rows_of(scores: Any, q: int, ran: Sequence[bool]) -> list[Row]:
    return [scores[t][q] if runs else None for t, runs in enumerate(ran)]


def select(scores: Any, ran: list[list[bool]], chosen: Settings) -> tuple[Belief, Selection]:
    """Run everything on the last block, which changes `ran`, and choose."""
    first = max(0, len(ran) - chosen.block)
    late = [sum(not ran[q][t] for q in range(first, len(ran))) for t in range(len(scores))]
    for q in range(first, len(ran)):
        ran[q] = [True] * len(scores)
    belief, frames = heard(scores, ran, chosen)
    tally, corrections = [0] * len(scores), []
    for frame in frames[first:]:
        statistics = [own.statistic for own in frame.own]
        tally[first_best(statistics)] += 1
        corrections.append([own.correction for own in frame.own])
    selected = oracle.coverage(tally, len(ran) - first, chosen.coverage)
    return belief, Selection(tally, selected, late, corrections)


def first_best(statistics: Sequence[float]) -> int:
    best = max(statistics)
    return next(t for t, value in enumerate(statistics) if value >= best - 1e-9 * (1 + abs(best)))


def drive(scores: Any, actions: Any, chosen: Settings) -> list[Step]:
    """A route from its first frame, as the environment takes actions."""
    belief = Belief(chosen.rates, len(scores), scores.shape[2], chosen.tolerance)
    ran: list[list[bool]] = []
    steps: list[Step] = []
    said_mean = 0.0
    cheapest = int(np.argmin(chosen.seconds))
    for q, action in enumerate(np.asarray(actions, bool).tolist()):
        runs, selection = action[: len(scores)], None
        if chosen.block and action[-1] and q > 0:
            belief, selection = select(scores, ran, chosen)
            runs = [t in selection.chosen for t in range(len(scores))]
        if not any(runs) and not chosen.allow_idle:
            runs[cheapest] = True
        ran.append(runs)
        frame = copy.deepcopy(belief.hear(rows_of(scores, q, runs)))
        if not any(runs) and (not steps or steps[-1].prediction < 0):
            steps.append(Step(frame, runs, -1, 0.0, 0.0, 0.0, selection))
            continue
        if frame.heard:
            said_mean += 0.2 * (frame.said / frame.heard - said_mean)
        margin = log(frame.share) - log(frame.rival)
        inputs = [1.0, log_odds(frame.share), margin, frame.said, said_mean]
        logit = clamp(float(np.dot(chosen.coefficients, inputs)), -30.0, 30.0)
        p = 1.0 / (1.0 + math.exp(-logit))
        steps.append(Step(frame, runs, frame.place, logit, margin, p, selection))
    return steps
