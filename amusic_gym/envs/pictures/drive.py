"""Pictures of a drive along a live route, frame by frame."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.pictures.scene import Scene, Trail

if TYPE_CHECKING:
    from amusic_gym.envs.live_route import LiveRoute
    from amusic_gym.live.drives import FrameResult


class Pictures:
    """Draws one frame after the other, with the trail of those before.

    Args:
        route: the route that is driven. Whether a place is right is shown where it knows its
            ground truth, and the matched image where it has those of the map.
        title: what stands above.
    """

    def __init__(self, route: LiveRoute, title: str) -> None:
        self.route = route
        self.title = title
        self.trail = Trail()

    def draw(self, result: FrameResult) -> NDArray[np.uint8]:
        """The picture of the next frame, (540, 960, 3) uint8 red-green-blue."""
        from amusic_gym.envs.pictures.layout import draw

        return draw(self.scene(result))

    def scene(self, result: FrameResult) -> Scene:
        """What the picture of the next frame shows."""
        route, place = self.route, result.prediction
        runs = result.ran + result.late_runs
        only_trusted = np.full(len(route.techniques), -1)
        if result.technique >= 0:
            only_trusted[result.technique] = place
        self.trail.add(
            prediction=place,
            trusted=result.technique,
            ran=result.ran,
            places=only_trusted,  # a result does not know the others' places
            compute=float(runs @ route.seconds / route.seconds.sum()),
            correct=self._correct(result),
        )
        return Scene(
            title=self.title,
            techniques=route.techniques,
            references=route.references,
            frames=route.frames.length,
            trail=self.trail,
            confidence=result.confidence,
            p_correct=result.p_correct,
            milliseconds=result.run_milliseconds,
            query=result.image,
            place=route.places[place] if route.places is not None and place >= 0 else None,
        )

    def _correct(self, result: FrameResult) -> bool | None:
        if self.route.truth is None:
            return None
        return bool(self.route.truth.correct([result.prediction], [result.frame])[0])
