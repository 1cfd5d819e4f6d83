"""Answers of a drive as plain data that other programs read."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.live.drives import FrameResult
from amusic_gym.routes.positions import Positions


@dataclass(frozen=True)
class Answers:
    """Makes an answer of each frame.

    Attributes:
        names: (R,) of the places' images, None where they have none.
        positions: of the R places, None where they are not known.
        min_p: estimated correctness from which a place is known; None: nobody asks.
    """

    names: Sequence[str] | None = None
    positions: Positions | None = None
    min_p: float | None = None

    @cached_property
    def _where(self) -> NDArray[np.float64]:
        assert self.positions is not None
        return self.positions.coordinates()

    def known(self, seen: FrameResult) -> bool | None:
        """Whether the place is; None where that cannot be told."""
        if self.min_p is None or seen.p_correct is None:
            return None
        return seen.prediction >= 0 and seen.p_correct >= self.min_p

    def of(self, seen: FrameResult, right: bool | None = None) -> dict[str, Any]:
        """A frame's answer, of JSON's types only.

        ``place``, ``name``, ``position`` ([latitude, longitude] in degrees, or metres as the map
        has them) and ``heading`` (degrees) are None where there is no place or they are not known;
        ``milliseconds`` is without those to read the image, ``run_milliseconds`` of what ran.

        Args:
            seen: the frame.
            right: whether the place is right, where that is known.
        """
        place = seen.prediction if seen.prediction >= 0 else None
        position = heading = None
        if place is not None and self.positions is not None:
            position = [_plain(value) for value in self._where[place]]
            if self.positions.headings is not None:
                heading = _plain(self.positions.headings[place])
        costs = zip(seen.techniques, seen.run_milliseconds, strict=True)
        return {
            "frame": seen.frame,
            "place": place,
            "name": None if place is None or self.names is None else self.names[place],
            "position": position,
            "heading": heading,
            "p_correct": _plain(seen.p_correct),
            "known": self.known(seen),
            "right": right,
            "confidence": _plain(seen.confidence),
            "active": list(seen.active),
            "late_runs": int(seen.late_runs.sum()),
            "compute_weight": _plain(seen.compute_weight),
            "milliseconds": _plain(seen.milliseconds),
            "read_milliseconds": _plain(seen.read_milliseconds),
            "run_milliseconds": {name: _plain(ms) for name, ms in costs if ms > 0},
        }


def line(answer: dict[str, Any]) -> str:
    """An answer as one line of JSON."""
    return json.dumps(answer, allow_nan=False)


def _plain(value: float | None) -> float | None:
    """A number that JSON has."""
    return None if value is None or not math.isfinite(value) else round(float(value), 6)
