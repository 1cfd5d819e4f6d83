"""Positions of images from files: CSV, EXIF, the pose files of TUM and KITTI, and ROS bags."""

import csv
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.positions import (
    GEOGRAPHIC,
    LOCAL,
    PROJECTED,
    Positions,
    from_degrees,
    zone_of,
)
from amusic_gym.routes.ros_positions import is_bag, read_bag
from amusic_gym.routes.tracks import Track, heading_of, in_seconds, refuse_missing
from amusic_gym.utils import reading

EXIF = "exif"  # in place of a file: positions that the images' own EXIF data give

COLUMNS = {
    "name": "name file filename image path image_name",
    "number": "number frame index id frame_id",
    "seconds": "seconds time timestamp stamp t",
    "latitude": "latitude lat",
    "longitude": "longitude lon lng long",
    "easting": "easting east utm_east",
    "northing": "northing north utm_north",
    "x": "x tx",
    "y": "y ty",
    "z": "z tz",
    "zone": "zone utm_zone",
    "heading": "heading bearing azimuth compass course",
}
"""What a column of a table holds -> names for it, in upper or lower case."""

_PAIRS = {
    GEOGRAPHIC: ("latitude", "longitude"),
    PROJECTED: ("easting", "northing"),
    LOCAL: ("x", "y"),
}
_TUM, _KITTI = 8, 12  # numbers of a line
_MOST_BYTES = 2**30
_GPS, _LATITUDE, _LONGITUDE, _DIRECTION = 0x8825, 2, 4, 17  # tags of EXIF


def positions_of(source: str | os.PathLike[str], folder: ImageFolder) -> Positions:
    """Positions of a folder's images, from a file or, for ``"exif"``, from the images.

    Raises:
        FileNotFoundError: for a file that is not there.
        ValueError: for one that cannot be read, and for images without a position.
    """
    return _from_exif(folder) if os.fspath(source) == EXIF else read_track(source).of_images(folder)


def read_track(path: str | os.PathLike[str]) -> Track:
    """Positions of a text file, or of a ROS bag (:mod:`amusic_gym.routes.ros_positions`).

    A first line of names makes it a table (`COLUMNS`); lines of 8 numbers are TUM's poses (time,
    position, quaternion), of 12 numbers KITTI's (the upper three rows of a pose matrix). Those say
    nothing of names; their headings compare with those of poses of the same kind only.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for anything else, with the line.
    """
    if is_bag(path):
        return read_bag(path)
    path = Path(path)
    try:
        text = reading.read_regular(path, _MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ValueError(f"{path} is no text; give a table, or poses of TUM or KITTI") from None
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith("#")]
    if not lines:
        raise ValueError(f"{path} holds no position; give a line for each image")
    separator = next((each for each in ",;\t" if each in lines[0]), " ")
    split = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    rows = [[field.strip() for field in row] for row in split]
    header = _header(rows[0])
    return _from_table(path, header, rows[1:]) if header else _from_poses(path, rows)


def _header(row: Sequence[str]) -> dict[str, int]:
    """Column of each quantity; empty where the line holds numbers only."""
    names = [re.sub(r"[ -]", "_", name.strip("\"'").lower()) for name in row]
    found = {}
    for quantity, known in COLUMNS.items():
        columns = [at for at, name in enumerate(names) if name in known.split()]
        if columns:
            found[quantity] = columns[0]
    return found if any(re.search("[a-z]", name) for name in names) else {}


def _from_table(path: Path, header: Mapping[str, int], rows: Sequence[Sequence[str]]) -> Track:
    systems = [name for name, pair in _PAIRS.items() if set(pair) <= set(header)]
    if len(systems) != 1:
        told = f"gives {' as well as '.join(systems)}" if systems else "names no position"
        pairs = ", or ".join(" and ".join(pair) for pair in _PAIRS.values())
        raise ValueError(f"{path} {told}; give two columns named {pairs}")
    if not rows:
        raise ValueError(f"{path} holds no position; give a line for each image")
    for at, row in enumerate(rows, 2):
        if len(row) <= max(header.values()):
            raise ValueError(
                f"{path}, line {at}: {len(row)} columns, fewer than its first line has"
            )
    names = [row[header["name"]] for row in rows] if "name" in header else None
    if names is None and not {"number", "seconds"} & set(header):
        raise ValueError(
            f"{path} does not say which image a position is of; add a column 'name', 'frame' or"
            " 'time'"
        )
    (system,) = systems

    def column(quantity: str) -> NDArray[np.float64]:
        texts = [row[header[quantity]] for row in rows]
        return np.array([_number(path, at, text, quantity) for at, text in enumerate(texts, 2)])

    first, second = (column(quantity) for quantity in _PAIRS[system])
    if system == GEOGRAPHIC:
        _check_degrees(path, first, second)
        metres = from_degrees(first, second)
    else:
        third = [column("z")] if system == LOCAL and "z" in header else []
        metres = np.stack([first, second, *third], axis=1)
    headings = column("heading") if "heading" in header else None
    texts = {row[header["zone"]] for row in rows} if "zone" in header else set()
    zones = {zone_of(text[:-1].strip(), text[-1:]): str(path) for text in texts}
    positions = Positions(metres, system, headings, zones, str(path))
    numbers = column("number") if "number" in header else None
    seconds = in_seconds(column("seconds")) if "seconds" in header else None
    return Track(positions, names, numbers, seconds)


def _number(path: Path, line: int, text: str, what: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(
            f"{path}, line {line}: {what} {text!r} is no number; mend or drop the line"
        )
    return number


def _check_degrees(path: Path, latitudes: ArrayLike, longitudes: ArrayLike) -> None:
    north, east = np.asarray(latitudes), np.asarray(longitudes)
    wrong = (abs(north) > 90) | (abs(east) > 180)
    if wrong.any():
        at = int(np.argmax(wrong))
        raise ValueError(
            f"{path}: latitude {north[at]}, longitude {east[at]} are no degrees; if these are"
            " metres, name the columns northing and easting"
        )
    none = (north == 0) & (east == 0)
    if none.any():
        raise ValueError(
            f"{path}: {int(none.sum())} positions are latitude 0, longitude 0, what receivers write"
            f" without a fix (the first in row {int(np.argmax(none))}); drop these"
        )


def _from_poses(path: Path, rows: Sequence[Sequence[str]]) -> Track:
    widths = {len([field for field in row if field]) for row in rows}
    if widths not in ({_TUM}, {_KITTI}):
        raise ValueError(
            f"{path} has lines of {', '.join(map(str, sorted(widths)))} fields and no names of"
            f" columns; give these in its first line, or poses of TUM ({_TUM} numbers: time,"
            f" position, quaternion) or KITTI ({_KITTI}: a pose matrix)"
        )
    values = np.array(
        [
            [_number(path, at, field, "pose") for field in row if field]
            for at, row in enumerate(rows, 1)
        ]
    )
    if widths == {_KITTI}:
        matrices = values.reshape(-1, 3, 4)
        right = matrices[:, :, 0]  # of the camera; y points down
        headings = np.degrees(np.arctan2(-right[:, 2], right[:, 0]))
        return Track(Positions(matrices[:, :, 3], LOCAL, headings, {}, str(path)))
    x, y, z, w = values[:, 4:].T
    positions = Positions(values[:, 1:4], LOCAL, heading_of(x, y, z, w), {}, str(path))
    return Track(positions, seconds=in_seconds(values[:, 0]))


def _from_exif(folder: ImageFolder) -> Positions:
    from PIL import Image

    found, missing, headings = [], [], []
    for name, path in zip(folder.names, folder.paths, strict=True):
        with Image.open(path) as image:
            gps = image.getexif().get_ifd(_GPS)
        try:
            place = _angle(gps, _LATITUDE), _angle(gps, _LONGITUDE)
        except (KeyError, TypeError, ValueError, ZeroDivisionError):
            place = math.nan, math.nan
        missing += [] if np.isfinite(place).all() else [name]
        found.append(place)
        headings.append(float(gps.get(_DIRECTION, math.nan)))
    refuse_missing(f"{folder.path}: EXIF data", missing, "images")
    north, east = np.array(found).T
    _check_degrees(folder.path, north, east)
    known = np.array(headings) if np.isfinite(headings).all() else None
    return Positions(from_degrees(north, east), GEOGRAPHIC, known, {}, str(folder.path))


def _angle(gps: Mapping[int, Any], tag: int) -> float:
    """Degrees of a latitude or longitude, below 0 in the south and west."""
    degrees, minutes, seconds = (float(part) for part in gps[tag])
    angle = degrees + minutes / 60 + seconds / 3600
    return -angle if str(gps[tag - 1]) in "SW" else angle
