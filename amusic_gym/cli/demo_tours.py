"""The demo's tours: rendered worlds joined into drives, and what techniques make of them."""

from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, closing
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli.images import extract_tour
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.pictures.drive import Pictures
from amusic_gym.envs.task import RENDER_FPS
from amusic_gym.extraction import Cache, describe_map
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Selector
from amusic_gym.routes.motion import PACED
from amusic_gym.routes.retime import save_retimed
from amusic_gym.routes.tours import Tour, make_tour
from amusic_gym.routes.video import VideoWriter
from amusic_gym.techniques import make_technique
from amusic_gym.utils.names import file_stem
from amusic_gym.utils.storage import write_whole
from amusic_gym.worlds import Kind, render_folders

TECHNIQUES = ("hog", "calc", "netvlad", "cohog")
TOLERANCE = 1
PLACES = 100
TOURS = 3
WORKERS = 2
FIRST_WORLD = 4_000  # seed of the first world; what ships was trained on others

STOPS_SEED = 3
COMPUTE_WEIGHT = 0.3
INTO_SPELL = 20  # frames into a spell: the image of it that the contact sheet shows
OF_DRIVE = 60  # frame of the live drive that the page shows


class DemoWorld(NamedTuple):
    """A rendered world, and how it looks on the second drive through it."""

    kind: Kind
    condition: str


WORLDS = (
    DemoWorld("street", "shift"),
    DemoWorld("rail", "night+shift"),
    DemoWorld("corridor", "shift+crowd"),
)


def make_tours(out: Path, first: int, say: Callable[[str], None]) -> list[Tour]:
    """Tours, with seeds from ``first`` on, through worlds of their own, rendered to ``out/images``.

    What is there is kept; ``say`` is told what is done.
    """
    seeds = range(first, first + TOURS)
    jobs = [
        (out / "images" / f"{seed}" / world.kind, world, FIRST_WORLD + len(WORLDS) * seed + at)
        for seed in seeds
        for at, world in enumerate(WORLDS)
    ]
    with ProcessPoolExecutor(WORKERS, mp_context=get_context("spawn")) as pool:
        parts = []
        for part in pool.map(partial(render_world, PLACES), *zip(*jobs, strict=True)):
            say(f"rendered {part[0].parent.relative_to(out)}: the map, and a drive")
            parts.append(part)
    count = len(WORLDS)
    return [make_tour(parts[at * count :][:count], seed=seed) for at, seed in enumerate(seeds)]


def render_world(places: int, folder: Path, world: DemoWorld, seed: int) -> tuple[Path, Path]:
    """Folders of the images of a map and of a drive, rendered unless they are there."""
    cv2.setNumThreads(1)
    render_folders(folder, [world.condition], seed=seed, places=places, kind=world.kind)
    return folder / "reference", folder / world.condition


def banks_of(tours: Sequence[Tour], out: Path, say: Callable[[str], None]) -> list[ScoreBank]:
    """The scores of all techniques on every tour, kept in ``out/banks``."""
    banks = []
    with Cache(out / "cache") as cache:
        for tour in tours:
            name = f"tour-{tour.seed}"
            say(f"running {', '.join(TECHNIQUES)} on {name}")
            where = {"executor": f"process:{WORKERS}", "out": out / "banks" / name}
            banks.append(extract_tour(tour, TECHNIQUES, TOLERANCE, cache=cache, name=name, **where))
    return banks


def with_stops(bank: ScoreBank, out: Path) -> ScoreBank:
    """The bank of a tour as a robot records it that stops, and drives slower and faster."""
    name = f"{bank.name} with stops"
    whole = bank.with_costs(bank._given[0])
    path = save_retimed(whole, STOPS_SEED, out / "banks" / file_stem(name), PACED, name=name)
    return ScoreBank.load(path).with_costs(bank.costs)


def contact_sheet(tour: Tour, out: Path) -> Path:
    """A picture of one place of every spell: the map above, below what the robot sees."""
    frames = [min(spell.first + INTO_SPELL, len(tour.query) - 1) for spell in tour.spells]
    columns = [np.concatenate([tour.reference[i], tour.query[i]]) for i in frames]
    sheet = np.concatenate(columns, axis=1)
    small = cv2.resize(sheet, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA)
    return write_whole(out / "tour.jpg", cv2.imencode(".jpg", small)[1].tobytes())


def drive(out: Path, selector: Selector, tour: Tour, bank: ScoreBank) -> Path:
    """Let a selector drive live along a tour, filmed as ``out/drive.mp4``.

    The bank, of the same images, gives the costs and what is true. The picture of one frame is
    returned.
    """
    path = out / "drive.png"
    with ExitStack() as stack:
        cache = stack.enter_context(Cache(out / "cache"))
        maps = [
            stack.enter_context(
                closing(describe_map(tour.reference, make_technique(name), cache=cache))
            )
            for name in TECHNIQUES
        ]
        route = LiveRoute(
            maps,
            tour.query,
            tolerance=TOLERANCE,
            seconds=bank.seconds,
            costs=bank.costs,
            name=bank.name,
            places=tour.reference,
            ground_truth=bank.truth,
        )
        video = stack.enter_context(VideoWriter(out / "drive.mp4", RENDER_FPS))
        pictures = Pictures(route, f"{bank.name}, selector")
        for result in navigate(selector, route, compute_weight=COMPUTE_WEIGHT):
            picture = pictures.draw(result)
            video.write(picture)
            if result.frame == OF_DRIVE:
                write_whole(path, cv2.imencode(".png", picture[:, :, ::-1])[1].tobytes())
    return path
