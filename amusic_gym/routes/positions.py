"""Where the images of a traverse were taken, and how far apart two such places are.

One formula holds for all coordinates, the length of a straight line in metres. Latitude and
longitude become points on the WGS84 ellipsoid for that, so zones, poles and the date line are no
seams; the line is shorter than the way along the ground by a thousandth of a millimetre in a
kilometre.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.routes.folders import ImageFolder

GEOGRAPHIC, PROJECTED, LOCAL = "latitude and longitude", "easting and northing", "x and y"
"""Systems of coordinates; only positions in one and the same can be compared."""

HALF_TURN = 180  # degrees, the largest difference of two headings
_STRETCH = 2.0  # a traverse is longer than so many metres, and seldom than as many degrees
_EQUATOR, _FLATTENING = 6_378_137.0, 1 / 298.257223563  # WGS84: metres of the radius


@dataclass(frozen=True, eq=False)
class Positions:
    """Where N images were taken."""

    # (N, D) float64: easting and northing, or x, y and maybe z, or the points of `from_degrees`
    metres: NDArray[np.float64]
    system: str  # `GEOGRAPHIC`, `PROJECTED` or `LOCAL`
    # (N,) degrees clockwise from north, or from whatever a local frame counts them; None where they
    # are not known
    headings: NDArray[np.float64] | None
    # UTM zones that the positions are said to be in -> an image or file that says so
    zones: dict[str, str]
    source: str  # the file or folder, for messages

    def __len__(self) -> int:
        return len(self.metres)

    def take(self, chosen: ArrayLike) -> Positions:
        """The positions of these images, in this order."""
        at = np.asarray(chosen, np.int64)
        headings = None if self.headings is None else self.headings[at]
        return replace(self, metres=self.metres[at], headings=headings)

    def joined(self, other: Positions) -> Positions:
        """These and then the others, if comparable; headings where both have them."""
        check_comparable(self, other)
        both = None
        if self.headings is not None and other.headings is not None:
            both = np.concatenate([self.headings, other.headings])
        metres = np.concatenate([self.metres, other.metres])
        return replace(self, metres=metres, headings=both, zones={**other.zones, **self.zones})

    def distances(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """(N,) metres to a point (D,) of the same system."""
        return np.asarray(np.linalg.norm(self.metres - point, axis=1))

    def turns(self, heading: float) -> NDArray[np.float64]:
        """(N,) degrees from 0 to 180 between each heading and another."""
        if self.headings is None:
            raise ValueError(
                f"an image of {self.source} does not say in which direction it looks; the ninth"
                " field of its name, or a file's column 'heading', must give degrees"
            )
        turned = (self.headings - heading + HALF_TURN) % (2 * HALF_TURN) - HALF_TURN
        return np.asarray(np.abs(turned))

    def every(self, metres: float) -> NDArray[np.int64]:
        """Indices of the first image and of each next one at least ``metres`` > 0 from the last."""
        if not 0 < metres < math.inf:
            raise ValueError(f"--every-metres is {metres!r}; give a distance above 0")
        taken = [0]
        for at in range(1, len(self)):
            if np.linalg.norm(self.metres[at] - self.metres[taken[-1]]) >= metres:
                taken.append(at)
        return np.array(taken)

    def coordinates(self) -> NDArray[np.float64]:
        """(N, 2) latitude and longitude in degrees; in other systems (N, D) metres."""
        degrees = self.degrees()
        return self.metres if degrees is None else degrees

    def degrees(self) -> NDArray[np.float64] | None:
        """(N, 2) latitude and longitude; None in other systems."""
        if self.system != GEOGRAPHIC:
            return None
        x, y, z = self.metres.T
        # On the ellipsoid itself, so no iteration is needed.
        north = np.arctan2(z, (1 - _FLATTENING) ** 2 * np.hypot(x, y))
        return np.asarray(np.degrees(np.stack([north, np.arctan2(y, x)], axis=1)))


def from_degrees(latitudes: ArrayLike, longitudes: ArrayLike) -> NDArray[np.float64]:
    """(N, 3) metres from the Earth's centre, on the WGS84 ellipsoid."""
    north, east = np.radians(latitudes), np.radians(longitudes)
    eccentricity = _FLATTENING * (2 - _FLATTENING)
    radius = _EQUATOR / np.sqrt(1 - eccentricity * np.sin(north) ** 2)
    return np.stack(
        [
            radius * np.cos(north) * np.cos(east),
            radius * np.cos(north) * np.sin(east),
            radius * (1 - eccentricity) * np.sin(north),
        ],
        axis=1,
    )


def in_a_plane(*tracks: Positions) -> list[NDArray[np.float64]]:
    """Positions as (N, 2) metres in one plane, for pictures: east and north where these are known.

    The plane is the one in which the tracks lie best, around their middle.
    """
    points = np.concatenate([track.metres for track in tracks])
    middle = points.mean(axis=0)
    if tracks[0].system == GEOGRAPHIC:
        up = middle / np.linalg.norm(middle)
        east = np.array([-up[1], up[0], 0.0]) / max(math.hypot(up[0], up[1]), 1e-12)
        axes = np.stack([east, np.cross(up, east)])
    else:
        spread = np.argsort(-np.ptp(points, axis=0), kind="stable")[:2]
        axes = np.eye(points.shape[1])[np.sort(spread)]
    return [(track.metres - middle) @ axes.T for track in tracks]


def check_comparable(here: Positions, there: Positions) -> None:
    """Refuse positions of different systems or UTM zones, and degrees that stand for metres."""
    if here.system != there.system or here.metres.shape[1] != there.metres.shape[1]:
        raise ValueError(
            f"{here.source} gives {here.system}, {there.source} {there.system}: they cannot be"
            " compared; give both in one system of coordinates"
        )
    _check_metres(here, there)
    zones = {**there.zones, **here.zones}
    if len(zones) > 1:
        named = ", ".join(f"{zone} ({path})" for zone, path in sorted(zones.items()))
        raise ValueError(
            f"positions are in different UTM zones: {named}; give all in one zone, or latitude and"
            " longitude, or drop others"
        )


def from_names(folder: ImageFolder) -> Positions:
    """Positions in names like @UTM_EAST@UTM_NORTH@ZONE@BAND@...; field 9 is the heading."""
    positions = np.array([_numbers_in(path, (1, 2)) for path in folder.paths])
    headings = np.array([_numbers_in(path, (9,)) for path in folder.paths])[:, 0]
    for path, numbers in zip(folder.paths, positions, strict=True):
        if not np.isfinite(numbers).all():
            raise ValueError(
                f"{path} does not say where it is; its name must begin with @UTM_EAST@UTM_NORTH@,"
                " both in metres, or give a file of positions (--reference-positions,"
                " --query-positions)"
            )
    zones: dict[str, str] = {}
    for path in folder.paths:
        zone, band = _fields_of(path)[3:5]
        zones.setdefault(zone_of(zone, band), str(path))
    zones.pop("", None)
    known = headings if np.isfinite(headings).all() else None
    return Positions(positions, PROJECTED, known, zones, str(folder.path))


def zone_of(zone: str, band: str) -> str:
    """A UTM zone by its number and its hemisphere, which a band's letter tells; "" for none."""
    if not (zone.isdecimal() and 1 <= int(zone) <= 60 and len(band) == 1 and band.isalpha()):
        return ""
    return f"{int(zone)} {'north' if band.upper() >= 'N' else 'south'}"


def _fields_of(path: Path) -> list[str]:
    """Fields of a name like @UTM_EAST@UTM_NORTH@..., each in its place; "" where there is none."""
    return [*path.stem.split("@"), *[""] * 14]


def _numbers_in(path: Path, fields: Sequence[int]) -> list[float]:
    """Numbers in a name, NaN where one is none."""
    try:
        return [float(_fields_of(path)[field]) for field in fields]
    except ValueError:
        return [math.nan] * len(fields)


def _check_metres(here: Positions, there: Positions) -> None:
    """Refuse degrees: numbers in their range, all within a stretch that would be 2 metres."""
    positions = np.concatenate([here.metres, there.metres])
    small = here.system == PROJECTED and (abs(positions) <= HALF_TURN).all()
    if small and len(positions) > 2 and (np.ptp(positions, axis=0) < _STRETCH).all():
        east, north = positions[0]
        raise ValueError(
            f"{here.source}: positions such as @{east}@{north}@ look like degrees of longitude and"
            " latitude; give metres of UTM easting and northing, or a file whose columns are named"
            " latitude and longitude"
        )
