"""Self-Identification and Correction of one technique (A-MuSIC, III-A), frame by frame."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.rows import RowBuffer
from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic.sums import discount_of
from amusic_gym.estimation.sic.update import SICEstimator, correct_one, count_frame


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
        self._buffer = RowBuffer.empty(64, references, self.settings.candidates)
        sizes = {"routes": 1, "slots": 1, "block": 0, "frames": 64, "references": references}
        sizes["candidates"] = min(self.settings.candidates, references)
        self._batch = Batch(sizes, block=0)
        self._sic = SICEstimator(self.settings, block=0)
        self._sic.allocate(self._batch, sizes)
        self._sic.begin(0, references)
        self._last = -1  # the last match, moved on; -1 before the first and off the map

    def skip(self) -> None:
        """Let a frame pass on which the technique does not run."""
        self._advance(ran=False)

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
        frame = self._advance(ran=True)
        self._buffer.put(frame, scores)
        winner = correct_one(self._sic.address, frame, self._last, fused)
        values = self._sic.state.values[0]
        self._last = int(self._sic.state.candidates[0, winner])
        return Match(self._last, float(values[winner]), float(values[winner] - values[0]))

    def preview(self, row: ArrayLike, fused: int = -1) -> Match:
        """What :meth:`correct` would return for the next frame, without taking it."""
        state = self._sic.state
        sums, marks, last = state.sums.copy(), state.marks.copy(), self._last
        match = self.correct(row, fused)
        self._batch.ran[0, 0, self.frame] = False
        self.frame -= 1
        state, self._last = self._sic.state, last
        state.sums[:], state.marks[:] = sums, marks
        return match

    @property
    def discount(self) -> float:
        """What MuSIC multiplies the statistic by, for the serial correlation of the rows so far."""
        python: Any = discount_of  # an inner function has no way in, but its source
        return float(python.py_func(self._sic.state.marks[0, 0].view(np.recarray)[0]))

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

    def _advance(self, *, ran: bool) -> int:
        """Begin the next frame, with more room where it is used up."""
        self.frame += 1
        self._last += self._last >= 0
        room = len(self._buffer.rows)
        if self.frame >= room:
            self._buffer = self._buffer.grown(2 * room)
            sizes = {**self._sic.state.sizes, "frames": 2 * room}
            self._batch = self._batch.grown(sizes)
            self._sic.allocate(self._batch, sizes)
        self._buffer.point(self._batch.runs[0])
        self._batch.ran[0, 0, self.frame] = ran
        count_frame(self._sic.address, self.frame)
        return self.frame
