"""Which places are true for the frames of one image folder on the map of another.

Every function gives a `GroundTruth`, as ``ScoreBank(ground_truth=...)`` takes it. Where a tolerance
of some places counts, it ends where one of several joined folders ends: the last image of a street
and the first of the next are neighbours in the list only.
"""

from __future__ import annotations

import math
import os
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym import storage
from amusic_gym.ground_truth import GroundTruth, resolve_ground_truth
from amusic_gym.importers import read_ground_truth
from amusic_gym.routes.folders import ImageFolder

METRES = 25.0
"""Distance within which two images show the same place, as it is customary in this field."""

PAIRS_HEADER = ["query", "place"]
"""First line of a text file that lists pairs."""

_Integers = NDArray[np.int64]


def by_index(reference: ImageFolder, query: ImageFolder, tolerance: int) -> GroundTruth:
    """Frame q is at place q, ± ``tolerance`` places; in joined folders, part by part.

    Raises:
        ValueError: when the folders are not joined of the same number of parts, or a part of the
            query holds more images than its part of the reference.
    """
    parts = list(zip(reference.parts, query.parts, strict=False))
    if len(reference.parts) != len(query.parts) or any(here < there for here, there in parts):
        raise ValueError(
            f"{query.path} has {_lengths(query)} images, {reference.path} {_lengths(reference)}: "
            "frame q cannot be at place q; take as many of each, or give the ground truth by file "
            "names or in a file"
        )
    begins = np.cumsum((0, *reference.parts))
    centres = [begin + np.arange(there) for begin, (_, there) in zip(begins, parts, strict=False)]
    return _around(np.concatenate(centres), tolerance, reference)


def by_name(reference: ImageFolder, query: ImageFolder, tolerance: int) -> GroundTruth:
    """A frame is at the place whose image has the same name, ± ``tolerance`` places.

    The name counts from the folder on and without suffix; in joined folders, within the same part.
    A frame without a namesake has no true place.

    Raises:
        ValueError: when no frame at all has a namesake, or two places share a name.
    """
    places: dict[tuple[int, str], int] = {}
    for place, name in enumerate(_keys(reference)):
        if name in places:
            raise ValueError(
                f"{reference.paths[places[name]]} and {reference.paths[place]} have the same name "
                "but for the suffix: which is the place? Keep one of them"
            )
        places[name] = place
    centres = np.array([places.get(name, -1) for name in _keys(query)])
    if not (centres >= 0).any():
        raise ValueError(
            f"no image in {query.path} has the name of one in {reference.path}; give the ground "
            "truth by index or in a file"
        )
    return _around(centres, tolerance, reference)


def by_position(reference: ImageFolder, query: ImageFolder, metres: float = METRES) -> GroundTruth:
    """True places lie within ``metres`` of the frame, by names like @UTM_EAST@UTM_NORTH@...@.jpg.

    The convention is that of VPR-methods-evaluation and its data sets; both folders must be in the
    same UTM zone. Warns when no frame has a true place.

    Raises:
        ValueError: for a name without position, or ``metres`` that are no distance.
    """
    if not 0 <= metres < math.inf:
        raise ValueError(f"metres is {metres!r}; give a distance of 0 or more")
    here, there = _positions(reference), _positions(query)  # (R, 2), (Q, 2)
    near = [np.nonzero(np.hypot(*(here - frame).T) <= metres)[0] for frame in there]
    truth = _truth(near, len(reference))
    if not truth.has_place.any():
        warnings.warn(
            f"no image in {query.path} lies within {metres} m of one in {reference.path}; check "
            "that both are in the same UTM zone",
            UserWarning,
            stacklevel=2,
        )
    return truth


def from_file(
    path: str | os.PathLike[str],
    reference: ImageFolder,
    query: ImageFolder,
    tolerance: int | None = None,
    trust: bool = False,
) -> GroundTruth:
    """Ground truth from a file: NumPy's, VPR-Bench's, or text.

    ``.npy``: a boolean matrix [query, reference], or one place per query, -1 for none; or the
    pickled file of VPR-Bench, with ``trust`` only, because a pickle can run code. Anything else is
    text, its numbers apart by commas, semicolons or blanks, ``#`` before a comment: one place per
    line and query; or a matrix of 0 and 1; or, below the line ``query,place``, one true pair per
    line.

    Args:
        path: the file.
        reference: the map, R images.
        query: the run, Q images.
        tolerance: places to either side that count where the file gives one place per query.
        trust: True to unpickle a file of VPR-Bench.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for another shape or range, a line that cannot be read, or a missing tolerance.
    """
    path = Path(path)
    queries, references = len(query), len(reference)
    array: GroundTruth | NDArray[Any]
    try:
        if path.suffix.lower() == ".npy":
            array = read_ground_truth(path, trust, queries, references)
        else:
            array = _read_text(path, queries, references)
        if isinstance(array, np.ndarray) and array.shape == (queries,) and tolerance is not None:
            return _around(array, tolerance, reference)
        return resolve_ground_truth(array, tolerance, queries, references)[0]
    except ValueError as error:
        prefix = "" if str(path) in str(error) else f"{path}: "
        raise ValueError(f"{prefix}{error}") from None


def with_copies(truth: GroundTruth, reference: ImageFolder) -> GroundTruth:
    """``truth``, and where a place is true, also its neighbours that are the same file copied.

    A train that stands, or a black tunnel, can give a run of places with one and the same image
    (``reference.repeats``). No technique can tell them apart, so which of them is found is luck.
    The paper does not speak of it; its rule is the one without.
    """
    run_of = np.arange(len(reference))
    for first, last in reference.repeats:
        run_of[first : last + 1] = first
    runs = [np.unique(run_of[truth.places[a:b]]) for a, b in _rows(truth)]
    return _truth([np.nonzero(np.isin(run_of, run))[0] for run in runs], len(reference))


def _around(centres: NDArray[np.generic], tolerance: int, reference: ImageFolder) -> GroundTruth:
    """± ``tolerance`` places around each centre, but not beyond the part that it lies in."""
    whole = GroundTruth.from_places(centres, tolerance, len(reference))
    if len(reference.parts) == 1:
        return whole
    part_of = np.repeat(np.arange(len(reference.parts)), reference.parts)
    places = [whole.places[a:b] for a, b in _rows(whole)]
    return _truth(
        [
            row[part_of[row] == part_of[centre]]
            for row, centre in zip(places, centres.astype(np.int64), strict=True)
        ],
        len(reference),
    )


def _truth(places: list[_Integers], references: int) -> GroundTruth:
    """From the true places of each query, rising."""
    indptr = np.cumsum([0, *map(len, places)])
    return GroundTruth(indptr, np.concatenate(places), references)


def _rows(truth: GroundTruth) -> zip[tuple[int, int]]:
    """Where each query's places begin and end."""
    return zip(truth.indptr[:-1].tolist(), truth.indptr[1:].tolist(), strict=True)


def _lengths(folder: ImageFolder) -> str:
    return " + ".join(map(str, folder.parts))


def _keys(folder: ImageFolder) -> list[tuple[int, str]]:
    """Part and name of each image, without the part's own folder and the suffix."""
    part_of = np.repeat(np.arange(len(folder.parts)), folder.parts).tolist()
    if len(folder.parts) == 1:
        names = [Path(name).with_suffix("").as_posix() for name in folder.names]
    else:
        names = [path.stem for path in folder.paths]
    return list(zip(part_of, names, strict=True))


def _positions(folder: ImageFolder) -> NDArray[np.float64]:
    """(N, 2) UTM easting and northing in metres."""
    positions = np.empty((len(folder), 2))
    for at, path in enumerate(folder.paths):
        pieces = path.name.split("@")
        try:
            positions[at] = float(pieces[1]), float(pieces[2])
        except (IndexError, ValueError):
            positions[at] = math.nan
        if not np.isfinite(positions[at]).all():
            raise ValueError(
                f"{path} does not say where it is; its name must begin with "
                "@UTM_EAST@UTM_NORTH@, both in metres"
            )
    return positions


def _read_text(path: Path, queries: int, references: int) -> GroundTruth | NDArray[np.generic]:
    with storage.open_file(path) as file:
        try:
            lines = file.read().decode("utf-8-sig").splitlines()
        except UnicodeDecodeError as error:
            raise ValueError(f"{path} is no text ({error.reason}); give .npy or text") from None
    rows = [(number, _fields(line)) for number, line in enumerate(lines, 1)]
    rows = [(number, fields) for number, fields in rows if fields]
    header = bool(rows) and [field.lower() for field in rows[0][1]] == PAIRS_HEADER
    numbers = [_whole_numbers(fields, number, path) for number, fields in rows[header:]]
    widths = {len(row) for row in numbers}
    if not rows:
        raise ValueError(f"{path} holds no ground truth; give one place per line and query")
    if header and widths <= {2}:
        return _from_pairs(numbers, queries, references, path)
    if header or len(widths) != 1:
        raise ValueError(
            f"{path} has lines of {sorted(widths)} numbers; give one place per line, or a matrix "
            f"of {queries} lines with {references} numbers each, or pairs below the line "
            f"{','.join(PAIRS_HEADER)}"
        )
    array = np.array(numbers)
    if widths == {1}:
        return array[:, 0]
    if not np.isin(array, (0, 1)).all():
        raise ValueError(
            f"{path} has lines of several numbers that are not 0 or 1; pairs need the line "
            f"{','.join(PAIRS_HEADER)} above them"
        )
    return array.astype(np.bool_)


def _fields(line: str) -> list[str]:
    return re.findall(r"[^\s,;]+", line.partition("#")[0])


def _whole_numbers(fields: list[str], line: int, path: Path) -> list[int]:
    try:
        return [int(field) for field in fields]
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: {' '.join(fields)[:40]!r} are not whole numbers; give places "
            "counted from 0"
        ) from None


def _from_pairs(pairs: list[list[int]], queries: int, references: int, path: Path) -> GroundTruth:
    places: list[set[int]] = [set() for _ in range(queries)]
    for query, place in pairs:
        if not (0 <= query < queries and 0 <= place < references):
            raise ValueError(
                f"{path}: query {query}, place {place} is out of range; valid: queries 0 to "
                f"{queries - 1}, places 0 to {references - 1}"
            )
        places[query].add(place)
    return _truth([np.array(sorted(row), np.int64) for row in places], references)
