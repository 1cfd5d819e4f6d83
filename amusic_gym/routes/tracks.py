"""Positions as a file lists them, and those of images and frames between them."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.banks.truth_files import numbers_by_name
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.positions import Positions
from amusic_gym.utils.names import few

GAP = 1.0  # seconds that an image may be taken before or after the nearest position in time
Floats = NDArray[np.float64]

_NAMED = 3  # images that a refusal names before it only counts
_UNITS = ((1e17, 1e-9), (1e14, 1e-6), (1e11, 1e-3))  # clock times above these: nano, micro, milli


@dataclass(frozen=True, eq=False)
class Track:
    """Positions of a file, before they are those of images."""

    positions: Positions  # one per row
    names: Sequence[str] | None = None  # of images; None where rows have none
    # (N,) of frames, counted from 0; None where rows have none
    numbers: NDArray[np.float64] | None = None
    # (N,), rising where they are what tells an image; None where rows have none
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
            taken = in_seconds(self._stamps_of(folder))
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
        refuse_missing(self.positions.source, missing, f"images of {folder.path}")
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
        refuse_missing(source, [named[at] for at in lost.tolist()], "images")

        def drawn(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.stack([np.interp(wanted, rows, each) for each in values.T], axis=1)

        headings = self.positions.headings
        if headings is not None:
            turned = np.radians(headings)
            east, north = drawn(np.stack([np.sin(turned), np.cos(turned)], axis=1)).T
            headings = np.degrees(np.arctan2(east, north))
        given = self.positions
        return Positions(drawn(given.metres), given.system, headings, given.zones, source)


def in_seconds(stamps: ArrayLike) -> NDArray[np.float64]:
    """Clock times in seconds; those in nano-, micro- and milliseconds are known by their size."""
    values = np.asarray(stamps, np.float64)
    largest = abs(values).max(initial=0.0)
    return values * next((unit for least, unit in _UNITS if largest > least), 1.0)


def heading_of(x: Floats, y: Floats, z: Floats, w: Floats) -> Floats:
    """(N,) degrees clockwise, seen from above, of orientations as quaternions; z points up."""
    return np.asarray(-np.degrees(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z))))


def refuse_missing(source: str, missing: Sequence[str], what: str) -> None:
    """Refuse a source that lacks the positions of some images, naming a few."""
    if missing:
        raise ValueError(
            f"{source} has no position of {len(missing)} {what}: {few(missing, _NAMED)}"
            "; add them, or leave these images out (--order)"
        )
