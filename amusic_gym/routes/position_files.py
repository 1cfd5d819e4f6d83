"""Positions of images from files: CSV, EXIF, and the pose files of TUM and KITTI."""

from __future__ import annotations

import csv
import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.truth_files import numbers_by_name
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.positions import (
    GEOGRAPHIC,
    LOCAL,
    PROJECTED,
    Positions,
    from_degrees,
    zone_of,
)
from amusic_gym.utils import reading

EXIF = "exif"
"""In place of a file: positions that the images' own EXIF data give."""

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

GAP = 1.0
"""Seconds that an image may be taken before or after the nearest position in time."""

_PAIRS = {
    GEOGRAPHIC: ("latitude", "longitude"),
    PROJECTED: ("easting", "northing"),
    LOCAL: ("x", "y"),
}
_TUM, _KITTI = 8, 12  # numbers of a line
_MOST_BYTES = 2**30
_NAMED = 3  # images that a refusal names before it only counts
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # clock times above these: nano, micro, milli
_GPS, _LATITUDE, _LONGITUDE, _DIRECTION = 0x8825, 2, 4, 17  # tags of EXIF


@dataclass(frozen=True, eq=False)
class Track:
    """Positions of a file, before they are those of images.

    Attributes:
        positions: one per row.
        names: of images; None where rows have none.
        numbers: (N,) of frames, counted from 0; None where rows have none.
        seconds: (N,), rising where they are what tells an image; None where rows have none.
    """

    positions: Positions
    names: Sequence[str] | None = None
    numbers: NDArray[np.float64] | None = None
    seconds: NDArray[np.float64] | None = None

    def of_images(self, folder: ImageFolder) -> Positions:
        """The position of each image: by name, by number, by the time in its name, or by order.

        Raises:
            ValueError: for images without one, naming some.
        """
        whole = folder.complete or folder
        kept = list(folder.kept) or range(len(whole))
        if self.names is not None:
            return self._by_name(folder)
        if self.numbers is not None:
            return self._between("frame", self.numbers, np.array(kept), folder.names, 0.0)
        if self.seconds is not None:
            taken = _in_seconds(self._stamps_of(folder))
            return self._between("second", self.seconds, taken, folder.names, GAP)
        if len(self.positions) != len(whole):
            raise ValueError(
                f"{self.positions.source} has {len(self.positions)} positions without names, for"
                f" {len(whole)} images of {folder.path}; give one for each, in their order"
            )
        return self.positions.take(kept)

    def of_frames(self, numbers: ArrayLike, seconds: ArrayLike, what: str) -> Positions:
        """The position of each frame of a video: by its number, or by its time in the video.

        Args:
            numbers: (n,) of frames, counted from 0.
            seconds: (n,) since the first frame.
            what: the video.

        Raises:
            ValueError: for a file that names images, and for frames beyond its rows.
        """
        number, taken = np.asarray(numbers, np.float64), np.asarray(seconds, np.float64)
        named = [f"frame {int(each)}" for each in number]
        if self.numbers is not None:
            return self._between("frame", self.numbers, number, named, 0.0)
        if self.seconds is not None:
            return self._between("second", self.seconds, taken, named, GAP)
        raise ValueError(
            f"{self.positions.source} has neither frame numbers nor times, so it says nothing of"
            f" the frames of {what}; add a column 'frame', or 'time' in seconds since the first one"
        )

    def _by_name(self, folder: ImageFolder) -> Positions:
        known = numbers_by_name(self.names or ())
        found, missing = [], []
        for name in folder.names:
            keys = (name, Path(name).name, Path(name).stem)
            at = next((known[key] for key in keys if known.get(key) is not None), None)
            found.append(at)
            missing += [name] if at is None else []
        _refuse_missing(self.positions.source, missing, f"images of {folder.path}")
        return self.positions.take(found)  # type: ignore[arg-type]

    def _stamps_of(self, folder: ImageFolder) -> list[float]:
        stems = [Path(name).stem for name in folder.names]
        unread = [stem for stem in stems if not re.fullmatch(r"\d+(\.\d+)?", stem)]
        if unread:
            raise ValueError(
                f"{self.positions.source} tells positions by time, but {folder.path} has names such"
                f" as {unread[0]} that are no time; add a column 'name' to it"
            )
        return [float(stem) for stem in stems]

    def _between(
        self,
        unit: str,
        rows: NDArray[np.float64],
        wanted: NDArray[Any],
        named: Sequence[str],
        gap: float,
    ) -> Positions:
        """Positions at numbers or times, on the straight line between the rows around them."""
        source = self.positions.source
        if (np.diff(rows) <= 0).any():
            at = int(np.argmax(np.diff(rows) <= 0)) + 1
            raise ValueError(
                f"{source}: row {at} is of {unit} {rows[at]:.6g}, after {rows[at - 1]:.6g}; sort"
                " the rows, each once"
            )
        after = np.clip(np.searchsorted(rows, wanted), 1, max(len(rows) - 1, 1))
        nearest = np.min(
            [abs(rows[at.clip(max=len(rows) - 1)] - wanted) for at in (after - 1, after)], axis=0
        )
        inside = (wanted >= rows[0]) & (wanted <= rows[-1])
        lost = np.flatnonzero(nearest > gap if gap else ~inside)
        _refuse_missing(source, [named[at] for at in lost.tolist()], "images")

        def drawn(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.stack([np.interp(wanted, rows, each) for each in values.T], axis=1)

        headings = self.positions.headings
        if headings is not None:
            turned = np.radians(headings)
            east, north = drawn(np.stack([np.sin(turned), np.cos(turned)], axis=1)).T
            headings = np.degrees(np.arctan2(east, north))
        given = self.positions
        return Positions(drawn(given.metres), given.system, headings, given.zones, source)


def positions_of(source: str | os.PathLike[str], folder: ImageFolder) -> Positions:
    """Positions of a folder's images, from a file or, for ``"exif"``, from the images.

    Raises:
        FileNotFoundError: for a file that is not there.
        ValueError: for one that cannot be read, and for images without a position.
    """
    return _from_exif(folder) if os.fspath(source) == EXIF else read_track(source).of_images(folder)


def read_track(path: str | os.PathLike[str]) -> Track:
    """Positions of a text file.

    A first line of names makes it a table (`COLUMNS`); lines of 8 numbers are TUM's poses (time,
    position, quaternion), of 12 numbers KITTI's (the upper three rows of a pose matrix). Those say
    nothing of names; their headings compare with those of poses of the same kind only.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for anything else, with the line.
    """
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
    seconds = _in_seconds(column("seconds")) if "seconds" in header else None
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
    headings = -np.degrees(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))
    positions = Positions(values[:, 1:4], LOCAL, headings, {}, str(path))
    return Track(positions, seconds=_in_seconds(values[:, 0]))


def _in_seconds(stamps: ArrayLike) -> NDArray[np.float64]:
    """Clock times in seconds; those in nano-, micro- and milliseconds are known by their size."""
    values = np.asarray(stamps, np.float64)
    largest = abs(values).max(initial=0.0)
    return values * next((unit for least, unit in _UNITS if largest > least), 1.0)


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
    _refuse_missing(f"{folder.path}: EXIF data", missing, "images")
    north, east = np.array(found).T
    _check_degrees(folder.path, north, east)
    known = np.array(headings) if np.isfinite(headings).all() else None
    return Positions(from_degrees(north, east), GEOGRAPHIC, known, {}, str(folder.path))


def _angle(gps: Mapping[int, Any], tag: int) -> float:
    """Degrees of a latitude or longitude, below 0 in the south and west."""
    degrees, minutes, seconds = (float(part) for part in gps[tag])
    angle = degrees + minutes / 60 + seconds / 3600
    return -angle if str(gps[tag - 1]) in "SW" else angle


def _refuse_missing(source: str, missing: Sequence[str], what: str) -> None:
    if missing:
        more = f" and {len(missing) - _NAMED} more" if len(missing) > _NAMED else ""
        raise ValueError(
            f"{source} has no position of {len(missing)} {what}: {', '.join(missing[:_NAMED])}"
            f"{more}; add them, or leave these images out (--order)"
        )
