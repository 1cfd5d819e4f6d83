"""The numbers of a comparison, each from a trace (:mod:`amusic_gym.policies.trace`) or arrays.

Accuracy, precision-recall, AUC and PTR (proportion of technique runs) follow A-MuSIC, IV-B; where
it leaves the AUC open two common readings are given, and the one that gives its figures.
"""

import warnings
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.policies.trace import Trace

LOST_FRAMES = 5  # a run of at least so many wrong frames in a row counts as being lost
CALIBRATION_BINS = 15
MEAN_KEY = ("policy", "compute_weight", "statistic", "carry", "costs")
"""Rows that are alike in these are averaged."""

RECALLS = {f"recall_at_{n}": n for n in (1, 5, 10, 20)}  # column -> N of Recall@N

AVERAGED = (
    "accuracy",
    "auc",
    "auc_vprbench",
    "auc_paper",
    "ptr",
    "compute",
    "seconds_per_frame",
    "reselections",
    "idle",
    "median_error",
    "lost",
    *RECALLS,
    "recall_at_100_precision",
)


class Reliability(NamedTuple):
    """Estimated against observed correctness in B equal bins of [0, 1]; nan in empty bins."""

    predicted: NDArray[np.float64]  # (B,) mean estimate
    observed: NDArray[np.float64]  # (B,) share correct
    counts: NDArray[np.int64]  # (B,) frames


def precision_recall(
    correct: ArrayLike, confidence: ArrayLike, positives: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Precision and recall (each (D+1,)) at the D distinct confidences, from the surest down.

    The first point repeats the first precision at recall 0. Recall = true positives / `positives`,
    the number of queries that have a true place; with no positives, recall is 0 throughout.
    Frames of equal confidence pass the threshold together.

    Raises:
        ValueError: the arrays are empty, differ in length, hold a confidence that is not finite, or
            more frames are correct than there are positives.
    """
    right, score = _pair(correct, confidence, "confidence")
    if positives < right.sum():
        raise ValueError(
            f"{right.sum()} frames are correct but only {positives} have a true place; "
            "give the number of queries that have one as positives"
        )
    order = np.argsort(-score, kind="stable")
    last = np.append(np.flatnonzero(np.diff(score[order])), score.size - 1)  # ends of tied groups
    hits = np.cumsum(right[order])[last]
    precision = hits / (last + 1.0)
    recall = hits / float(max(positives, 1))
    return np.append(precision[0], precision), np.append(0.0, recall)


def curve(trace: Trace) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """:func:`precision_recall` of a trace, over the queries that have a true place."""
    return precision_recall(trace.correct, trace.confidence, int(trace.has_place.sum()))


def area(precision: NDArray[np.float64], recall: NDArray[np.float64]) -> float:
    """Trapezoid under :func:`precision_recall`; no correct match leaves recall, hence area, 0."""
    return float(np.diff(recall) @ (precision[1:] + precision[:-1]) / 2.0)


def auc(trace: Trace) -> float:
    """Area under the PR curve, recall over all queries that have a true place; trapezoid.

    Without one correct match it is 0, with a warning: a curve through no true positive has no area.
    """
    _warn_if_nothing_is_right(trace)
    return area(*curve(trace))


def auc_vprbench(trace: Trace) -> float:
    """Area as VPR-Bench computes it, by scikit-learn's curve: recall over the *correct* frames.

    It starts at precision 1 and says how well confidence ranks right above wrong, not how many
    queries were localised. Without one correct match it is 0, with a warning.
    """
    _warn_if_nothing_is_right(trace)
    return _ranking(trace.correct, trace.confidence)


def auc_paper(trace: Trace) -> float:
    """Area that gives the paper's figures: :func:`auc_vprbench` over `similarity` (A-MuSIC, IV-B).

    The threshold is what the frame's own row says of the place, not SIC's statistic. Without one
    correct match it is 0, with a warning.
    """
    _warn_if_nothing_is_right(trace)
    return _ranking(trace.correct, trace.similarity)


def summarise(trace: Trace) -> dict[str, Any]:
    """The row of `results.json` for one trace; plain Python values, so `json.dump` takes it.

    `compute_weight` is None for policies that have none, `median_error` None where no query has a
    true place, Recall@N None for a live route. A re-selection is every selection but the first.
    """
    _warn_if_nothing_is_right(trace)
    errors = trace.error[trace.has_place]
    return {
        "bank": trace.bank,
        "policy": trace.policy,
        "compute_weight": trace.compute_weight,
        "statistic": trace.statistic,
        "carry": trace.carry,
        "costs": trace.costs,
        "queries": trace.queries,
        "accuracy": float(trace.correct.mean()),
        "auc": area(*curve(trace)),
        "auc_vprbench": _ranking(trace.correct, trace.confidence),
        "auc_paper": _ranking(trace.correct, trace.similarity),
        "ptr": ptr(trace),
        "compute": compute(trace),
        "seconds_per_frame": float(trace.runs.sum(axis=0) @ trace.seconds) / trace.queries,
        "reselections": reselections(trace),
        "idle": float((~trace.ran.any(axis=1)).mean()),
        "median_error": float(np.median(errors)) if errors.size else None,
        "lost": lost(trace.correct),
        **{column: recall_at(trace, n) for column, n in RECALLS.items()},
        "recall_at_100_precision": recall_at_full_precision(trace),
    }


def recall_at(trace: Trace, n: int) -> float | None:
    """Recall@N: share of the queries with a true place that have one among their first N places.

    The list of a query is that of `amusic_gym.banks.ranking`: the policy's place first. None for a
    live route, which keeps no rows; 0 where no query has a true place.
    """
    ranks = trace.true_rank[trace.has_place]
    if (trace.true_rank < 0).any():
        return None
    return float(((ranks > 0) & (ranks <= n)).mean()) if ranks.size else 0.0


def recall_at_full_precision(trace: Trace) -> float:
    """Recall@100 % precision: the highest recall of `curve` before the first wrong match."""
    precision, recall = curve(trace)
    return float(recall[precision == 1.0].max(initial=0.0))


def ptr(trace: Trace) -> float:
    """Processed-technique ratio: runs, after-the-fact ones included, of all Q * T (IV-B)."""
    return float(trace.runs.mean())


def compute(trace: Trace) -> float:
    """Seconds of all runs, as a share of running every technique on every frame."""
    spent = float(trace.runs.sum(axis=0) @ trace.seconds)
    return spent / (trace.queries * float(trace.seconds.sum()))


def reselections(trace: Trace) -> int:
    """Selections but for the first one."""
    return max(0, int(trace.selections.sum()) - 1)


def mean_rows(
    rows: Sequence[Mapping[str, Any]], key: Sequence[str] = MEAN_KEY
) -> list[dict[str, Any]]:
    """Rows averaged, one for each value of `key`, in the order of the first.

    Every row weighs the same; `queries` is their total and `bank`, if not in the key, "mean". A
    value of None is left out of its mean.
    """
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in key), []).append(row)
    means = []
    for group in groups.values():
        mean = {**group[0], "queries": sum(row["queries"] for row in group)}
        if "bank" not in key:
            mean["bank"] = "mean"
        for name in AVERAGED:
            values = [row[name] for row in group if row[name] is not None]
            mean[name] = float(np.mean(values)) if values else None
        means.append(mean)
    return means


def lost(correct: ArrayLike) -> float:
    """Share of frames inside runs of at least `LOST_FRAMES` wrong frames."""
    wrong = ~np.asarray(correct, dtype=bool)
    edges = np.flatnonzero(np.diff(wrong, prepend=False, append=False))
    lengths = edges[1::2] - edges[::2]
    return float(lengths[lengths >= LOST_FRAMES].sum() / wrong.size)


def auroc(correct: ArrayLike, score: ArrayLike) -> float:
    """Chance that a correct frame scores above a wrong one, ties half; nan if all are alike."""
    right, value = _pair(correct, score, "score")
    hits = int(right.sum())
    misses = right.size - hits
    if not hits or not misses:
        return float("nan")
    _, group, counts = np.unique(value, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - (counts - 1) / 2.0)[group]  # 1-based, ties share their mean
    return float((ranks[right].sum() - hits * (hits + 1) / 2.0) / (hits * misses))


def brier(correct: ArrayLike, p: ArrayLike) -> float:
    """Mean squared distance between the estimate and the outcome; 0 is best."""
    right, estimate = _pair(correct, p, "estimate")
    return float(np.mean((estimate - right) ** 2))


def reliability(correct: ArrayLike, p: ArrayLike, bins: int = CALIBRATION_BINS) -> Reliability:
    """Estimated and observed correctness in `bins` equal bins of [0, 1]; 1 is in the last one.

    Raises:
        ValueError: an estimate lies outside [0, 1], or there is no bin.
    """
    right, estimate = _pair(correct, p, "estimate")
    if bins < 1:
        raise ValueError(f"bins is {bins}; give at least 1")
    if estimate.min() < 0 or estimate.max() > 1:
        raise ValueError(
            f"estimates reach from {estimate.min()} to {estimate.max()}; give values in [0, 1]"
        )
    member = np.minimum((estimate * bins).astype(np.int64), bins - 1)
    counts = np.bincount(member, minlength=bins)
    with np.errstate(invalid="ignore"):
        predicted = np.bincount(member, estimate, minlength=bins) / counts
        observed = np.bincount(member, right.astype(float), minlength=bins) / counts
    return Reliability(predicted, observed, counts)


def calibration_error(correct: ArrayLike, p: ArrayLike, bins: int = CALIBRATION_BINS) -> float:
    """Expected calibration error: mean gap of :func:`reliability`, weighted by frames."""
    table = reliability(correct, p, bins)
    held = table.counts > 0
    gaps = np.abs(table.predicted - table.observed)[held]
    return float(gaps @ table.counts[held] / table.counts.sum())


def _ranking(correct: NDArray[np.bool_], score: NDArray[np.float64]) -> float:
    """Area under scikit-learn's curve: how well a score ranks the correct frames first."""
    precision, recall = precision_recall(correct, score, int(correct.sum()))
    precision[0] = 1.0  # scikit-learn's curve starts at recall 0, precision 1
    return area(precision, recall)


def _warn_if_nothing_is_right(trace: Trace) -> None:
    if not trace.correct.any():
        warnings.warn(
            f"{trace.policy} has no correct match on bank {trace.bank!r}: its AUC is 0; check that "
            "the ground truth belongs to these scores",
            UserWarning,
            stacklevel=3,
        )


def _pair(
    correct: ArrayLike, values: ArrayLike, name: str
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    right, value = np.asarray(correct, dtype=bool), np.asarray(values, dtype=np.float64)
    if right.ndim != 1 or right.shape != value.shape or not right.size:
        raise ValueError(
            f"correct has shape {right.shape} and {name} {value.shape}; give one of each per frame"
        )
    if not np.isfinite(value).all():
        frame = int(np.flatnonzero(~np.isfinite(value))[0])
        raise ValueError(f"{name} of frame {frame} is {value[frame]}; give finite numbers")
    return right, value
