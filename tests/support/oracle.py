"""What the package must compute, written a second time as explicit loops.

Nothing here imports the package. Numbers are Python floats, sums are exact (`math.fsum`), every
walk along the history is a loop one can follow with a finger, so that the fast code has something
obviously right to be compared with. Axis order: `scores[technique][query][reference]`; activity
patterns are `ran[query][technique]`, as in a trace.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from oracle_metrics import (
    accuracy,
    auc,
    auc_vprbench,
    compute,
    correctness,
    positives,
    ptr,
)

# Rows, patterns and confidences are read by index only: a nested list or a NumPy array both do.
Numbers = Any

STATISTICS = ("mean", "evidence")  # those that sum along diagonals

RELATIVE_TIE = 1e-9
ABSOLUTE_TIE = 1e-12


# --------------------------------------------------------------------------- one technique: SIC


class Sic(NamedTuple):
    """What SIC says of one technique at one frame; candidates are in rank order."""

    place: int
    statistic: float
    correction: float
    candidates: list[int]
    statistics: list[float]


def standardise(row: Numbers) -> list[float]:
    """Z-scores of one score row, with the population deviation; a constant row gives zeros.

    A place of score -inf is no candidate: it counts for neither mean nor deviation and gets zero.
    """
    values = [float(value) for value in row if value != -math.inf]
    if all(value == values[0] for value in values):
        return [0.0 for _ in row]
    mean = math.fsum(values) / len(values)
    deviation = math.sqrt(math.fsum((value - mean) ** 2 for value in values) / len(values))
    return [0.0 if value == -math.inf else (float(value) - mean) / deviation for value in row]


def standardise_bank(scores: Numbers) -> list[list[list[float]]]:
    """Z-scores of every row of every technique."""
    return [[standardise(row) for row in rows] for rows in scores]


def top_candidates(row: Numbers, count: int) -> list[int]:
    """The candidates of the `count` highest scores, best first, ties to the lower place."""
    places = sorted(candidates_of(row), key=lambda place: (-float(row[place]), place))
    return places[: min(count, len(row))]


def candidates_of(row: Numbers) -> list[int]:
    """The places that a row does not rule out by -inf; one that rules out all says nothing."""
    return [place for place in range(len(row)) if row[place] != -math.inf] or [*range(len(row))]


def clip(value: float, low: float, high: float) -> float:
    """The nearest number of a range."""
    return min(max(value, low), high)


def equal(value: float, highest: float) -> bool:
    """Whether a statistic counts as equal to the highest one."""
    return abs(highest - value) <= RELATIVE_TIE * abs(highest) + ABSOLUTE_TIE


def first_best(statistics: Sequence[float]) -> int:
    """The first entry that is equal to the highest one."""
    highest = max(statistics)
    for index, value in enumerate(statistics):
        if equal(value, highest):
            return index
    raise AssertionError("the highest value is equal to itself")


def diagonal_statistic(
    z: Numbers, ran: Numbers, q: int, place: int, past: int, gamma: float, statistic: str
) -> float:
    """The statistic of one candidate: its walk back along the diagonal, frame by frame."""
    weighted, weights, squares = [], [], []
    for delta in range(min(past, q, place) + 1):
        if not ran[q - delta]:
            continue  # a row that was not computed does not exist
        weight = gamma**delta
        weighted.append(weight * z[q - delta][place - delta])
        weights.append(weight)
        squares.append(weight * weight)
    if statistic == "mean":
        return math.fsum(weighted) / math.fsum(weights)
    if statistic == "evidence":
        return math.fsum(weighted) / math.sqrt(math.fsum(squares))
    raise ValueError(f"unknown statistic {statistic!r}; use 'mean' or 'evidence'")


def sic(
    scores: Numbers,
    ran: Numbers,
    q: int,
    candidates: int = 50,
    past: int = 1000,
    gamma: float = 1.0,
    statistic: str = "mean",
    z: Numbers = None,
    carried: Sequence[int | None] = (),
) -> Sic:
    """SIC of one technique at frame q ("A-MuSIC", III-A).

    Args:
        scores: The technique's score rows (Q, R); rows after q are not looked at.
        ran: (Q,) whether the technique's row exists; that of q must.
        q: The frame.
        candidates: K.
        past: F, past frames at most, besides the current one.
        gamma: The weight of a row delta frames ago is gamma ** delta.
        statistic: "mean" or "evidence".
        z: The z-scores of `scores`, where they are known already.
        carried: Places that rank after the top K; None and those off the map are none.
    """
    if not ran[q]:
        raise ValueError(f"the technique did not run on frame {q}; SIC needs its row")
    if z is None:
        z = [standardise(scores[frame]) for frame in range(q + 1)]
    places = top_candidates(scores[q], candidates)
    for place in carried:
        if place in candidates_of(scores[q]) and place not in places:
            places.append(place)
    values = [diagonal_statistic(z, ran, q, c, past, gamma, statistic) for c in places]
    winner = first_best(values)
    return Sic(places[winner], values[winner], values[winner] - values[0], places, values)


# --------------------------------------------------------------------- several techniques: MuSIC


class Music(NamedTuple):
    """What MuSIC says at one frame; `sics` holds None for a technique that did not run."""

    technique: int
    place: int
    confidence: float  # the chosen technique's statistic, not discounted
    sics: list[Sic | None]
    factors: Sequence[float] | None = None  # (T,) discounts; None: there are none

    def compared(self, technique: int, statistic: float) -> float:
        """A statistic of a technique as it is compared with those of other techniques."""
        return statistic if self.factors is None else statistic * self.factors[technique]


@dataclass
class Memory:
    """What candidates are carried on from."""

    winners: list[dict[int, int]]  # (T,) frame on which the technique ran -> its match
    fused: dict[int, int] = field(default_factory=dict)  # frame on which any ran -> prediction
    alike: dict[tuple[int, int], float] = field(default_factory=dict)
    """(technique, frame) -> how alike its row is to the one before: found once in a route."""

    @classmethod
    def of(cls, techniques: int) -> Memory:
        """That of a route on which nothing ran yet."""
        return cls([{} for _ in range(techniques)])

    def note(self, result: Music, q: int) -> None:
        """Keep what MuSIC said at a frame."""
        self.fused[q] = result.place
        self.note_winners(result, q)

    def note_winners(self, result: Music, q: int) -> None:
        """Keep only the techniques' own matches, of a selection that looks back."""
        for technique, found in enumerate(result.sics):
            if found is not None:
                self.winners[technique][q] = found.place


def moved_on(places: dict[int, int], q: int) -> int | None:
    """The last place before frame q, one place further with every frame since; or None."""
    for past in range(q - 1, -1, -1):
        if past in places:
            return places[past] + (q - past)
    return None


SERIAL_FORGETTING = 0.98
SERIAL_PRIOR = 0.5
SERIAL_PRIOR_ROWS = 10
SERIAL_MOST = 0.999


def row_correlation(before: Numbers, now: Numbers, rows: Numbers, shift: int = 1) -> float:
    """How alike two z-scored rows are, the first moved on, where both of the `rows` are finite."""
    pairs = [(place - shift, place) for place in range(shift, len(now))]
    both = [(a, b) for a, b in pairs if -math.inf not in (rows[0][a], rows[1][b])]
    return math.fsum(before[a] * now[b] for a, b in both) / max(len(both), 1)


def serial_discount(
    z: Numbers,
    ran: Numbers,
    q: int,
    scores: Numbers,
    technique: int = 0,
    alike: dict[tuple[int, int], float] | None = None,
) -> float:
    """The factor on a technique's statistic for the serial correlation of its rows up to q."""
    alike = {} if alike is None else alike
    pairs = [frame for frame in range(1, q + 1) if ran[frame - 1] and ran[frame]]
    total, weights = [], []
    for number, frame in enumerate(pairs):
        weight = SERIAL_FORGETTING ** (len(pairs) - 1 - number)
        if (technique, frame) not in alike:
            found = row_correlation(z[frame - 1], z[frame], scores[frame - 1 : frame + 1])
            alike[technique, frame] = found
        total.append(weight * alike[technique, frame])
        weights.append(weight)
    prior = SERIAL_PRIOR_ROWS * SERIAL_FORGETTING ** len(pairs)
    rho = math.fsum([*total, prior * SERIAL_PRIOR]) / math.fsum([*weights, prior])
    rho = min(max(rho, 0.0), SERIAL_MOST)
    return math.sqrt((1.0 - rho) / (1.0 + rho))


def column(ran: Numbers, technique: int) -> list[bool]:
    """The activity of one technique over the frames."""
    return [bool(frame[technique]) for frame in ran]


def music(
    scores: Numbers,
    ran: Numbers,
    q: int,
    candidates: int = 50,
    past: int = 1000,
    gamma: float = 1.0,
    statistic: str = "mean",
    z: Numbers = None,
    carry: bool = False,
    discount: bool = False,
    memory: Memory | None = None,
) -> Music:
    """MuSIC at frame q among the techniques that ran on it ("A-MuSIC", III-B).

    `scores` is (T, Q, R), `ran` is (Q, T) and `z` is None or the z-scores of `scores`. `carry`:
    what `memory` knows from before q is carried on. `discount`: statistics of techniques whose
    rows are alike count less against those of others.
    """
    if z is None and discount:
        z = standardise_bank(scores)
    sics: list[Sic | None] = []
    for technique in range(len(scores)):
        if not ran[q][technique]:
            sics.append(None)
            continue
        known = None if z is None else z[technique]
        history = column(ran, technique)
        carried: list[int | None] = []
        if carry and memory is not None:
            carried = [moved_on(memory.winners[technique], q), moved_on(memory.fused, q)]
        settings = (candidates, past, gamma, statistic, known, carried)
        sics.append(sic(scores[technique], history, q, *settings))
    present = [technique for technique, found in enumerate(sics) if found is not None]
    if not present:
        raise ValueError(f"no technique ran on frame {q}; MuSIC needs one")
    factors = None
    if discount:
        factors = [math.nan for _ in scores]
        alike = None if memory is None else memory.alike
        for t in present:
            factors[t] = serial_discount(z[t], column(ran, t), q, scores[t], t, alike)
    found = [result for result in sics if result is not None]
    unfused = Music(-1, -1, math.nan, sics, factors)
    best = first_best(
        [unfused.compared(t, one.statistic) for t, one in zip(present, found, strict=True)]
    )
    return Music(present[best], found[best].place, found[best].statistic, sics, factors)


def margin(result: Music, tolerance: int) -> float | None:
    """How far the winner's statistic is above the best rival's; None without a rival.

    A rival is any candidate of any technique that ran, more than `tolerance` places away from
    the winner.
    """
    rivals = []
    for technique, found in enumerate(result.sics):
        if found is None:
            continue
        for place, value in zip(found.candidates, found.statistics, strict=True):
            if abs(place - result.place) > tolerance:
                rivals.append(result.compared(technique, value))
    best = result.compared(result.technique, result.confidence)
    return best - max(rivals) if rivals else None


# ------------------------------------------------------------------- estimated correctness: p̂


IDLE_DECAY = 0.9995
SUPPORT_MEMORY = 0.98


class Others(NamedTuple):
    """How much the techniques that MuSIC did not trust have a say, and say the same."""

    heard: float = 0.0
    support: float = 0.0


def likeness(results: Sequence[Music | None], z: Numbers, technique: int, scores: Numbers) -> float:
    """Mean product of a technique's z-scores and the trusted one's, where it last ran beside it."""
    for frame in range(len(results) - 1, -1, -1):
        result = results[frame]
        if result is None or result.sics[technique] is None or result.technique == technique:
            continue
        trusted, own = z[result.technique][frame], z[technique][frame]
        if not any(trusted) or not any(own):  # of a constant row
            return 1.0
        rows = [scores[t][frame] for t in (result.technique, technique)]
        return row_correlation(trusted, own, rows, shift=0)
    return 0.0


def others(
    results: Sequence[Music | None], z: Numbers, memory: Memory, tolerance: int, scores: Numbers
) -> Others:
    """What the other techniques say of the prediction of the last frame, on which something ran.

    `results` are MuSIC's up to that frame, `memory` includes it. A technique's last match may be
    of a frame on which it ran after the fact only.
    """
    frame, result = len(results) - 1, results[-1]
    assert result is not None
    weights, agreeing = [0.0], [0.0]
    for technique, matches in enumerate(memory.winners):
        if technique == result.technique or not matches:
            continue
        last = max(matches)
        alike = clip(likeness(results, z, technique, scores), 0.0, 1.0)
        weight = (1.0 - alike) * SUPPORT_MEMORY ** (frame - last)
        weights.append(weight)
        if abs(matches[last] + frame - last - result.place) <= tolerance:
            agreeing.append(weight)
    return Others(float(max(weights)), float(max(agreeing)))


def tracks(predictions: Sequence[int]) -> list[int]:
    """On every frame, how many in a row up to it moved on by one place."""
    found, before = [], -1
    for place in predictions:
        moved = before >= 0 and place == before + 1
        found.append(found[-1] + 1 if moved else 0)
        before = place
    return found


class OnMap:
    """Log-odds of being on the map, by how the rows looked at the prediction up to now.

    Args:
        scores: ``[technique][query][reference]``.
        z: the same, standardised.
        tolerance: of the bank.
    """

    def __init__(self, scores: Numbers, z: Numbers, tolerance: int) -> None:
        self.scores, self.z, self.tolerance, self.log_odds = scores, z, tolerance, 0.0
        self.similarities: list[list[float]] = [[] for _ in z]  # of every run, to the prediction
        self.near: list[list[bool]] = [[] for _ in z]  # whether its best place was the prediction

    @staticmethod
    def usual(values: Sequence[float]) -> float:
        """Slow running mean: of n values the newest weighs 1 / n, or 0.02."""
        mean = 0.0
        for n, value in enumerate(values, start=1):
            mean += max(0.02, 1.0 / n) * (value - mean)
        return mean

    def ratio(self, t: int, similarity: float, near: bool) -> float:
        """Log-likelihood ratio of one run."""
        usual = max(self.usual(self.similarities[t]), 0.5)
        first = similarity**2 / 2 - (similarity - usual) ** 2 / 2
        chance = min((2 * self.tolerance + 1) / len(self.z[t][0]), 0.5)
        runs = min(len(self.near[t]), 50)
        share = (0.9 + runs * self.usual(self.near[t])) / (3 + runs)
        share = min(max(share, chance + 0.02), 0.95)
        second = math.log(share / chance) if near else math.log((1 - share) / (1 - chance))
        return 0.5 * (clip(first, -4.0, 4.0) + clip(second, -4.0, 4.0))

    def note(self, frame: int, ran: Sequence[int], place: int) -> float:
        """Take in a frame: the techniques that ran on it and the prediction, −1 for none."""
        ratios = [0.0]
        for t in ran if place >= 0 else ():
            row = self.z[t][frame]
            near = abs(top_candidates(self.scores[t][frame], 1)[0] - place) <= self.tolerance
            if any(row):
                ratios.append(self.ratio(t, row[place], near))
            self.similarities[t].append(row[place])
            self.near[t].append(near)
        p = 1.0 / (1.0 + math.exp(-self.log_odds))
        p = 0.99 * p + 0.02 * (1.0 - p)
        odds = math.log(p / (1.0 - p)) + max(ratios) + min(ratios)
        self.log_odds = clip(odds, -12.0, 12.0)
        return self.log_odds


def p_correct(
    b: Numbers, statistic: float, track: int, on_map: float, said: Others, margin: float | None
) -> float:
    """p̂ of a fused match of that discounted statistic; no margin where there is no rival."""
    drive = [1.0, np.arcsinh(statistic), np.log1p(track)]
    if margin is None:
        logits = [np.dot(b[8:11], drive), np.dot(b[11:13], [1.0, on_map])]
    else:
        drive += [*said, np.arcsinh(margin)]
        logits = [np.dot(b[:6], drive), np.dot(b[6:8], [1.0, on_map])]
    return float(np.prod(1.0 / (1.0 + np.exp(-np.clip(logits, -30.0, 30.0)))))


def p_corrects(b: Numbers, route: Route, tolerance: int) -> list[float]:
    """p̂ of every frame of a route."""
    found, p = [], 0.0
    track = tracks(route.predictions)
    steps = zip(route.results, track, route.on_map, route.others, strict=True)
    for result, moved, on_map, said in steps:
        if result is None:
            p *= IDLE_DECAY
        else:
            statistic = result.compared(result.technique, result.confidence)
            p = p_correct(b, statistic, moved, on_map, said, margin(result, tolerance))
        found.append(p)
    return found


# --------------------------------------------------------------------------------- A-MuSIC


@dataclass
class Selection:
    """One selection of A-MuSIC, done before frame `frame` over the block just before it."""

    frame: int
    tally: list[int]
    chosen: list[int]
    late_runs: list[int]  # (T,) after-the-fact runs
    corrections: list[list[float]]  # (M, T)


@dataclass
class Route:
    """What a policy did on a route of Q frames with T techniques."""

    predictions: list[int] = field(default_factory=list)
    confidences: list[float] = field(default_factory=list)
    similarities: list[float] = field(default_factory=list)  # z-score of the place, this frame's
    chosen: list[int] = field(default_factory=list)
    ran: list[list[bool]] = field(default_factory=list)  # (Q, T) on the frame itself
    selections: list[Selection] = field(default_factory=list)
    results: list[Music | None] = field(default_factory=list)  # MuSIC's, None where nothing ran
    on_map: list[float] = field(default_factory=list)  # log-odds of being on the map
    others: list[Others] = field(default_factory=list)  # what the others said of the prediction
    p_values: dict[int, float] = field(default_factory=dict)  # frame after the block -> p

    def runs(self) -> list[int]:
        """Runs per technique (T,), after-the-fact runs included."""
        total = [sum(frame[t] for frame in self.ran) for t in range(len(self.ran[0]))]
        for selection in self.selections:
            total = [sum(pair) for pair in zip(total, selection.late_runs, strict=True)]
        return total

    def reselections(self) -> int:
        """Selections but the first."""
        return max(0, len(self.selections) - 1)


def paired_t_test(before: Sequence[float], after: Sequence[float]) -> float:
    """The p-value of the paired two-sided t-test; 1 is "never reject", 0 is "always".

    All differences zero: 1. A constant difference other than zero: 0. Fewer than two pairs: 1.
    Differences are of sums, and equal where they are up to the last bits.
    """
    from scipy import stats

    differences = [b - a for a, b in zip(before, after, strict=True)]
    count = len(differences)
    if count < 2 or all(abs(difference) < ABSOLUTE_TIE for difference in differences):
        return 1.0
    if all(abs(difference - differences[0]) < ABSOLUTE_TIE for difference in differences):
        return 0.0
    mean = math.fsum(differences) / count
    variance = math.fsum((d - mean) ** 2 for d in differences) / (count - 1)
    t = mean / math.sqrt(variance / count)
    return 2.0 * float(stats.t.sf(abs(t), count - 1))


def coverage(tally: Sequence[int], block: int, share: float) -> list[int]:
    """Techniques by falling tally until their sum is at least ceil(share * block).

    The product is a real number: 0.1 * 30 is 3, though floats say a little more.
    """
    enough = math.ceil(share * block - 1e-9)
    chosen: list[int] = []
    for technique in sorted(range(len(tally)), key=lambda t: (-tally[t], t)):
        if sum(tally[t] for t in chosen) >= enough:
            break
        chosen.append(technique)
    return sorted(chosen)


def amusic(
    scores: Numbers,
    candidates: int = 50,
    past: int = 1000,
    gamma: float = 1.0,
    statistic: str = "mean",
    block: int = 10,
    share: float = 0.7,
    alpha: float = 0.05,
    carry: bool = False,
    discount: bool = False,
) -> Route:
    """The whole A-MuSIC rule ("A-MuSIC", III-C) on scores (T, Q, R).

    `block` is M, `share` is E.
    """
    z = standardise_bank(scores)
    settings = (candidates, past, gamma, statistic, z, carry, discount)
    techniques, queries = len(scores), len(scores[0])
    memory = Memory.of(techniques)
    exists = [[False] * techniques for _ in range(queries)]  # rows in the history
    route = Route()
    active = list(range(techniques))
    corrections: list[list[float]] = []  # (Q, T), of the techniques that ran
    before: list[float] | None = None  # ch
    for q in range(queries):
        if q > 0 and q % block == 0:
            frames = list(range(q - block, q))
            rejected = before is None
            if before is not None:
                now = [corrections[f][t] for t in active for f in frames]
                route.p_values[q] = paired_t_test(before, now)
                rejected = route.p_values[q] < alpha
                before = now
            if rejected:
                selection = select(scores, exists, frames, settings, share, memory)
                route.selections.append(selection)
                active = selection.chosen
                before = [selection.corrections[m][t] for t in active for m in range(block)]
        for technique in active:
            exists[q][technique] = True
        result = music(scores, exists, q, *settings, memory)
        memory.note(result, q)
        corrections.append([math.nan if s is None else s.correction for s in result.sics])
        route.predictions.append(result.place)
        route.confidences.append(result.confidence)
        route.similarities.append(z[result.technique][q][result.place])
        route.chosen.append(result.technique)
        route.ran.append(list(exists[q]))
    return route


def select(
    scores: Numbers,
    exists: list[list[bool]],
    frames: list[int],
    settings: tuple[Any, ...],
    share: float,
    memory: Memory | None = None,
) -> Selection:
    """Selection over the frames of a block; marks the after-the-fact rows in `exists`.

    What is carried on: the predictions that were given, and the matches of the techniques as they
    are now that they have all run, which `memory` keeps.
    """
    techniques = len(scores)
    memory = memory or Memory.of(techniques)
    if len(settings) == 5:
        settings = (*settings, False, False)
    late_runs = [0] * techniques
    for frame in frames:
        for technique in range(techniques):
            if not exists[frame][technique]:
                exists[frame][technique] = True
                late_runs[technique] += 1
    tally = [0] * techniques
    corrections = []
    for frame in frames:
        result = music(scores, exists, frame, *settings, memory)  # rows up to itself only
        memory.note_winners(result, frame)
        tally[result.technique] += 1
        corrections.append([s.correction for s in result.sics if s is not None])
    chosen = coverage(tally, len(frames), share)
    return Selection(frames[-1] + 1, tally, chosen, late_runs, corrections)


# ------------------------------------------------------------------------- simple policies


def always(
    scores: Numbers,
    active: Sequence[int],
    candidates: int = 50,
    past: int = 1000,
    gamma: float = 1.0,
    statistic: str = "mean",
    carry: bool = False,
    discount: bool = False,
) -> Route:
    """MuSIC over the same techniques on every frame; all of them, a subset, or one."""
    z = standardise_bank(scores)
    settings = (candidates, past, gamma, statistic, z, carry, discount, Memory.of(len(scores)))
    pattern = [[t in active for t in range(len(scores))] for _ in range(len(scores[0]))]
    route = Route(ran=pattern)
    for q in range(len(pattern)):
        result = music(scores, pattern, q, *settings)
        settings[-1].note(result, q)
        route.predictions.append(result.place)
        route.confidences.append(result.confidence)
        route.similarities.append(z[result.technique][q][result.place])
        route.chosen.append(result.technique)
    return route


def uncorrected(scores: Numbers, technique: int) -> Route:
    """The place with the highest raw score of one technique, that score as confidence."""
    rows = scores[technique]
    route = Route(ran=[[t == technique for t in range(len(scores))] for _ in rows])
    for row in rows:
        place = top_candidates(row, 1)[0]
        route.predictions.append(place)
        route.confidences.append(float(row[place]))
        route.similarities.append(standardise(row)[place])
        route.chosen.append(technique)
    return route


def measure(route: Route, ground_truth: Numbers, seconds: Sequence[float]) -> dict[str, float]:
    """Every number of a results row that the loops know."""
    correct = correctness(route.predictions, ground_truth)
    return {
        "accuracy": accuracy(correct),
        "auc": auc(correct, route.confidences, positives(ground_truth)),
        "auc_vprbench": auc_vprbench(correct, route.confidences),
        "auc_paper": auc_vprbench(correct, route.similarities),
        "ptr": ptr(route),
        "compute": compute(route, seconds),
        "runs": sum(route.runs()),
        "reselections": route.reselections(),
    }
