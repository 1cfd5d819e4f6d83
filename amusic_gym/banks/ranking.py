"""Ranked lists of places: of a score row, and of all that a policy knew on a frame.

A policy gives one place per frame, SIC too: it corrects a few candidates, not the whole map. Its
ranked list is therefore made afterwards, the same way for every policy: first the place that it
gave, as re-ranking does, then all other places by the mean z-score (A-MuSIC, III-B) in the rows of
the techniques that ran on the frame. For one technique without correction that is its row's own
ranking.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from amusic_gym.banks.bank import ScoreBank

TOP = 20  # places of a ranked list, unless another number is asked for

_weights: WeakKeyDictionary[ScoreBank, NDArray[np.float64]] = WeakKeyDictionary()
"""(T, Q) 1/σ of each row over its candidates, 0 for a constant one."""


def highest(row: NDArray[np.floating[Any]], count: int) -> NDArray[np.int64]:
    """(n,) places of the highest scores of a row (R,), the best first, ties to the lower place.

    n is ``count``, or the number of candidates where these are fewer: a place of −∞ is none.
    """
    if count < len(row):
        least = np.partition(row, len(row) - count)[len(row) - count]
        places = np.flatnonzero((row >= least) & (row > -np.inf))
    else:
        places = np.flatnonzero(row > -np.inf)
    order = np.argsort(-row[places], kind="stable")[:count]
    return places[order]


def ranked(
    bank: ScoreBank, frame: int, ran: NDArray[np.bool_], prediction: int, count: int = TOP
) -> NDArray[np.int64]:
    """The ranked list of a frame, (n,) places, n ≤ ``count``.

    ``ran`` (T,) says which techniques ran; where none did, the prediction is the whole list. It is
    −1 where the policy gave none.
    """
    first = np.array([prediction] if prediction >= 0 else [], np.int64)
    rest = highest(_fused(bank, frame, ran), count) if ran.any() else first
    return np.concatenate([first, rest[rest != prediction]])[:count]


def true_ranks(
    bank: ScoreBank, predictions: NDArray[np.int64], ran: NDArray[np.bool_]
) -> NDArray[np.int64]:
    """Rank of the first true place in the list of each frame, (Q,), from 1; 0: not in it.

    ``predictions`` (Q,) are places, −1 for none; ``ran`` is (Q, T).
    """
    ranks = bank.truth.correct(predictions).astype(np.int64)
    asked = (ranks == 0) & bank.truth.has_place & ran.any(axis=1)
    for frame in np.flatnonzero(asked).tolist():
        scores, given = _fused(bank, frame, ran[frame]), predictions[frame]
        true = bank.truth.of(frame)
        best = true[scores[true].argmax()]  # the first of them
        if scores[best] == -np.inf:
            continue
        ahead = scores > scores[best]
        ahead[:best] |= scores[:best] == scores[best]
        if given >= 0:
            ahead[given] = True
        ranks[frame] = 1 + ahead.sum()
    return ranks


def _fused(bank: ScoreBank, frame: int, ran: NDArray[np.bool_]) -> NDArray[np.floating[Any]]:
    """(R,) what ranks as the mean z-score over the rows that ran does; −∞ where one has that."""
    techniques = np.flatnonzero(ran).tolist()
    if len(techniques) == 1:
        return bank.row(techniques[0], frame)
    fused = np.zeros(bank.references)
    for technique in techniques:
        row = bank.row(technique, frame).astype(np.float64)
        weight = _weight(bank, technique, frame)
        fused += weight * row if weight else np.where(row == -np.inf, row, 0.0)
    return fused


def _weight(bank: ScoreBank, technique: int, frame: int) -> float:
    """1/σ of a row over its candidates, 0 for a constant one; computed once."""
    if bank not in _weights:
        _weights[bank] = np.full(bank.shape[:2], np.nan)
    known = _weights[bank]
    if np.isnan(known[technique, frame]):
        row = bank.row(technique, frame)
        held = row[row > -np.inf]
        even = held.size == 0 or held.min() == held.max()
        known[technique, frame] = 0.0 if even else 1.0 / held.std(dtype=np.float64)
    return float(known[technique, frame])
