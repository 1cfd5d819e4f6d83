"""The belief in explicit loops: every formula written out, nothing shared with the kernels.

A route's belief is a dictionary from a mode of motion to R numbers: a speed (0, 0.5, 1, 1.5, 2 or
-1 places per frame, with jumps) or "steady".
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

from amusic_gym.estimation.belief import model

Floats = NDArray[np.float64]
Row = Any  # (R,) scores, or None: the technique did not run

FORWARDS = {0.0: 1 / 8, 0.5: 1 / 8, 1.0: 1 / 2, 1.5: 1 / 8, 2.0: 1 / 8}  # how often each is drawn
SPEEDS: dict[float, float] = {v: 0.995 * share for v, share in FORWARDS.items()} | {-1.0: 0.005}
MODES: list[Any] = [*SPEEDS, "steady"]
LEAST = 1e-12  # of what a logarithm is taken of
EQUAL = 1e-6  # numbers that differ by less, relatively, are ties


@dataclass
class Technique:
    """What is known of a technique."""

    hub: Floats  # mean row
    variance: Floats  # of each place's news
    rows: int = 0
    news: float = 0.0  # factor on the last row's scores
    usual: float = 0.0  # variance of its news
    change: float = 1.0  # deviation of the last row's over the usual one


@dataclass
class Own:
    """What one technique's row made of the belief."""

    place: int
    statistic: float
    correction: float
    margin: float
    news: float = 0.0
    weight: float = 0.0
    log_likelihood: float = 0.0


@dataclass
class Frame:
    """What a frame came to."""

    place: int
    share: float
    rival: float
    p_steady: float
    log_likelihood: float
    rows: int
    places: Floats
    own: list[Any] = field(default_factory=list)  # an Own of each technique that ran, else None


def log(share: float) -> float:
    return math.log(max(share, LEAST))


def log_odds(share: float) -> float:
    return log(share) - log(1.0 - share)


def clamp(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)


# ---- rows --------------------------------------------------------------------------------


def z_scores(row: Floats) -> Floats | None:
    """Of the candidates, population deviation; 0 for the others; None: all are the same."""
    candidates = [value for value in row if value != -math.inf]
    if not candidates or max(candidates) <= min(candidates):
        return None
    mean = math.fsum(candidates) / len(candidates)
    variance = math.fsum((value - mean) ** 2 for value in candidates) / len(candidates)
    return np.array([0.0 if v == -math.inf else (v - mean) / math.sqrt(variance) for v in row])


def power(value: float) -> float:
    """Exponential, but of the least."""
    return math.exp(max(value, -60.0))


def likelihood_of(known: Technique, row: Floats) -> tuple[Floats, Floats] | None:
    """Likelihood of every place, 1 on average, and its logarithm, nearly; None: constant row."""
    z, size = z_scores(row), len(row)
    known.news = 0.0
    if z is None:
        return None
    masked = row == -math.inf
    known.hub[masked] = 0.0
    squares = math.fsum(z**2) * math.fsum(known.hub**2)
    alike = clamp(math.fsum(z * known.hub) / math.sqrt(squares + 1e-12), 0.0, 1.0)
    step = model.HUB_STEP if known.rows else 1.0
    spread = max(model.VARIANCE_STEP, 1.0 / (known.rows + 2))
    score, square = [0.0] * size, 0.0
    for c in range(size):
        news = z[c] - alike * known.hub[c]
        square += news**2 / size
        score[c] = news / math.sqrt(max(known.variance[c], model.LEAST_VARIANCE))
        known.hub[c] = (1.0 - step) * known.hub[c] + step * z[c]
        known.variance[c] = (1.0 - spread) * known.variance[c] + spread * news**2
    if known.usual > 0.0:
        known.change = math.sqrt(square / known.usual)
        step = max(model.USUAL_STEP, 1.0 / (known.rows + 1)) * min(known.change, 1.0)
        known.usual += step * (min(square, 4.0 * known.usual) - known.usual)
    elif known.rows:
        known.usual = square
    known.rows += 1
    mean = math.fsum(score) / size
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in score) / size)
    known.news = math.sqrt(min(deviation, 1.0))
    slope, top = model.SLOPE * known.news / max(deviation, 1e-9), max(score)
    exponents = [-math.inf if masked[c] else slope * (score[c] - top) for c in range(size)]
    powers = [0.0 if masked[c] else power(exponents[c]) for c in range(size)]
    factor = 0.5 * size / math.fsum(powers)
    excess = [exponent + math.log(factor / 0.5) for exponent in exponents]
    logs = [math.log(0.5) + max(x, 0.0) + math.log1p(power(-abs(x))) for x in excess]
    return np.array([0.5 + factor * value for value in powers]), np.array(logs)


# ---- techniques --------------------------------------------------------------------------


def correlation_away(one: Floats, other: Floats, place: int) -> float:
    """Over the places more than ten, or a tenth of the map, away from one."""
    size = len(one)
    away = min(10, size // 10)
    kept = [c for c in range(size) if abs(c - place) > away]
    if len(kept) < 3:
        return 0.0
    a, b = one[kept], other[kept]
    if any(np.var(logs) <= 1e-9 * np.mean(logs) ** 2 for logs in (a, b)):
        return 0.0
    return float(np.mean((a - a.mean()) * (b - b.mean()))) / float(np.std(a) * np.std(b))


def weights_of(matrix: Floats) -> Floats:
    """Weights g of n techniques of a correlation matrix (n, n): what C g = 1 makes of ones."""
    weights = np.ones(len(matrix))
    for _ in range(30):
        weights = weights / (matrix @ weights)
    return weights


# ---- motion ------------------------------------------------------------------------------


def moves_of(mode: Any) -> dict[int, float]:
    """Probabilities of moving by some places."""
    s = model.SLACK
    return {
        0.0: {0: 1 - s, 1: s},
        0.5: {0: 0.5, 1: 0.5},
        1.0: {0: s, 1: 1 - 2 * s, 2: s},
        1.5: {1: 0.5, 2: 0.5},
        2.0: {1: s, 2: 1 - 2 * s, 3: s},
        -1.0: {-2: s, -1: 1 - 2 * s, 0: s},
        "steady": {1: 1.0},
    }[mode]


def moved(line: Floats, moves: dict[int, float]) -> Floats:
    """What stays on the map."""
    out = np.zeros(len(line))
    for place, value in enumerate(line):
        for step, chance in moves.items():
            if 0 <= place + step < len(line):
                out[place + step] += chance * value
    return out


# ---- places ------------------------------------------------------------------------------


def window(values: Floats, place: int, tolerance: int) -> float:
    return float(values[max(place - tolerance, 0) : place + tolerance + 1].sum())


def likeliest(values: Floats, tolerance: int) -> tuple[int, float, float]:
    """Place whose window holds most, its share, and that of the best window apart from it."""
    whole = float(values.sum())
    windows = [window(values, c, tolerance) / whole for c in range(len(values))]
    best = next(c for c in range(len(values)) if windows[c] >= max(windows) * (1 - EQUAL))
    place = best
    for c in range(max(best - tolerance, 0), min(best + tolerance + 1, len(values))):
        if windows[c] >= 0.99 * windows[best] and values[c] > values[place] * (1 + EQUAL):
            place = c
    apart = [windows[c] for c in range(len(values)) if abs(c - place) > 2 * tolerance]
    return place, min(windows[place], 1.0), max(apart, default=0.0)


def own_word(joint: Floats, row: Floats, tolerance: int) -> Own:
    place, share, rival = likeliest(joint, tolerance)
    top = max(range(len(row)), key=lambda c: (row[c], -c))
    raw = window(joint, top, tolerance) / float(joint.sum())
    statistic = log_odds(share)
    return Own(place, statistic, max(statistic - log_odds(raw), 0.0), log(share) - log(rival))


class Belief:
    """Over a route, frame by frame."""

    def __init__(self, techniques: int, references: int, tolerance: int) -> None:
        self.frame, self.size, self.tolerance = -1, references, tolerance
        start = {speed: 0.45 * share for speed, share in SPEEDS.items()} | {"steady": 0.55}
        self.lines = {mode: np.full(references, start[mode] / references) for mode in MODES}
        self.known = [
            Technique(np.zeros(references), np.ones(references)) for _ in range(techniques)
        ]
        self.alike: dict[tuple[int, int], tuple[float, int]] = {}  # correlation, frames

    def update(self, rows: Sequence[Row]) -> Frame:
        """Take the next frame."""
        self.frame += 1
        rows = [None if row is None else np.asarray(row, np.float64) for row in rows]
        if self.frame > 0:
            self._move()
        prior = np.sum(list(self.lines.values()), axis=0)
        own: list[Any] = [None] * len(rows)
        useful: dict[int, Floats] = {}
        factors: dict[int, Floats] = {}
        for t, row in enumerate(rows):
            if row is not None:
                found = likelihood_of(self.known[t], row)
                factors[t] = np.ones(self.size) if found is None else found[0]
                if found is not None:
                    useful[t] = found[1]
                own[t] = own_word(prior * factors[t], row, self.tolerance)
        stood = self._standing(useful)
        prior = prior + (stood - 1.0) * self.lines[0.0]
        self.lines[0.0] = stood * self.lines[0.0]
        weights = self._weigh(useful, prior)
        together = np.zeros(self.size)
        for t, weight in weights.items():
            together += weight * useful[t]
        if len(useful) == 1:  # as it is
            product = factors[next(iter(useful))]
        else:
            product = np.array([power(value - together.max()) for value in together])
        lines = {mode: line * product for mode, line in self.lines.items()}
        whole = sum(line.sum() for line in lines.values())
        self.lines = {mode: line / whole for mode, line in lines.items()}
        places = np.sum(list(self.lines.values()), axis=0)
        place, share, rival = likeliest(places, self.tolerance)
        for t, factor in factors.items():
            own[t].news, own[t].weight = self.known[t].news, weights.get(t, 0.0)
            own[t].log_likelihood = math.log(factor[place])
        total = math.fsum(one.weight * one.log_likelihood for one in own if one is not None)
        steady = float(self.lines["steady"].sum())
        return Frame(place, share, rival, steady, total, len(factors), places, own)

    def _standing(self, useful: dict[int, Floats]) -> float:
        """How much likelier standing is made by rows of techniques that are lively on the move."""
        known = [self.known[t] for t in useful]
        told = [
            max(model.STAND * (model.STILL - one.change), model.NOT_STANDING)
            for one in known
            if one.rows > model.ACQUAINTED and one.usual > model.LIVELY
        ]
        return math.exp(min(told, default=0.0))

    def _weigh(self, useful: dict[int, Floats], prior: Floats) -> dict[int, float]:
        """How much each technique counts; learns how alike they are."""
        names = list(useful)
        place = next(c for c in range(self.size) if prior[c] >= prior.max() * (1 - EQUAL))
        matrix = np.eye(len(names))
        rows = [useful[name].tobytes() for name in names]
        found: dict[tuple[bytes, bytes], float] = {}  # many techniques may have the same rows
        for b, other in enumerate(names):
            for a, one in enumerate(names[:b]):
                mean, frames = self.alike.get((one, other), (0.0, 0))
                if (rows[a], rows[b]) not in found:
                    new = correlation_away(useful[one], useful[other], place)
                    found[rows[a], rows[b]] = new
                new = found[rows[a], rows[b]]
                step = max(model.LIKENESS_STEP, 1.0 / (frames + 1))
                mean += step * (new - mean)
                self.alike[one, other] = mean, frames + 1
                matrix[a, b] = matrix[b, a] = model.LIKENESS + (1 - model.LIKENESS) * max(mean, 0.0)
        return dict(zip(names, weights_of(matrix).tolist(), strict=True))

    def _move(self) -> None:
        ends = {speed: model.LASTING if speed < 0 else 1.0 for speed in SPEEDS}
        free = np.sum([ends[speed] * self.lines[speed] for speed in SPEEDS], axis=0)
        steady = self.lines["steady"]
        mixed = {"steady": (1 - model.LEAVE) * steady + model.SETTLE * free}
        drawn = (1 - model.SETTLE) * model.CHANGE
        for speed, share in SPEEDS.items():
            kept = (1 - ends[speed] * (model.SETTLE + drawn)) * self.lines[speed]
            mixed[speed] = kept + share * (drawn * free + model.LEAVE * steady)
        jump = {speed: ends[speed] * model.JUMP for speed in SPEEDS} | {"steady": model.STEADY_JUMP}
        self.lines = {mode: (1 - jump[mode]) * moved(mixed[mode], moves_of(mode)) for mode in MODES}
        lost = 1.0 - sum(line.sum() for line in self.lines.values())
        for speed, share in SPEEDS.items():
            self.lines[speed] = self.lines[speed] + lost * share / self.size


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

    coefficients: Sequence[float]
    tolerance: int
    seconds: Sequence[float]
    block: int = 0
    coverage: float = 0.7
    allow_idle: bool = False


def filtered(
    scores: Any, ran: Sequence[Sequence[bool]], chosen: Settings
) -> tuple[Belief, list[Frame]]:
    """The belief after the frames of `ran`, from scratch, and what each came to."""
    belief = Belief(len(scores), scores.shape[2], chosen.tolerance)
    return belief, [belief.update(rows_of(scores, q, row)) for q, row in enumerate(ran)]


def rows_of(scores: Any, q: int, ran: Sequence[bool]) -> list[Row]:
    return [scores[t][q] if runs else None for t, runs in enumerate(ran)]


def select(scores: Any, ran: list[list[bool]], chosen: Settings) -> tuple[Belief, Selection]:
    """Run everything on the last block, which changes `ran`, and choose."""
    first = max(0, len(ran) - chosen.block)
    late = [sum(not ran[q][t] for q in range(first, len(ran))) for t in range(len(scores))]
    for q in range(first, len(ran)):
        ran[q] = [True] * len(scores)
    belief, frames = filtered(scores, ran, chosen)
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
    belief = Belief(len(scores), scores.shape[2], chosen.tolerance)
    ran: list[list[bool]] = []
    steps: list[Step] = []
    mean = 0.0
    on_map = oracle.OnMap(scores, oracle.standardise_bank(scores), chosen.tolerance)
    cheapest = int(np.argmin(chosen.seconds))
    for q, action in enumerate(np.asarray(actions, bool).tolist()):
        runs, selection = action[: len(scores)], None
        if chosen.block and action[-1] and q > 0:
            belief, selection = select(scores, ran, chosen)
            runs = [t in selection.chosen for t in range(len(scores))]
        if not any(runs) and not chosen.allow_idle:
            runs[cheapest] = True
        ran.append(runs)
        frame = copy.deepcopy(belief.update(rows_of(scores, q, runs)))
        if not any(runs) and (not steps or steps[-1].prediction < 0):
            steps.append(Step(frame, runs, -1, 0.0, 0.0, 0.0, selection))
            on_map.note(q, [], -1)
            continue
        if frame.rows:
            mean += 0.2 * (frame.log_likelihood / frame.rows - mean)
        margin = log(frame.share) - log(frame.rival)
        inputs = [1.0, log_odds(frame.share), margin, frame.log_likelihood, mean]
        present = on_map.note(q, np.flatnonzero(runs).tolist(), frame.place)
        logits = (
            np.dot(chosen.coefficients[:5], inputs),
            np.dot(chosen.coefficients[5:], [1, present]),
        )
        p = math.prod(1.0 / (1.0 + math.exp(-clamp(float(each), -30.0, 30.0))) for each in logits)
        logit = clamp(log_odds(p), -30.0, 30.0)
        steps.append(Step(frame, runs, frame.place, logit, margin, p, selection))
    return steps
