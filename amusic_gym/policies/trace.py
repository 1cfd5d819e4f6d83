"""The record of one policy on one route: what everything that measures is given.

A :class:`Trace` holds what the policy did (predictions, confidences, runs, selections) and, joined
from the bank's ground truth afterwards, whether it was right. No policy and no environment ever
sees the second half.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import true_ranks
from amusic_gym.estimation.settings import carries
from amusic_gym.utils.escaping import CsvWriter
from amusic_gym.utils.storage import write_whole

if TYPE_CHECKING:
    from amusic_gym.envs.sources import Recording
    from amusic_gym.routes.bank_images import BankImages

CSV_COLUMNS = (
    "frame",
    "prediction",
    "confidence",
    "similarity",
    "p_correct",
    "correct",
    "techniques",
    "late_runs",
    "true_rank",
)

FILE_COLUMNS = ("true_place", "query_file", "query_change", "matched_file", "true_file")
"""Behind those, where the truth is known; the files where the bank's images are."""

DONE = (
    *("predictions", "confidence", "similarity", "p_correct", "chosen", "ran", "late_runs"),
    "selections",
)
"""What a policy did: with it :meth:`Trace.join` makes the trace again."""


@dataclass(frozen=True, eq=False)
class Trace:
    """One episode of one policy on one bank (Q frames, T techniques); arrays are read-only copies.

    Make one with :meth:`join`, which takes the truth and the costs from the bank.

    Raises:
        ValueError: a field has the wrong shape, a value that is not finite, or a run that
            contradicts another field; the message names the field and the frame.
    """

    techniques: tuple[str, ...]
    seconds: NDArray[np.float64]  # (T,) declared cost of one run
    predictions: NDArray[np.int64]  # (Q,) place, -1 = none yet
    confidence: NDArray[np.float64]  # (Q,) higher = surer; the threshold of the PR curve
    similarity: NDArray[np.float64]  # (Q,) z-score of the place in a row of the frame, 0: no run
    p_correct: NDArray[np.float64]  # (Q,) SIC-estimated correctness, nan = policy gives none
    chosen: NDArray[np.int64]  # (Q,) technique MuSIC trusted, -1 = none
    ran: NDArray[np.bool_]  # (Q, T) on the frame itself
    late_runs: NDArray[np.int64]  # (Q, T) after-the-fact runs charged at that frame's step
    selections: NDArray[np.bool_]  # (Q,) a selection was done before this frame
    correct: NDArray[np.bool_]  # (Q,) the prediction is a true place
    has_place: NDArray[np.bool_]  # (Q,) there is a true place at all
    true_place: NDArray[np.int64]  # (Q,) middle of the true places nearest to the prediction, or -1
    error: NDArray[np.float64]  # (Q,) places to the nearest true one, nan without one
    true_rank: NDArray[np.int64]  # (Q,) of the first true place (`banks.ranking`), 0 = none, -1 = ?
    bank: str
    policy: str
    compute_weight: float | None
    statistic: str
    carry: bool  # whether places were carried on as candidates
    costs: str  # name of the cost model behind `seconds`

    @classmethod
    def join(
        cls,
        bank: Recording,
        *,
        predictions: ArrayLike,
        confidence: ArrayLike,
        similarity: ArrayLike,
        ran: ArrayLike,
        policy: str,
        statistic: str,
        p_correct: ArrayLike | None = None,
        chosen: ArrayLike | None = None,
        late_runs: ArrayLike | None = None,
        selections: ArrayLike | None = None,
        compute_weight: float | None = None,
        carry: bool | None = None,
    ) -> Trace:
        """What a policy did on the whole of `bank`, with correctness and costs from the bank.

        Left out: `p_correct` is nan, `chosen` -1, `late_runs` 0 and `selections` False throughout,
        `carry` as the statistic has it.

        Raises:
            ValueError: for a live route whose length or ground truth is not known.
        """
        if bank.truth is None or bank.queries is None:
            raise ValueError(
                f"live route {bank.name!r} has no ground truth, which a trace is measured with;"
                " give it ground_truth, or use navigate and TraceWriter"
            )
        per_frame, per_run = (bank.queries,), (bank.queries, len(bank.techniques))
        predicted = _typed("predictions", predictions, np.int64, per_frame)
        runs = _typed("ran", ran, np.bool_, per_run)
        if isinstance(bank, ScoreBank):
            true_rank = true_ranks(bank, predicted, runs)
        else:  # a live route keeps no rows
            true_rank = np.full(per_frame, -1)
        return cls(
            techniques=tuple(bank.techniques),
            seconds=bank.seconds,
            predictions=predicted,
            confidence=np.asarray(confidence),
            similarity=np.asarray(similarity),
            p_correct=np.full(per_frame, np.nan) if p_correct is None else np.asarray(p_correct),
            chosen=np.full(per_frame, -1) if chosen is None else np.asarray(chosen),
            ran=runs,
            late_runs=np.zeros(per_run, np.int64) if late_runs is None else np.asarray(late_runs),
            selections=np.zeros(per_frame, bool) if selections is None else np.asarray(selections),
            correct=bank.truth.correct(predicted),
            has_place=bank.truth.has_place,
            true_place=bank.truth.centres(predicted),
            error=bank.truth.distance(predicted),
            true_rank=true_rank,
            bank=bank.name,
            policy=policy,
            compute_weight=compute_weight,
            statistic=statistic,
            carry=carries(statistic) if carry is None else carry,
            costs=bank.costs,
        )

    def __post_init__(self) -> None:
        """Check every array against Q and T, keep a read-only copy of it."""
        queries, techniques = np.size(self.predictions), len(self.techniques)
        if not queries or not techniques:
            raise ValueError(
                f"a trace of {queries} frames and {techniques} techniques measures nothing; "
                "give at least one of each"
            )
        for name, (dtype, shape) in _fields(queries, techniques).items():
            array = _typed(name, getattr(self, name), dtype, shape).copy()
            array.setflags(write=False)
            object.__setattr__(self, name, array)
        self._check_values()

    def _check_values(self) -> None:
        if not (np.isfinite(self.seconds).all() and (self.seconds > 0).all()):
            raise ValueError(f"seconds are {self.seconds}; give each technique a cost above 0")
        for name in ("confidence", "similarity"):
            values = getattr(self, name)
            _refuse(~np.isfinite(values), values, name, "a finite number")
        outside = (self.p_correct < 0) | (self.p_correct > 1)
        _refuse(outside, self.p_correct, "p_correct", "a value in [0, 1], or nan for none")
        bad_choice = (self.chosen < -1) | (self.chosen >= len(self.techniques))
        _refuse(bad_choice, self.chosen, "chosen technique", "an index of techniques, or -1")
        negative = np.asarray((self.late_runs < 0).any(axis=1))
        _refuse(negative, self.late_runs, "late_runs", "counts from 0 up")
        placeless = self.correct & ~self.has_place
        _refuse(placeless, self.correct, "correct", "False where there is no true place")

    @property
    def queries(self) -> int:
        """Number of frames, Q."""
        return len(self.predictions)

    @property
    def runs(self) -> NDArray[np.int64]:
        """Runs charged at each frame's step, after-the-fact ones included, (Q, T)."""
        return self.ran.astype(np.int64) + self.late_runs

    def late_frames(self) -> NDArray[np.bool_]:
        """On which frames each technique ran after the fact, (Q, T).

        `late_runs` says at which step such runs were charged. They fell on the latest earlier
        frames that the technique had not seen yet (A-MuSIC, III-C), which fixes the frames.
        """
        seen = self.ran.copy()  # (Q, T)
        for frame, technique in np.argwhere(self.late_runs):
            unseen = np.flatnonzero(~seen[:frame, technique])
            count = self.late_runs[frame, technique]
            seen[unseen[max(0, unseen.size - count) :], technique] = True
        return seen & ~self.ran

    def write_csv(self, path: str | Path, images: BankImages | None = None) -> Path:
        """Write a line per frame with `CSV_COLUMNS` and `FILE_COLUMNS`; whole, or not at all.

        `techniques` are the names run on the frame itself, joined by "+"; `late_runs` the number of
        after-the-fact runs charged at its step; `p_correct` is empty where there is none;
        `true_rank` is that of the first true place in the frame's list, 0 if it is not in it. The
        image of `query_file` is seen under `query_change`, where that is not empty.

        Args:
            path: of the file.
            images: the bank's; None: the columns of files stay empty.
        """
        text = io.StringIO()
        writer = CsvWriter(text)
        writer.writerow((*CSV_COLUMNS, *FILE_COLUMNS))
        for frame in range(self.queries):
            estimate = float(self.p_correct[frame])
            place, true = int(self.predictions[frame]), int(self.true_place[frame])
            writer.writerow(
                csv_line(
                    frame,
                    place,
                    float(self.confidence[frame]),
                    float(self.similarity[frame]),
                    None if np.isnan(estimate) else estimate,
                    bool(self.correct[frame]),
                    [n for n, on in zip(self.techniques, self.ran[frame], strict=True) if on],
                    int(self.late_runs[frame].sum()),
                    int(self.true_rank[frame]),
                )
                + ["" if true < 0 else true, *_files(images, frame, place, true)]
            )
        return write_whole(path, text.getvalue().encode(errors="surrogateescape"))


def _files(images: BankImages | None, frame: int, place: int, true: int) -> list[str]:
    """The values of `FILE_COLUMNS` behind the first."""
    if images is None:
        return [""] * 4
    query = images.query[frame]
    places = ("" if at < 0 else str(images.reference[at].path) for at in (place, true))
    return [str(query.path), str(query.change or ""), *places]


def csv_line(
    frame: int,
    prediction: int,
    confidence: float,
    similarity: float,
    p_correct: float | None,
    correct: bool | None,
    ran: Sequence[str],
    late_runs: int,
    true_rank: int = -1,
) -> list[int | str]:
    """The values of `CSV_COLUMNS` of one frame; None, of what is not known, is empty."""
    return [
        frame,
        prediction,
        repr(confidence),
        repr(similarity),
        "" if p_correct is None else repr(p_correct),
        "" if correct is None else int(correct),
        "+".join(ran),
        late_runs,
        "" if true_rank < 0 else true_rank,
    ]


def _fields(queries: int, techniques: int) -> dict[str, tuple[type[Any], tuple[int, ...]]]:
    """Name -> (dtype, shape) of every array in a trace."""
    per_frame, per_run = (queries,), (queries, techniques)
    return {
        "seconds": (np.float64, (techniques,)),
        "predictions": (np.int64, per_frame),
        "confidence": (np.float64, per_frame),
        "similarity": (np.float64, per_frame),
        "p_correct": (np.float64, per_frame),
        "chosen": (np.int64, per_frame),
        "ran": (np.bool_, per_run),
        "late_runs": (np.int64, per_run),
        "selections": (np.bool_, per_frame),
        "correct": (np.bool_, per_frame),
        "has_place": (np.bool_, per_frame),
        "true_place": (np.int64, per_frame),
        "error": (np.float64, per_frame),
        "true_rank": (np.int64, per_frame),
    }


def _typed(name: str, values: ArrayLike, dtype: type[Any], shape: tuple[int, ...]) -> NDArray[Any]:
    """`values` as an array of `dtype` and `shape`, refused where that would change a value."""
    given = np.asarray(values)
    if given.shape != shape:
        raise ValueError(f"{name} has shape {given.shape}; give {shape} to match the other fields")
    with np.errstate(invalid="ignore"):
        array = given.astype(dtype)
    if dtype is not np.float64 and not np.array_equal(array, given):
        raise ValueError(f"{name} holds values that are no {dtype.__name__}; give whole numbers")
    return array


def _refuse(bad: NDArray[np.bool_], values: NDArray[Any], name: str, wanted: str) -> None:
    if bad.any():
        frame = int(np.flatnonzero(bad)[0])
        raise ValueError(f"{name} of frame {frame} is {values[frame]}; give {wanted}")
