"""Pictures of a drive along a live route, sighting by sighting."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.pictures.scene import Scene, Trail

if TYPE_CHECKING:
    from amusic_gym.envs.live_route import LiveRoute
    from amusic_gym.live.navigation import Sighting


class Pictures:
    """Draws one sighting after the other, with the trail of those before.

    Args:
        route: the route that is driven. Whether a place is right is shown where it knows its
            ground truth, and the matched image where it has those of the map.
        title: what stands above.
    """

    def __init__(self, route: LiveRoute, title: str) -> None:
        self.route = route
        self.title = title
        self.trail = Trail()

    def draw(self, sighting: Sighting) -> NDArray[np.uint8]:
        """The picture of the next sighting, (540, 960, 3) uint8 red-green-blue."""
        from amusic_gym.envs.pictures.layout import draw

        return draw(self.scene(sighting))

    def scene(self, sighting: Sighting) -> Scene:
        """What the picture of the next sighting shows."""
        route, place = self.route, sighting.prediction
        runs = sighting.ran + sighting.late_runs
        only_trusted = np.full(len(route.techniques), -1)
        if sighting.technique >= 0:
            only_trusted[sighting.technique] = place
        self.trail.add(
            prediction=place,
            trusted=sighting.technique,
            ran=sighting.ran,
            places=only_trusted,  # a sighting does not know the others' places
            compute=float(runs @ route.seconds / route.seconds.sum()),
            correct=self._correct(sighting),
        )
        return Scene(
            title=self.title,
            techniques=route.techniques,
            references=route.references,
            frames=route.frames.length,
            trail=self.trail,
            confidence=sighting.confidence,
            p_correct=sighting.p_correct,
            milliseconds=sighting.run_milliseconds,
            query=sighting.image,
            place=route.places[place] if route.places is not None and place >= 0 else None,
        )

    def _correct(self, sighting: Sighting) -> bool | None:
        if self.route.truth is None:
            return None
        return bool(self.route.truth.correct([sighting.prediction], [sighting.frame])[0])
