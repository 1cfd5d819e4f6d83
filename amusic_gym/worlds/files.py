"""Rendered traverses as folders of images that grow safely and can be finished later."""

import json
import os
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import cv2

from amusic_gym.utils import reading, storage
from amusic_gym.utils.checks import whole
from amusic_gym.worlds.conditions import REFERENCE, look_at
from amusic_gym.worlds.film import Image
from amusic_gym.worlds.views import SIZE, check_places, check_size, render
from amusic_gym.worlds.world import SPACING, Kind, World

QUALITY = 92  # of JPEG files: recordings have their artefacts too, and a place takes about 35 kB
SETTINGS = "render.json"
VERSION = 1  # raised when the same settings begin to give other pictures


@dataclass(frozen=True)
class Settings:
    """What the images of a folder were drawn from; all but ``places`` must agree to go on."""

    version: int
    opencv: str
    seed: int
    kind: str
    condition: str
    run: int
    columns: int
    rows: int
    places: int


def render_folders(
    out: Path,
    conditions: Sequence[str],
    *,
    seed: int,
    places: int,
    size: tuple[int, int] = SIZE,
    progress: Callable[[int, int], None] | None = None,
    kind: Kind | None = None,
) -> None:
    """Write the map and one query traverse per condition, as folders of JPEG files.

    ``out/reference`` is the map; ``out/CONDITION`` the same places under a condition, as another
    drive saw them. Equal file names are the same place: ground truth is 1:1. Every image appears
    whole or not at all; a run that was interrupted is finished by the next, which keeps what is
    there.

    Args:
        out: folder of the folders; made if missing.
        conditions: names as `conditions.look_at` takes them.
        seed: of the world.
        places: of the route.
        size: (columns, rows).
        progress: called with (images done, images in all) after each image.
        kind: of the world; None lets the seed choose.

    Raises:
        ValueError: for a bad argument, or a folder that holds other images.
        OSError: when writing fails; whole images stay.
    """
    world = World(seed, kind)
    places, (columns, rows) = check_places(places), check_size(size)
    if isinstance(conditions, str):
        raise ValueError(f"conditions is {conditions!r}; give a list of names, as [{conditions!r}]")
    for condition in conditions:
        look_at(condition, world.seed, 0, 0.0)
    drives = [("reference", REFERENCE, 0)]
    drives += [(condition, condition, run_of(condition)) for condition in dict.fromkeys(conditions)]
    drawn = (VERSION, cv2.__version__, world.seed, world.kind)
    jobs = [
        (Path(out) / name, Settings(*drawn, condition, run, columns, rows, places))
        for name, condition, run in drives
    ]
    for folder, settings in jobs:  # all refusals before the first image
        _refuse_others(folder, settings)
    done = 0
    for folder, settings in jobs:
        for _ in _write(folder, settings, world):
            done += 1
            if progress is not None:
                progress(done, places * len(jobs))


def run_of(condition: str) -> int:
    """Number of the drive that a condition's folder shows: another for each condition."""
    return 1 + zlib.crc32(condition.encode()) % 65_536


def _write(folder: Path, settings: Settings, world: World) -> Iterator[Path]:
    """Draw what the folder lacks; yields each image's path once it is there."""
    step = SPACING[world.kind]
    digits = max(4, len(str(settings.places - 1)))
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with storage.locked(folder):  # another writer waits, then finds the images there
            _refuse_others(folder, settings)
            text = json.dumps(asdict(settings), indent=1) + "\n"
            _place(folder / SETTINGS, text.encode())
            for place in range(settings.places):
                path = folder / f"{place:0{digits}d}.jpg"
                if not is_whole(path):
                    size, run = (settings.columns, settings.rows), settings.run
                    image = render(world, step * place, settings.condition, size=size, run=run)
                    _place(path, encode(image))
                yield path
    except OSError as error:
        raise OSError(
            f"writing {folder} failed ({error.strerror or error}); the images already there are "
            "whole: free some space or choose another folder, and run again"
        ) from error


def encode(image: Image) -> bytes:
    """An image as the bytes of a JPEG file."""
    good, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not good:
        raise ValueError(f"OpenCV cannot encode an image of shape {image.shape} as JPEG")
    return data.tobytes()


def is_whole(path: Path) -> bool:
    """Whether a JPEG file is there and has its end."""
    try:
        with path.open("rb") as file:
            if file.seek(0, os.SEEK_END) < 4:
                return False
            file.seek(-2, os.SEEK_END)
            return file.read() == b"\xff\xd9"
    except FileNotFoundError:
        return False


def _place(path: Path, data: bytes) -> None:
    """Write a file that takes its name only when all of it is on the disk."""
    with storage.replacing_file(path) as temporary, temporary.open("wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())


def _refuse_others(folder: Path, settings: Settings) -> None:
    """Never mix images: go on only in an empty folder or one of the same settings."""
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; choose another folder")
    found = [entry.name for entry in folder.iterdir() if not storage.is_unfinished(entry)]
    if not found:
        return
    if SETTINGS not in found:
        raise ValueError(
            f"{folder} holds other files ({min(found)}) and no {SETTINGS}; choose another folder"
        )
    try:
        before = Settings(**reading.read_json(folder / SETTINGS, "render it again"))
        earlier = whole("places", before.places, 1)
    except (ValueError, TypeError):
        raise ValueError(
            f"{folder / SETTINGS} is damaged; remove {folder} and render it again"
        ) from None
    wanted = asdict(settings)
    for name, value in asdict(before).items():
        if name != "places" and value != wanted[name]:
            raise ValueError(
                f"{folder} was rendered with {name} {value!r}, not {wanted[name]!r}; "
                "choose another folder or remove it"
            )
    if earlier > settings.places:
        raise ValueError(
            f"{folder} was rendered with {earlier} places, more than {settings.places}; "
            "ask for as many or choose another folder"
        )
    if max(4, len(str(earlier - 1))) != max(4, len(str(settings.places - 1))):
        raise ValueError(
            f"{folder} was rendered with {earlier} places and has shorter file names than "
            f"{settings.places} need; choose another folder"
        )
