"""Self-Identification and Correction (A-MuSIC, III-A), incremental along diagonals.

A candidate's statistic sums the z-scores on one diagonal of the score matrix. With one running
sum per diagonal, a frame costs one contiguous add of R numbers and K look-ups, however long the
history is. The compiled functions here are the only implementation; the environment
(:mod:`amusic_gym.envs.episode`) and :class:`SIC` both call them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.rows import (
    RUN,
    RowBuffer,
    deviation,
    is_masked,
    mean_at,
    prepare,
    row_at,
    scale_at,
    serial_correlation,
    top_at,
)
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.kernels.compiling import apart, compiled, inner
from amusic_gym.kernels.tables import part

RELATIVE_TIE = 1e-9
ABSOLUTE_TIE = 1e-12
"""Statistics this close to each other are equal."""

SLACK = 512
"""Frames that the running sums move before their window is copied back."""

LARGE = 65_536
"""Places from which the sums of a map are too much for a fast cache: rows are added together."""

DEPTH = 8
"""How many then."""

TILE = 1024
"""Places that several rows are added to in turn, so that their sums stay in the fastest cache."""

CARRIED = 2
"""Candidates besides the top K: the technique's own last match and the last fused prediction."""

SERIAL_MEMORY = 0.98
"""Weight of the mean serial correlation so far against one more row's."""

SERIAL_PRIOR, SERIAL_PRIOR_ROWS = 0.5, 10.0
"""Serial correlation before the first row, and the number of rows that it is worth."""

SERIAL_MOST = 0.999
"""Above it a technique's rows would say nothing at all."""

SUMS = np.dtype(
    [
        ("origin", np.int64),  # place c at frame n has its sum at sums[origin - n + c]
        ("last", np.int64),  # frame of the last row added, -1 before the first
        ("expired", np.int64),  # frames before this one have left the history
        ("since", np.int64),  # the technique ran on every frame from this one to last
        ("depth", np.int64),  # rows that wait to be added together, at most; 0: none ever waits
        ("waiting", np.int64),  # how many do now
        ("frames", np.int64, DEPTH),  # theirs, in order
        ("leaving", np.int64),  # rows that wait to be taken out
        ("left", np.int64, DEPTH),  # their frames
        ("discount", np.int64),  # 1: the serial correlation is kept
        ("serial", np.float64),  # running sum of the serial correlation
        ("serial_rows", np.float64),  # rows that it sums over, the prior's among them
    ]
)
"""Bookkeeping of one technique's running sums. Float64[R + SLACK] sums go with it."""


def new_sums(marks: Any, references: int, room: int, settings: SICSettings) -> None:
    """Reset SUMS records of any shape.

    Args:
        marks: the records.
        references: R, places of the map.
        room: length of the running sums, R + SLACK or more.
        settings: of SIC.
    """
    marks[...] = np.zeros((), SUMS)
    marks["last"] = -1
    marks["origin"] = max(room - references, 0)
    marks["depth"] = depth_for(references, settings.gamma)
    marks["discount"] = settings.discount
    marks["serial"] = SERIAL_PRIOR * SERIAL_PRIOR_ROWS
    marks["serial_rows"] = SERIAL_PRIOR_ROWS


def depth_for(references: int, gamma: float) -> int:
    """How many rows wait to be added together, on a map of so many places.

    Eight rows in one pass move the sums through memory once instead of eight times; a look-up then
    also looks at the rows that wait.
    """
    return DEPTH if references >= LARGE and gamma == 1.0 else 0


@inner
def add_row(sums: Any, base: int, run: Any, frame: int, decay: float) -> None:
    """Multiply the window's R sums by ``decay`` and add the z-scores of a prepared row."""
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0]
    window = sums[base : base + row.size]
    if decay != 1.0:
        for place in range(row.size):
            window[place] = decay * window[place] + deviation(row[place], mean) * scale
        return
    for place in range(row.size):
        window[place] += deviation(row[place], mean) * scale


@apart
def add_waiting(sums: Any, mark: Any, run: Any, frame: int) -> None:
    """Add the rows that wait to the window of ``frame``, or take them out; γ is 1."""
    base = mark.origin - frame
    size, rows = run.references, mark.waiting + mark.leaving
    for start in range(0, size, TILE):
        stop = min(start + TILE, size)
        for k in range(rows):
            came = k < mark.waiting
            past = mark.frames[k] if came else mark.left[k - mark.waiting]
            age = frame - past
            first = max(start, age)
            if first >= stop:
                continue
            prepare(run, past)  # as in remove_row
            row = row_at(run, past)
            mean = mean_at(run, past)[0]
            scale = scale_at(run, past)[0] if came else -scale_at(run, past)[0]
            window = part(sums, base + first, stop - first)
            scores = part(row, first - age, stop - first)
            for place in range(stop - first):
                window[place] += deviation(scores[place], mean) * scale
    mark.waiting, mark.leaving = 0, 0


@inner
def z_of(run: Any, frame: int, place: int) -> float:
    """Z-score of a place in a row."""
    prepare(run, frame)  # as in remove_row
    off = deviation(row_at(run, frame)[place], mean_at(run, frame)[0])
    z: float = off * scale_at(run, frame)[0]
    return z


@inner
def with_waiting(total: float, mark: Any, run: Any, frame: int, place: int) -> float:
    """The sum of a place at ``frame`` with what the rows that wait will change of it."""
    for k in range(mark.waiting):
        at = place - (frame - mark.frames[k])
        if at >= 0:
            total += z_of(run, mark.frames[k], at)
    for k in range(mark.leaving):
        at = place - (frame - mark.left[k])
        if at >= 0:
            total -= z_of(run, mark.left[k], at)
    return total


@apart
def remove_row(sums: Any, base: int, run: Any, frame: int, age: int, weight: float) -> None:
    """Take a frame's z-scores, ``age`` frames old, out of the sums of their diagonals."""
    prepare(run, frame)  # again in an unpickled environment, whose bank starts unprepared
    row = row_at(run, frame)
    mean = mean_at(run, frame)[0]
    scale = scale_at(run, frame)[0] * weight
    window = part(sums, base + age, row.size - age)
    for place in range(row.size - age):
        window[place] -= deviation(row[place], mean) * scale


@apart
def recentre(sums: Any, mark: Any, frame: int, size: int) -> None:
    """Move the window of R sums to the right end, because ``frame`` has left the left one.

    Sums of diagonals that begin after ``mark.last`` are zero: nothing was added to them.
    """
    base = mark.origin - frame
    room = sums.size - size
    kept = size + base  # the window reaches -base places beyond the left end
    for place in range(kept - 1, -1, -1):
        sums[room - base + place] = sums[place]
    for index in range(min(room - base, sums.size)):
        sums[index] = 0.0
    mark.origin = frame + room


@inner
def push(sums: Any, mark: Any, run: Any, ran: Any, frame: int, history: int, gamma: float) -> None:
    """Add the row of ``frame`` to the running sums and let rows older than F frames go.

    Args:
        sums: (R + SLACK,) float64.
        mark: SUMS record.
        run: RUN record; its row of ``frame`` is prepared.
        ran: (Q,) uint8, the frames that the technique ran on.
        frame: frame index n, later than ``mark.last``.
        history: F.
        gamma: weight of a row per frame of age.
    """
    if mark.origin < frame:
        recentre(sums, mark, frame, run.references)
    base = mark.origin - frame
    if mark.depth > 0:
        mark.frames[mark.waiting] = frame
        mark.waiting += 1
    else:
        decay = 1.0 if gamma == 1.0 or mark.last < 0 else gamma ** (frame - mark.last)
        add_row(sums, base, run, frame, decay)
    while mark.expired < frame - history:
        age = frame - mark.expired
        # A row that came and went within one gap was never added, or has left the map.
        if ran[mark.expired] and mark.expired <= mark.last and age < run.references:
            if mark.depth == 0:
                remove_row(sums, base, run, mark.expired, age, gamma**age)
            else:
                if mark.leaving == mark.depth:
                    add_waiting(sums, mark, run, frame)
                mark.left[mark.leaving] = mark.expired
                mark.leaving += 1
        mark.expired += 1
    if mark.depth > 0 and (mark.waiting == mark.depth or mark.leaving == mark.depth):
        add_waiting(sums, mark, run, frame)
    if frame != mark.last + 1:
        mark.since = frame
    elif mark.discount and frame > 0:
        mark.serial = SERIAL_MEMORY * mark.serial + serial_correlation(run, frame)
        mark.serial_rows = SERIAL_MEMORY * mark.serial_rows + 1.0
    mark.last = frame


@inner
def discount_of(mark: Any) -> float:
    """√((1 − ρ)/(1 + ρ)), ρ the mean serial correlation of a technique's rows; 1 if not kept.

    Stouffer's √n takes rows for independent; of an autoregressive sequence so many of n are.
    """
    discount = 1.0
    if mark.discount:
        rho = min(max(mark.serial / mark.serial_rows, 0.0), SERIAL_MOST)
        discount = math.sqrt((1.0 - rho) / (1.0 + rho))
    return discount


@compiled
def weigh(counts: Any, prefix: Any, ran: Any, first: int, stop: int, ratio: float) -> None:
    """Extend what weights are made of, from frame ``first`` on to before ``stop``.

    Args:
        counts: (Q + 1,) int32; ``counts[p + 1]`` is how many of the frames i ≤ p ran.
        prefix: (Q + 1,) float64; ``prefix[p + 1]`` = Σ ratio^(p−i) over these. Not used where the
            ratio is 1: counts are the same, in half the memory.
        ran: (Q,) uint8.
        first: first new frame.
        stop: frame after the last.
        ratio: γ² for evidence and γ for mean.
    """
    for frame in range(first, stop):
        counts[frame + 1] = counts[frame] + ran[frame]
        if ratio != 1.0:
            prefix[frame + 1] = ratio * prefix[frame] + ran[frame]


@compiled
def ratio_of(gamma: float, evidence: bool) -> float:
    """What the weights of two neighbouring frames differ by: γ² in Σw², γ in Σw."""
    return gamma * gamma if evidence else gamma


@inner
def weight_of(counts: Any, prefix: Any, frame: int, span: int, ratio: float) -> float:
    """Σw² (evidence) or Σw (mean) over ``frame`` and the ``span`` frames before it.

    For a candidate, the walk back stops at the start of the history, of the run or of the map,
    whichever is nearest.
    """
    before = np.uintp(frame - span)  # unsigned: no check for a negative index
    weight: float
    if ratio == 1.0:
        weight = counts[frame + 1] - counts[before]
    else:
        weight = prefix[frame + 1] - prefix[before] * ratio ** (span + 1)
    return weight


def factors_of(most: int, evidence: bool) -> NDArray[np.float64]:
    """(most + 1,) factors that make statistics of the sums of so many rows, where γ = 1.

    To look them up is faster than a root and a division for every candidate.
    """
    counts = np.maximum(np.arange(most + 1.0), 1.0)
    factors: NDArray[np.float64] = 1.0 / (np.sqrt(counts) if evidence else counts)
    return factors


@inner
def statistic_of(total: float, weight: float, factors: Any, gamma: float, evidence: bool) -> float:
    """Statistic of a diagonal's sum: Σwz/√Σw² (evidence) or Σwz/Σw (mean)."""
    statistic: float
    if gamma == 1.0:
        statistic = total * factors[np.uintp(weight)]
    else:
        statistic = total / math.sqrt(weight) if evidence else total / weight
    return statistic


@inner
def tie(best: float) -> float:
    """How far below ``best`` a statistic still counts as equal."""
    return ABSOLUTE_TIE + RELATIVE_TIE * abs(best)


@inner
def first_near(values: Any, best: float, size: int) -> int:
    """Index of the first value that is as good as ``best``, the highest of them."""
    floor = best - tie(best)
    for i in range(size):
        if values[i] >= floor:
            return i
    return 0


@inner
def diagonal_statistic(
    sums: Any,
    mark: Any,
    run: Any,
    counts: Any,
    prefix: Any,
    factors: Any,
    frame: int,
    history: int,
    gamma: float,
    evidence: bool,
    place: int,
) -> float:
    """Statistic of any place at ``frame``, the last on which the technique ran; −∞ off the map."""
    if place < 0 or place >= run.references:
        return -math.inf
    total = sums[np.uintp(mark.origin - frame + place)]
    if mark.waiting + mark.leaving > 0:
        total = with_waiting(total, mark, run, frame, place)
    span = min(min(history, frame), place)
    weight = weight_of(counts, prefix, frame, span, ratio_of(gamma, evidence))
    return statistic_of(total, weight, factors, gamma, evidence)


@inner
def candidate_at(top: Any, carried: Any, rank: int) -> int:
    """Place of a candidate: the top K of the row come first, then those carried on, −1 for none."""
    place: int = top[rank] if rank < top.size else carried[rank - top.size]
    return place


@inner
def shut_out(run: Any, frame: int, top: Any, out: Any) -> int:
    """Give −∞ to what ranks last and is no candidate; returns how many others there are."""
    size: int = top.size
    while is_masked(run, frame, top[size - 1]):
        size -= 1
        out[size] = -math.inf
    return size


@inner
def best_candidate(
    sums: Any,
    mark: Any,
    run: Any,
    counts: Any,
    prefix: Any,
    factors: Any,
    frame: int,
    history: int,
    gamma: float,
    evidence: bool,
    carried: Any,
    out: Any,
) -> int:
    """Write the statistics of a row's candidates at ``frame`` to ``out`` (K + CARRIED,).

    ``factors`` are those of :func:`factors_of`, for as many rows as the history and the map have.
    ``carried`` (CARRIED,) holds the places that are carried on; those off the map get −∞, and so
    do places that are no candidates in the row.

    Returns:
        Rank of the candidate of the highest statistic; of equal ones the first.
    """
    top = top_at(run, frame)
    size = shut_out(run, frame, top, out)
    window = sums[mark.origin - frame :]
    reach = min(history, frame)
    best = -math.inf
    if mark.waiting + mark.leaving > 0:
        for rank in range(size):
            weight = weight_of(counts, prefix, frame, min(reach, top[rank]), 1.0)
            total = with_waiting(window[np.uintp(top[rank])], mark, run, frame, top[rank])
            statistic = statistic_of(total, weight, factors, 1.0, evidence)
            out[rank] = statistic
            best = max(best, statistic)
    elif gamma == 1.0 and frame - reach >= mark.since:
        # It ran on every frame that counts: how many these are needs no look-up.
        for rank in range(size):
            total = window[np.uintp(top[rank])]
            statistic = total * factors[np.uintp(min(reach, top[rank]) + 1)]
            out[rank] = statistic
            best = max(best, statistic)
    elif gamma == 1.0:
        newest = counts[frame + 1]
        for rank in range(size):
            before = counts[np.uintp(frame - min(reach, top[rank]))]
            total = window[np.uintp(top[rank])]
            statistic = total * factors[np.uintp(newest - before)]
            out[rank] = statistic
            best = max(best, statistic)
    else:
        ratio = ratio_of(gamma, evidence)
        for rank in range(size):
            weight = weight_of(counts, prefix, frame, min(reach, top[rank]), ratio)
            total = window[np.uintp(top[rank])]
            statistic = statistic_of(total, weight, factors, gamma, evidence)
            out[rank] = statistic
            best = max(best, statistic)
    for k in range(CARRIED):
        place = carried[k]
        statistic = diagonal_statistic(
            sums, mark, run, counts, prefix, factors, frame, history, gamma, evidence, place
        )
        if statistic > -math.inf and is_masked(run, frame, place):
            statistic = -math.inf
        out[top.size + k] = statistic
        best = max(best, statistic)
    return first_near(out, best, top.size + CARRIED)


@compiled
def first_best(values: Any, size: int) -> int:
    """Index of the highest of ``values``; of equal ones the first."""
    best = values[0]
    for i in range(1, size):
        best = max(best, values[i])
    return first_near(values, best, size)


@inner
def value_beyond(values: Any, top: Any, rank: int, place: int, tolerance: int) -> float:
    """Statistic of a candidate beyond ``tolerance`` of ``place``; −∞ for one within it."""
    value: float = values[rank] if abs(top[rank] - place) > tolerance else -math.inf
    return value


@inner
def best_rival(values: Any, top: Any, carried: Any, place: int, tolerance: int) -> float:
    """Highest statistic of the candidates beyond ``tolerance`` of ``place``; −∞ if there are none.

    In four lanes: comparisons of one chain wait for each other.
    """
    a, b, c, d = -math.inf, -math.inf, -math.inf, -math.inf
    size = top.size
    even = size - size % 4
    for i in range(0, even, 4):
        a = max(a, value_beyond(values, top, i, place, tolerance))
        b = max(b, value_beyond(values, top, i + 1, place, tolerance))
        c = max(c, value_beyond(values, top, i + 2, place, tolerance))
        d = max(d, value_beyond(values, top, i + 3, place, tolerance))
    for i in range(even, size):
        a = max(a, value_beyond(values, top, i, place, tolerance))
    for k in range(CARRIED):
        if abs(carried[k] - place) > tolerance:
            b = max(b, values[size + k])
    return max(max(a, b), max(c, d))


@compiled
def correct_one(
    sums: Any,
    mark: Any,
    run: Any,
    ran: Any,
    counts: Any,
    prefix: Any,
    factors: Any,
    frame: int,
    history: int,
    gamma: float,
    evidence: bool,
    carried: Any,
    out: Any,
) -> int:
    """Correct one technique on a frame: :func:`push`, :func:`weigh`, :func:`best_candidate`."""
    push(sums, mark, run, ran, frame, history, gamma)
    weigh(counts, prefix, ran, frame, frame + 1, ratio_of(gamma, evidence))
    return best_candidate(
        sums, mark, run, counts, prefix, factors, frame, history, gamma, evidence, carried, out
    )


class Match(NamedTuple):
    """What SIC says of one frame.

    Attributes:
        place: the corrected match, an index into the map.
        statistic: its statistic (in standard deviations of the technique's scores).
        correction: its statistic less that of the uncorrected match, ≥ 0.
    """

    place: int
    statistic: float
    correction: float


@dataclass
class _History:
    """Rows of the frames so far and what the kernels need of them; room for C frames."""

    buffer: RowBuffer
    ran: NDArray[np.uint8]  # (C,)
    counts: NDArray[np.int32]  # (C + 1,), see weigh
    prefix: NDArray[np.float64]  # (C + 1,)

    @classmethod
    def empty(cls, capacity: int, references: int, candidates: int) -> _History:
        """Room for ``capacity`` frames."""
        buffer = RowBuffer.empty(capacity, references, candidates)
        counts = np.zeros(capacity + 1, np.int32)
        return cls(buffer, np.zeros(capacity, np.uint8), counts, np.zeros(capacity + 1))

    def grown(self) -> _History:
        """The same with twice the room."""
        room = len(self.ran)
        return _History(
            buffer=self.buffer.grown(2 * room),
            ran=np.pad(self.ran, (0, room)),
            counts=np.pad(self.counts, (0, room)),
            prefix=np.pad(self.prefix, (0, room)),
        )

    def run(self) -> Any:
        """RUN record of these rows."""
        run = np.zeros(1, RUN)
        self.buffer.point(run)
        return run[0]


class SIC:
    """Corrects one technique frame by frame (A-MuSIC, III-A).

    Args:
        references: R, places of the map.
        settings: statistic, K, F and γ; by default those of ``evidence``.

    Example:
        >>> sic = SIC(references=3)
        >>> sic.correct([0.1, 0.9, 0.2]).place
        1

    Raises:
        ValueError: for a map without places, and for the statistic ``belief``, which no technique
            has by itself.
    """

    def __init__(self, references: int, settings: SICSettings | None = None) -> None:
        if references < 1:
            raise ValueError(f"references is {references}; a map has at least one place")
        self.settings = settings or SICSettings(statistic="evidence")
        if self.settings.statistic == "belief":
            raise ValueError(
                "statistic is 'belief', which all techniques share, but SIC corrects one alone;"
                " give 'evidence' or 'mean', or take TechniqueSelectionEnv(statistic='belief')"
            )
        self.references = references
        self.frame = -1
        self._history = _History.empty(64, references, self.settings.candidates)
        self._sums: NDArray[np.float64] = np.zeros(references + SLACK)
        reach = min(self.settings.history, references)
        self._factors = factors_of(reach + 1, self.settings.statistic == "evidence")
        self._mark = np.zeros(1, SUMS)
        new_sums(self._mark, references, self._sums.size, self.settings)
        self._last = -1  # the last match, moved on; -1 before the first and off the map

    def skip(self) -> None:
        """Let a frame pass on which the technique does not run."""
        self._weigh(self._advance())

    def correct(self, row: ArrayLike, fused: int = -1) -> Match:
        """Take the technique's scores (R,) of the next frame and return the corrected match.

        Args:
            row: the scores.
            fused: MuSIC's last prediction, moved on by one place per frame since, which is a
                candidate where the settings carry places on; −1 for none, or SIC alone.

        Raises:
            ValueError: for scores of the wrong shape, or NaN or +∞; −∞ is no candidate.
        """
        scores = self._checked(row)
        frame = self._advance()
        self._history.buffer.put(frame, scores)
        self._history.ran[frame] = 1
        return self._match(frame, fused)

    def preview(self, row: ArrayLike, fused: int = -1) -> Match:
        """What :meth:`correct` would return for the next frame, without taking it."""
        saved = (self.frame, self._sums.copy(), self._mark.copy(), self._last)
        match = self.correct(row, fused)
        self._history.ran[self.frame] = 0
        self.frame, self._sums, self._mark, self._last = saved
        return match

    @property
    def discount(self) -> float:
        """What MuSIC multiplies the statistic by, for the serial correlation of the rows so far."""
        python: Any = discount_of  # an inner function has no way in, but its source
        return float(python.py_func(self._mark.view(np.recarray)[0]))

    def _checked(self, row: ArrayLike) -> NDArray[np.float32]:
        scores = np.asarray(row, dtype=np.float32)
        if scores.shape != (self.references,):
            raise ValueError(
                f"a score row of shape {scores.shape} for a map of {self.references} places;"
                f" give one score per place"
            )
        if not (scores < np.inf).all():
            raise ValueError(f"NaN or infinite score at frame {self.frame + 1}; mend the technique")
        return scores

    def _advance(self) -> int:
        self.frame += 1
        self._last += self._last >= 0
        if self.frame >= len(self._history.ran):
            self._history = self._history.grown()
        return self.frame

    def _weigh(self, frame: int) -> None:
        rows = self._history
        ratio = ratio_of(self.settings.gamma, self.settings.statistic == "evidence")
        weigh(rows.counts, rows.prefix, rows.ran, frame, frame + 1, ratio)

    def _match(self, frame: int, fused: int) -> Match:
        settings, rows, mark = self.settings, self._history, self._mark[0]
        evidence = settings.statistic == "evidence"
        run, history, gamma = rows.run(), settings.history, settings.gamma
        prepare(run, frame)
        top = rows.buffer.top[frame]
        carried = np.array([self._last, fused] if settings.carry else [-1, -1])
        values = np.empty(top.size + CARRIED)
        winner = correct_one(
            *(self._sums, mark, run, rows.ran, rows.counts, rows.prefix, self._factors),
            *(frame, history, gamma, evidence, carried, values),
        )
        self._last = int(np.concatenate([top, carried])[winner])
        return Match(self._last, float(values[winner]), float(values[winner] - values[0]))
