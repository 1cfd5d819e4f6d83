"""The demo's live drive: the trained selector on the images of a tour."""

from __future__ import annotations

from contextlib import ExitStack, closing
from pathlib import Path

import _demo_tours as rendered
import cv2

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.pictures.sightings import Pictures
from amusic_gym.envs.task import RENDER_FPS
from amusic_gym.extraction import Cache, describe_map
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Selector
from amusic_gym.routes.tours import Tour
from amusic_gym.routes.video import VideoWriter
from amusic_gym.techniques import make_technique
from amusic_gym.utils.storage import write_whole

COMPUTE_WEIGHT = 0.3
SHOWN = 60
"""Frame of the drive that the page shows."""


def drive(out: Path, selector: Selector, tour: Tour, bank: ScoreBank) -> Path:
    """Let the selector drive along a tour, and film what it sees.

    Args:
        out: the demo's folder.
        selector: the trained one.
        tour: the route.
        bank: of the same images; gives the costs and what is true.

    Returns:
        The picture of one frame; beside it is the video, ``drive.mp4``.
    """
    with ExitStack() as stack:
        cache = stack.enter_context(Cache(out / "cache"))
        maps = [
            stack.enter_context(
                closing(describe_map(tour.reference, make_technique(name), cache=cache))
            )
            for name in rendered.TECHNIQUES
        ]
        route = LiveRoute(
            maps,
            tour.query,
            tolerance=rendered.TOLERANCE,
            seconds=bank.seconds,
            costs=bank.costs,
            name=bank.name,
            places=tour.reference,
            ground_truth=bank.truth,
        )
        video = stack.enter_context(closing(VideoWriter(out / "drive.mp4", RENDER_FPS)))
        pictures = Pictures(route, f"{bank.name}, learned selector")
        path = out / "drive.png"
        for sighting in navigate(selector, route, compute_weight=COMPUTE_WEIGHT):
            picture = pictures.draw(sighting)
            video.write(picture)
            if sighting.frame == SHOWN:
                write_whole(path, cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes())
    return path
