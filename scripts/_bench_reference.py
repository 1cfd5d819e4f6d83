"""What the bench compares with and checks against: SIC and MuSIC as NumPy writes them.

Independent of the package: nothing of it is imported here.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]
Ints = NDArray[np.integer]


def gather(z: Floats, frame: int, top: Ints, history: int) -> Floats:
    """SIC's statistics (K,) at a frame: gather all K×F z-scores of the diagonals and sum them.

    `z` (Q, R) are standardised scores of a technique that ran on every frame, `top` (K,) the
    candidates. Indices into the flattened rows gather faster than pairs of indices.
    """
    ages = np.arange(min(history, frame) + 1)
    on_map = top[:, None] >= ages  # (K, F)
    flat = (frame * z.shape[1] + top)[:, None] - ages * (z.shape[1] + 1)
    terms = np.where(on_map, z.ravel().take(flat, mode="wrap"), 0.0)
    statistics: Floats = terms.sum(axis=1) / np.sqrt(on_map.sum(axis=1))
    return statistics


def gather_runs(z: Floats, ran: NDArray[np.bool_], frame: int, top: Ints, history: int) -> Floats:
    """As :func:`gather`, of a technique that ran on some frames (Q,) only, this one among them."""
    ages = np.arange(min(history, frame) + 1)
    counts = (top[:, None] >= ages) & ran[frame - ages]
    terms = np.where(counts, z[frame - ages, np.maximum(top[:, None] - ages, 0)], 0.0)
    statistics: Floats = terms.sum(axis=1) / np.sqrt(counts.sum(axis=1))
    return statistics


def gather_one_by_one(z: Floats, frame: int, top: Ints, history: int) -> list[float]:
    """The same by a loop over the K candidates: one diagonal after the other."""
    found = []
    for place in top:
        ages = np.arange(min(history, frame, int(place)) + 1)
        found.append(float(z[frame - ages, place - ages].sum() / math.sqrt(len(ages))))
    return found


def standardised(rows: NDArray[np.float32]) -> NDArray[np.float64]:
    """Rows (Q, R) less their mean, over their population σ."""
    wide = rows.astype(np.float64)
    z: NDArray[np.float64] = (wide - wide.mean(axis=1, keepdims=True)) / wide.std(
        axis=1, keepdims=True
    )
    return z


def ranked(rows: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """The best places (Q, K) of each row, ties to the lower index."""
    order: NDArray[np.int64] = np.argsort(-rows, axis=1, kind="stable")[:, :count]
    return order


def summed(z: Floats) -> Floats:
    """Sums (Q + 1, R + 1) along the diagonals of `z` (Q, R) from where they begin.

    Entry (q, c) is over the scores before query q and place c.
    """
    sums = np.zeros((z.shape[0] + 1, z.shape[1] + 1))
    for query, row in enumerate(z):
        sums[query + 1, 1:] = sums[query, :-1] + row
    return sums


def predicted(
    sums: Sequence[Floats], top: Sequence[Ints], start: int, frames: int, history: int
) -> tuple[Ints, Ints]:
    """MuSIC's places and techniques, (Q,) each, on a route from query ``start``; all run.

    By differences of the sums along the diagonals, because :func:`gather` would take minutes.
    """
    ages = np.minimum(history, np.arange(frames))[:, None]
    queries = start + np.arange(frames)[:, None]
    values = []
    for technique, ranked_places in enumerate(top):
        places = ranked_places[start : start + frames]  # (Q, K)
        terms = np.minimum(ages, places) + 1
        ends = sums[technique][queries + 1, places + 1]
        values.append(
            (ends - sums[technique][queries + 1 - terms, places + 1 - terms]) / np.sqrt(terms)
        )
    both = np.concatenate(values, axis=1)
    candidates = np.concatenate([places[start : start + frames] for places in top], axis=1)
    best = both.argmax(axis=1)
    found: Ints = candidates[np.arange(frames), best]
    return found, best // top[0].shape[1]


def track_of(places: Ints) -> int:
    """Number of frames in a row, up to the last, on which the place moved on by one."""
    breaks = np.flatnonzero(np.diff(places) != 1)
    return len(places) - 1 - (int(breaks[-1]) + 1 if len(breaks) else 0)


def recent_of(similarities: Floats) -> float:
    """Running mean of the similarity up to the last frame, of which the newest weighs a tenth."""
    mean = 0.0
    for similarity in similarities:
        mean += 0.1 * (float(similarity) - mean)
    return mean


class Expected(NamedTuple):
    """What the environment must say of one route's frame on which everything ran."""

    prediction: int
    confidence: float
    technique: int
    p_correct: float


def expected(
    z: Sequence[Floats],
    top: Sequence[Ints],
    start: int,
    frame: int,
    *,
    history: int,
    tolerance: int,
    track: int,
    recent: float,
    calibration: Floats,
) -> Expected:
    """MuSIC with all techniques on ``frame`` of a route that begins at query ``start``.

    ``z`` and ``top`` hold one array per technique, see :func:`gather`; ``track`` is that of the
    frame, see :func:`track_of`, and ``recent`` see :func:`recent_of`; ``calibration`` are the
    coefficients of p̂ for `evidence` where the winner has a rival.
    """
    places = [places[start + frame] for places in top]
    values = [
        gather(rows[start:], frame, chosen, history) for rows, chosen in zip(z, places, strict=True)
    ]
    technique = int(np.argmax([v.max() for v in values]))
    own = np.array([int(p[np.argmax(v)]) for p, v in zip(places, values, strict=True)])
    place = int(own[technique])
    confidence = float(values[technique].max())
    far = np.abs(np.stack(places) - place) > tolerance
    margin = confidence - float(np.stack(values)[far].max())
    rows = np.stack([rows[start + frame] for rows in z])  # (T, R)
    weights = 1.0 - np.clip(rows @ rows[technique] / rows.shape[1], 0.0, 1.0)
    weights[technique] = 0.0
    support = np.where(np.abs(own - place) <= tolerance, weights, 0.0).max()
    inputs = [1.0, math.asinh(confidence), math.log1p(track), weights.max(), support]
    logits = [
        float(np.dot(calibration[:6], [*inputs, math.asinh(margin)])),
        float(np.dot(calibration[6:], [1.0, math.asinh(recent)])),
    ]
    p_correct = math.prod(1.0 / (1.0 + math.exp(-logit)) for logit in logits)
    return Expected(place, confidence, technique, p_correct)


COHOG_CELLS, COHOG_BINS = 32, 8
COHOG_OPERATIONS = 2.0 * COHOG_CELLS**4 * COHOG_BINS
"""Multiplications and additions of all pairs of cells: what our matching cannot do without."""


def cohog_regions(descriptor: NDArray[np.float32]) -> NDArray[np.float32]:
    """(961, 32) regions of a CoHOG descriptor, each of length 1; zeros where its weight is 0."""
    cells = descriptor[:, :COHOG_BINS].transpose(0, 2, 1)  # (row, column, bin)
    corners = [cells[i : i + 31, j : j + 31] for i in (0, 1) for j in (0, 1)]
    regions = np.concatenate(corners, axis=2).reshape(961, 32)
    regions = regions * (descriptor[:31, COHOG_BINS, :31].reshape(961, 1) > 0)
    lengths = np.linalg.norm(regions, axis=1, keepdims=True)
    return np.asarray(regions / np.where(lengths > 0, lengths, 1), np.float32)


def match_regions(interest: NDArray[np.float32], place: NDArray[np.float32]) -> float:
    """CoHOG's score: mean over the regions of interest of the best dot product with any region."""
    return float((interest @ place.T).max(axis=1).mean())
