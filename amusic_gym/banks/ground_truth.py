"""Which reference places are true for each query frame."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.utils.checks import whole

LARGEST_TOLERANCE = 2**31 - 1  # places; the compiled dynamics count no further
_FEW = 20  # places of a map so small that all of them may be right for all frames


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """True places of each query, sparse: query q has ``places[indptr[q]:indptr[q + 1]]``.

    A query may have no true place: every prediction for it is wrong, and it does not count among
    the queries that recall can reach. Arrays are kept read-only.

    Raises:
        ValueError: for arrays that are not such a list.
    """

    indptr: NDArray[np.int64]  # (Q+1,) int64, where each query's places begin and end
    places: NDArray[np.int64]  # (P,) int64, rising within each query, in [0, ``references``)
    references: int  # R, places on the map
    # (P,) q * R + place: rising over all queries, so one search answers for many frames.
    _keys: NDArray[np.int64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        indptr = _integers(self.indptr, "ground truth indptr").copy()
        places = _integers(self.places, "ground truth places").copy()
        references = whole("references", self.references, 1)
        if len(indptr) < 2:
            raise ValueError("ground truth has no query; at least one is needed")
        if indptr[0] != 0 or indptr[-1] != len(places) or np.any(np.diff(indptr) < 0):
            raise ValueError(
                f"ground truth indptr does not rise from 0 to {len(places)}, the number of places"
            )
        _check_range(places, 0, references, "true place")
        queries = np.repeat(np.arange(len(indptr) - 1), np.diff(indptr))
        keys = queries * references + places
        if np.any(np.diff(keys) <= 0):
            frame = int(queries[1:][np.diff(keys) <= 0][0])
            raise ValueError(
                f"ground truth of frame {frame} repeats a place or is unsorted; list each place "
                "once, rising"
            )
        for array in (indptr, places, keys):
            array.flags.writeable = False
        object.__setattr__(self, "indptr", indptr)
        object.__setattr__(self, "places", places)
        object.__setattr__(self, "references", references)
        object.__setattr__(self, "_keys", keys)

    @classmethod
    def from_matrix(cls, matrix: ArrayLike) -> GroundTruth:
        """Ground truth from a (Q, R) boolean matrix, true where a place is right for a query."""
        array = np.asarray(matrix)
        if array.dtype != np.bool_ or array.ndim != 2:
            raise ValueError(
                f"ground truth has shape {array.shape} and dtype {array.dtype}; "
                "give a boolean matrix [query, reference]"
            )
        return cls.from_lists([np.flatnonzero(row) for row in array], array.shape[1])

    @classmethod
    def from_places(cls, centres: ArrayLike, tolerance: int, references: int) -> GroundTruth:
        """Ground truth from one place per query, ± ``tolerance`` places, cut off at the map's ends.

        ``centres`` (Q,) are in [0, R), or -1 for a query without a true place.
        """
        middle = _integers(centres, "ground truth")
        _check_range(middle, -1, references, "true place")
        known = middle >= 0
        return cls(np.append(0, np.cumsum(known)), middle[known], references).widened(tolerance)

    @classmethod
    def from_lists(cls, places: Sequence[ArrayLike], references: int) -> GroundTruth:
        """Ground truth from the true places of each query, rising, on a map of ``references``."""
        rows = [np.asarray(row, np.int64) for row in places]
        indptr = np.append(0, np.cumsum([len(row) for row in rows], dtype=np.int64))
        return cls(indptr, np.concatenate([np.zeros(0, np.int64), *rows]), references)

    def widened(self, tolerance: int, parts: Sequence[int] = ()) -> GroundTruth:
        """The same, and ``tolerance`` places to either side of each true one, on its own part.

        ``parts`` are the lengths of those that the map is joined of; by default it is one.
        """
        reach = min(check_tolerance(tolerance), self.references)
        ends = np.cumsum(parts or [self.references])
        part = np.searchsorted(ends, self.places, "right")
        first = np.maximum(self.places - reach, np.append(0, ends)[part])
        last = np.minimum(self.places + reach, ends[part] - 1)
        count = last - first + 1
        offsets = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        keys = np.unique(np.repeat(self._keys - self.places + first, count) + offsets)
        indptr = np.searchsorted(keys, self.references * np.arange(self.queries + 1))
        return GroundTruth(indptr, keys % self.references, self.references)

    def with_tolerance(self, tolerance: int, parts: Sequence[int] = ()) -> GroundTruth:
        """The same widened by a tolerance, unless its places are ranges of that tolerance already.

        Raises:
            ValueError: for ranges of another tolerance: were these to be widened, or replaced?
        """
        runs, own = self._runs(), self.half_run()
        if own == check_tolerance(tolerance):
            return self
        if runs.max() > 1:
            raise ValueError(
                f"tolerance is {tolerance}, but the ground truth lists neighbouring places itself "
                f"(a run of {runs.max()} at frame {runs.argmax()}), which stand for {own}; leave "
                "the tolerance out, or list the middle of each range only"
            )
        return self.widened(tolerance, parts)

    @property
    def queries(self) -> int:
        """Q, frames of the query traverse."""
        return len(self.indptr) - 1

    @property
    def has_place(self) -> NDArray[np.bool_]:
        """(Q,) whether the query has a true place at all."""
        return np.diff(self.indptr) > 0

    def of(self, query: int) -> NDArray[np.int64]:
        """(n,) true places of a query, rising."""
        return self.places[self.indptr[query] : self.indptr[query + 1]]

    def correct(self, predictions: ArrayLike, frames: ArrayLike | None = None) -> NDArray[np.bool_]:
        """Whether each predicted place (n,) is a true one; −1 (no prediction) never is.

        ``frames`` (n,) are the query frame of each; None: one prediction for every frame in order.
        """
        places, queries = self._pairs(predictions, frames)
        if not len(self._keys):
            return np.zeros(len(places), np.bool_)
        keys = queries * self.references + places
        found = self._keys[np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)]
        right: NDArray[np.bool_] = (found == keys) & (places >= 0)
        return right

    def is_true(self, place: int, frame: int) -> bool:
        """Whether one place in [0, R), or −1 for none, is true for a frame; as :meth:`correct`."""
        end = int(self.indptr[frame + 1])
        at = bisect_left(self.places, place, int(self.indptr[frame]), end)
        return at < end and bool(self.places[at] == place)

    def distance(
        self, predictions: ArrayLike, frames: ArrayLike | None = None
    ) -> NDArray[np.float64]:
        """(n,) float64 places from each prediction to the nearest true one; arguments of `correct`.

        R where there is no prediction; nan where the query has no true place.
        """
        places, queries = self._pairs(predictions, frames)
        result = np.full(len(places), np.nan)
        known = self.indptr[queries + 1] > self.indptr[queries]
        places = places[known]
        gap = np.abs(places - self.places[self._nearest(places, queries[known])])
        result[known] = np.where(places < 0, self.references, gap)
        return result

    def centres(self, predictions: ArrayLike) -> NDArray[np.int64]:
        """(Q,) middle of the run of true neighbours nearest to each prediction; -1 where none is.

        A run that the map's end cuts off has its middle where that of a whole one would be.
        Predictions (Q,) are places in [0, R), or -1.
        """
        places, queries = self._pairs(predictions, None)
        result = np.full(len(places), -1)
        first, query_of = self._run_starts()
        last = np.append(first[1:], len(query_of)) - 1
        known = self.has_place
        nearest = self._nearest(places[known], queries[known])
        run = np.searchsorted(first, nearest, "right") - 1
        low, high = self.places[first[run]], self.places[last[run]]
        half, end = self.half_run(), self.references - 1
        cut = high - low < 2 * half
        middle = np.where(cut & (low == 0), np.maximum(high - half, 0), (low + high) // 2)
        result[known] = np.where(
            cut & (high == end) & (low > 0), np.minimum(low + half, end), middle
        )
        return result

    def _nearest(self, places: NDArray[np.int64], queries: NDArray[np.int64]) -> NDArray[np.int64]:
        """Where in ``self.places`` the true place nearest to each is; all queries have one."""
        begin, end = self.indptr[queries], self.indptr[queries + 1] - 1
        # The true places on either side; at a query's first or last one, both are the same.
        at = np.searchsorted(self._keys, queries * self.references + np.maximum(places, 0))
        below, above = np.clip(at - 1, begin, end), np.clip(at, begin, end)
        nearer = np.abs(places - self.places[below]) <= np.abs(self.places[above] - places)
        return np.where(nearer, below, above)

    def matrix(self) -> NDArray[np.bool_]:
        """(Q, R) boolean, true where a place is right for a query."""
        matrix = np.zeros((self.queries, self.references), np.bool_)
        matrix[np.repeat(np.arange(self.queries), np.diff(self.indptr)), self.places] = True
        return matrix

    def half_run(self) -> int:
        """Half the median length, in places, of the queries' longest runs of true neighbours.

        Not of their span: a place visited twice is true at both visits, far apart.
        """
        runs = self._runs()
        return int(np.median(runs[runs > 0]) / 2) if runs.any() else 0

    def _runs(self) -> NDArray[np.int64]:
        """(Q,) length of each query's longest run of neighbouring true places."""
        first, query_of = self._run_starts()
        longest = np.zeros(self.queries, np.int64)
        np.maximum.at(longest, query_of[first], np.diff(first, append=len(self.places)))
        return longest

    def _run_starts(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Where in ``self.places`` each run of neighbours begins, and each place's query."""
        query_of = np.repeat(np.arange(self.queries), np.diff(self.indptr))
        begins = (np.diff(self.places, prepend=-2) != 1) | (np.diff(query_of, prepend=-1) != 0)
        return np.flatnonzero(begins), query_of

    def _pairs(
        self, predictions: ArrayLike, frames: ArrayLike | None
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        places = _integers(predictions, "predictions")
        _check_range(places, -1, self.references, "predicted place")
        queries = np.arange(self.queries) if frames is None else _integers(frames, "frames")
        if len(places) != len(queries):
            raise ValueError(f"{len(places)} predictions for {len(queries)} frames; give one each")
        _check_range(queries, 0, self.queries, "frame")
        return places, queries

    def __reduce__(self) -> tuple[Any, ...]:
        return GroundTruth, (self.indptr, self.places, self.references)


def resolve_ground_truth(
    ground_truth: ArrayLike | GroundTruth | None,
    tolerance: int | None,
    queries: int,
    references: int,
    parts: Sequence[int] = (),
) -> tuple[GroundTruth, int]:
    """The ground truth and the tolerance of a bank, from the forms in which users have them.

    Args:
        ground_truth: None (query q is at place q, of as many) | (Q, R) boolean | (Q,) integer
            centres, -1 for none | GroundTruth, which stays as it is.
        tolerance: places to either side of a centre that are right; with a matrix, see
            :meth:`GroundTruth.with_tolerance`. None only where the true places themselves are
            given: then :meth:`GroundTruth.half_run`.
        queries: Q.
        references: R.
        parts: see :meth:`GroundTruth.widened`.

    Raises:
        ValueError: for ground truth of another shape or range, or a missing tolerance.
    """
    if tolerance is not None:
        tolerance = check_tolerance(tolerance)
    if ground_truth is None:
        if queries != references:
            raise ValueError(
                f"{queries} queries on a map of {references} places: which place is true for "
                "which? give ground_truth (--ground-truth) as one place per query, as a boolean "
                "matrix, or as a list of pairs (scores have a column per place, unlike descriptors)"
            )
        ground_truth = np.arange(queries)
    if not isinstance(ground_truth, GroundTruth):
        ground_truth = np.asarray(ground_truth)
        _check_shape(ground_truth.shape, queries, references)
        if ground_truth.ndim == 2:
            ground_truth = GroundTruth.from_matrix(ground_truth)
            if tolerance is not None:
                ground_truth = ground_truth.with_tolerance(tolerance, parts)
        elif tolerance is None:
            raise ValueError(
                "tolerance is missing; give tolerance=N, the places to either side of the true "
                "one that count as right, or a boolean ground truth matrix"
            )
        else:
            ground_truth = GroundTruth.from_places(ground_truth, 0, references)
            ground_truth = ground_truth.widened(tolerance, parts)
    _check_shape((ground_truth.queries, ground_truth.references), queries, references)
    if references >= _FEW and ground_truth.places.size == queries * references:
        raise ValueError(
            f"every one of the {references} places is right for every frame, so nothing could be "
            f"wrong; give a smaller tolerance than {tolerance}, or mend the ground truth"
        )
    return ground_truth, ground_truth.half_run() if tolerance is None else tolerance


def check_tolerance(value: Any) -> int:
    """A tolerance in places as int; refuses what is none from 0 to ``LARGEST_TOLERANCE``."""
    if whole("tolerance", value, 0) > LARGEST_TOLERANCE:
        raise ValueError(f"tolerance is {value}; give at most {LARGEST_TOLERANCE} places")
    return int(value)


def _check_shape(shape: tuple[int, ...], queries: int, references: int) -> None:
    if shape not in ((queries,), (queries, references)):
        raise ValueError(
            f"ground truth has shape {shape}, but the scores have {queries} queries and "
            f"{references} references; give shape ({queries}, {references}) or ({queries},) "
            "(scores have a column per place, unlike descriptors)"
        )


def _check_range(values: NDArray[np.int64], low: int, end: int, what: str) -> None:
    outside = (values < low) | (values >= end)
    if outside.any():
        index = int(np.argmax(outside))
        none = " (-1: none)" if low < 0 else ""
        raise ValueError(
            f"{what} {values[index]} (entry {index}) is out of range; valid: {low} to "
            f"{end - 1}{none}"
        )


def _integers(values: ArrayLike, what: str) -> NDArray[np.int64]:
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ValueError(
            f"{what} has shape {array.shape} and dtype {array.dtype}; give a list of integers"
        )
    return array.astype(np.int64)
