"""Statistics of a score matrix, to compare simulated routes with real recordings."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank

# Key -> what it is, in the order of the tables. `accuracy_NAME` is filled for given predictions.
MEASURES: dict[str, str] = {
    "true_z": "z-score of the true place, median over frames",
    "max_z": "highest z-score of a row, median over frames",
    "z_99": "z-scores, 99 % quantile",
    "z_01": "z-scores, 1 % quantile",
    "true_in_tenth": "frames whose true place is in the best tenth of the map",
    "accuracy_raw": "top-1 accuracy before SIC",
    "accuracy_mean": "top-1 accuracy after SIC, mean",
    "accuracy_evidence": "top-1 accuracy after SIC, evidence",
    "accuracy_belief": "top-1 accuracy of the belief, fed by it alone",
    "run_raw": "wrong frames in a row before SIC, mean length",
    "run_longest": "wrong frames in a row before SIC, longest as a share of the route",
    "run_evidence": "wrong frames in a row after SIC, evidence, mean length",
    "run_belief": "wrong frames in a row of the belief, mean length",
    "true_z_memory": "correlation of the true place's z from frame to frame",
    "along_query": "correlation of wrong places' z with the next frame's, same place",
    "along_map": "correlation of wrong places' z with the next place's, same frame",
    "along_diagonal": "correlation of wrong places' z with the next place's, next frame",
    "hubness": "deviation of the places' mean z (hubs, voids)",
    "hubs_last": "correlation of the places' mean z in the two halves of the route",
    "noise_lasts": "correlation of wrong places' z, without the place's mean, 8 frames on",
    "row_shift": "deviation of row means, in deviations within a row",
}


def describe(
    bank: ScoreBank, technique: int, predictions: Mapping[str, NDArray[np.int64]]
) -> dict[str, float]:
    """The measures of one technique's matrix; nan where a route is too short to have one.

    ``predictions``: places (Q,) where the technique alone runs, by statistic.
    """
    scores = bank.scores[technique].astype(np.float64)  # (Q, R)
    z = _standardised(scores)
    truth = bank.truth
    matrix = truth.matrix()
    right = truth.correct(scores.argmax(axis=1))
    frames = np.flatnonzero(truth.has_place)
    middle = (truth.indptr[frames] + truth.indptr[frames + 1]) // 2  # of a frame's true places
    true_z = z[frames, truth.places[middle]]
    rank = (z[frames] > true_z[:, None]).sum(axis=1)
    measured = {
        "true_z": float(np.median(true_z)) if frames.size else np.nan,
        "max_z": float(np.median(z.max(axis=1))),
        "z_99": float(np.quantile(z, 0.99)),
        "z_01": float(np.quantile(z, 0.01)),
        "true_in_tenth": float((rank < bank.references / 10).mean()) if frames.size else np.nan,
        "accuracy_raw": float(right.mean()),
        "run_raw": _mean(_runs(~right)),
        "run_longest": max(_runs(~right), default=0) / len(right),
        "true_z_memory": _correlation(true_z[:-1], true_z[1:]),
        "along_query": _lagged(z, matrix, 1, 0),
        "along_map": _lagged(z, matrix, 0, 1),
        "along_diagonal": _lagged(z, matrix, 1, 1),
        "hubness": float(z.mean(axis=0).std()),
        "hubs_last": _halves(z),
        "noise_lasts": _lagged(z - z.mean(axis=0), matrix, 8, 0),
        "row_shift": float(scores.mean(axis=1).std() / max(scores.std(axis=1).mean(), 1e-12)),
    }
    for name, predicted in predictions.items():
        corrected = truth.correct(predicted)
        measured[f"accuracy_{name}"] = float(corrected.mean())
        measured[f"run_{name}"] = _mean(_runs(~corrected))
    return measured


def _standardised(scores: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows with mean 0 and population deviation 1; zeros where a row is constant."""
    centred = scores - scores.mean(axis=1, keepdims=True)
    deviation = scores.std(axis=1, keepdims=True)
    return np.asarray(
        np.divide(centred, deviation, out=np.zeros_like(centred), where=deviation > 0)
    )


def _runs(wrong: NDArray[np.bool_]) -> list[int]:
    """Lengths of the unbroken stretches of wrong frames."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]]).astype(np.int8)))
    return [int(length) for length in np.diff(edges)[::2]]


def _mean(lengths: list[int]) -> float:
    return float(np.mean(lengths)) if lengths else 0.0


def _lagged(z: NDArray[np.float64], truth: NDArray[np.bool_], frames: int, places: int) -> float:
    """Correlation of wrong places' z-scores with those some frames and places on."""
    queries, references = z.shape
    early = (slice(max(queries - frames, 0)), slice(max(references - places, 0)))
    late = (slice(frames, None), slice(places, None))
    both = ~truth[early] & ~truth[late]
    return _correlation(z[early][both], z[late][both])


def _halves(z: NDArray[np.float64]) -> float:
    """Correlation of the places' mean z-scores in the first and second half of the route."""
    middle = len(z) // 2
    if middle == 0:
        return float("nan")
    return _correlation(z[:middle].mean(axis=0), z[middle:].mean(axis=0))


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    if a.size < 3 or a.std() == 0 or b.std() == 0:
        return float("nan")
    return float(np.corrcoef(a, b)[0, 1])
