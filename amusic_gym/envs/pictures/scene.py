"""What a picture shows, without a word on how it is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass
class Trail:
    """What happened on the frames so far, n of them: the route's strip is drawn from it.

    Attributes:
        predictions: n places, −1 where there was none.
        trusted: n indices of the technique that MuSIC trusted, −1: none.
        ran: n tuples of T flags, which techniques ran.
        places: n tuples of T corrected matches; they count where ``ran``.
        compute: n shares: seconds of the frame / Σ seconds of all techniques.
        correct: n flags, None where the truth is not given.
    """

    predictions: list[int] = field(default_factory=list)
    trusted: list[int] = field(default_factory=list)
    ran: list[tuple[bool, ...]] = field(default_factory=list)
    places: list[tuple[int, ...]] = field(default_factory=list)
    compute: list[float] = field(default_factory=list)
    correct: list[bool | None] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.predictions)

    def add(
        self,
        prediction: int,
        trusted: int,
        ran: Sequence[bool] | NDArray[np.bool_],
        places: Sequence[int] | NDArray[np.int64],
        compute: float,
        correct: bool | None = None,
    ) -> None:
        """Remember one more frame."""
        self.predictions.append(int(prediction))
        self.trusted.append(int(trusted))
        self.ran.append(tuple(bool(flag) for flag in ran))
        self.places.append(tuple(int(place) for place in places))
        self.compute.append(float(compute))
        self.correct.append(None if correct is None else bool(correct))


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One frame of one route.

    Attributes:
        title: which route, which policy.
        techniques: (T,) names.
        references: R, places of the map.
        frames: Q, frames of the route; None where nobody knows.
        trail: the frames so far, this one last; empty before the first.
        confidence: SIC statistic of the fused match.
        p_correct: p̂ in [0, 1]; None for policies that give none.
        milliseconds: (T,) measured time of each technique on this frame, 0 where it did not run;
            None where nothing was measured.
        query: (H, W, 3) uint8 BGR, what the camera sees; None without images.
        place: (H, W, 3) uint8 BGR, the map's image of the matched place.
        rows: technique → its score row (R,), of those that ran; drawn where images are missing.
    """

    title: str
    techniques: tuple[str, ...]
    references: int
    frames: int | None
    trail: Trail
    confidence: float = 0.0
    p_correct: float | None = None
    milliseconds: NDArray[np.float64] | None = None
    query: NDArray[np.uint8] | None = None
    place: NDArray[np.uint8] | None = None
    rows: Mapping[int, NDArray[Any]] = field(default_factory=dict)

    @property
    def frame(self) -> int:
        """Index of the frame, −1 before the first."""
        return len(self.trail) - 1

    @property
    def prediction(self) -> int:
        """The place, −1 for none."""
        return self.trail.predictions[-1] if len(self.trail) else -1

    @property
    def trusted(self) -> int:
        """Index of the technique that MuSIC trusts, −1 for none."""
        return self.trail.trusted[-1] if len(self.trail) else -1

    @property
    def ran(self) -> tuple[bool, ...]:
        """(T,) which techniques ran on this frame."""
        return self.trail.ran[-1] if len(self.trail) else (False,) * len(self.techniques)

    @property
    def compute(self) -> float:
        """Seconds of this frame / Σ seconds."""
        return self.trail.compute[-1] if len(self.trail) else 0.0

    @property
    def compute_mean(self) -> float:
        """The same, mean over the frames so far."""
        return float(np.mean(self.trail.compute)) if len(self.trail) else 0.0

    @property
    def correct(self) -> bool | None:
        """Whether the place is a true one; None where the truth is not given."""
        return self.trail.correct[-1] if len(self.trail) else None
