"""The pictures of an environment: keeps each route's trail, draws when asked, feeds the window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.envs.live_route import ENDLESS
from amusic_gym.envs.pictures.scene import Scene, Trail
from amusic_gym.envs.window import Window

if TYPE_CHECKING:
    from amusic_gym.envs.episode import Episodes
    from amusic_gym.envs.memory import Route

PICTURE_MODES = ("rgb_array", "rgb_array_list", "human")
"""Render modes that make pictures."""

MOST_SHOWN = 9
"""Routes in one window; more could not be read."""


def viewer_for(episodes: Episodes, mode: str | None, fps: float) -> Viewer | None:
    """A viewer for the render modes that make pictures; None for the others."""
    return Viewer(episodes, mode, fps) if mode in PICTURE_MODES else None


class Viewer:
    """Looks at a batch of N routes after every reset and step.

    It sees what the infos say and never the ground truth.

    Args:
        episodes: the batch.
        mode: one of ``PICTURE_MODES``; ``"human"`` shows every look in a window,
            ``"rgb_array_list"`` keeps a picture of each.
        fps: the most looks per second in the window.

    Raises:
        ImportError: for a window without pygame.
    """

    def __init__(self, episodes: Episodes, mode: str, fps: float) -> None:
        self.episodes = episodes
        self.window = Window("amusic-gym", fps) if mode == "human" else None
        self.mode = mode
        self.trails = [Trail() for _ in range(episodes.num_routes)]
        self._kept: list[list[NDArray[np.uint8]]] = [[] for _ in self.trails]

    def look(self) -> None:
        """Remember what happened on each route since the last look, and show it in the window."""
        for i, record in enumerate(self.episodes.state.routes):
            frame = int(record["frame"])
            if frame < 0:
                self.trails[i], self._kept[i] = Trail(), []
            elif frame == len(self.trails[i]):
                self._remember(i, record)
            else:
                continue
            if self.mode == "rgb_array_list":
                self._kept[i].append(self._picture(i))
        if self.window is not None:
            from amusic_gym.envs.pictures.layout import tile

            self.window.show(tile(self.pictures(MOST_SHOWN)))

    def _remember(self, i: int, record: Any) -> None:
        slots = self.episodes.state.slots[i]
        slots = slots[slots["present"].astype(np.bool_)]
        chosen = np.flatnonzero(slots["chosen"])
        self.trails[i].add(
            prediction=record["prediction"],
            trusted=chosen[0] if chosen.size else -1,
            ran=slots["ran"].astype(np.bool_),
            places=slots["place"],
            compute=record["compute"],
        )

    def pictures(self, most: int | None = None) -> tuple[NDArray[np.uint8], ...]:
        """N pictures, (540, 960, 3) uint8 red-green-blue each; of the first ``most`` routes."""
        return tuple(self._picture(i) for i in range(len(self.trails[:most])))

    def shown(self) -> tuple[Any, ...] | None:
        """For every route its picture, or those since it was asked last; None for a window."""
        if self.mode == "rgb_array":
            return self.pictures()
        if self.mode == "human":
            return None
        shown, self._kept = tuple(self._kept), [[] for _ in self.trails]
        return shown

    def _picture(self, i: int) -> NDArray[np.uint8]:
        from amusic_gym.envs.pictures.layout import draw, notice

        route = self.episodes.routes[i]
        if route is None:
            return notice("no route yet; call reset first")
        return draw(self._scene(i, route))

    def _scene(self, i: int, route: Route) -> Scene:
        record, trail, bank = self.episodes.state.routes[i], self.trails[i], route.bank
        columns = route.columns[route.columns >= 0]
        known = int(record["frames"])
        facts: dict[str, Any] = {
            "title": f"{bank.name}, compute weight {route.compute_weight:.3g}",
            "techniques": tuple(bank.techniques[t] for t in columns),
            "references": bank.references,
            "frames": known if known < ENDLESS else None,
            "trail": trail,
            "confidence": float(record["confidence"]),
            "p_correct": float(record["p_correct"]),
        }
        drive, frame = self.episodes.drives[i], len(trail) - 1
        if frame < 0:
            return Scene(**facts)
        ran = [(t, int(columns[t])) for t, on in enumerate(trail.ran[-1]) if on]
        if drive is None:
            rows = {t: bank.row(column, route.start + frame) for t, column in ran}  # type: ignore[union-attr]
            return Scene(**facts, rows=rows)
        place, places = trail.predictions[-1], drive.route.places
        return Scene(
            **facts,
            rows={t: drive.run(column, frame) for t, column in ran},
            milliseconds=drive.milliseconds[columns],
            query=drive.image(),
            place=places[place] if places is not None and place >= 0 else None,
        )

    def close(self) -> None:
        """Close the window, if there is one; twice is fine."""
        if self.window is not None:
            self.window.close()
