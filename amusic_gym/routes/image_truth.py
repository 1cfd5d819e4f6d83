"""Which places are true for the frames of one image folder on the map of another.

Every function gives a `GroundTruth`, as ``ScoreBank(ground_truth=...)`` takes it. Where a tolerance
of some places counts, it ends where one of several joined folders ends: the last image of a street
and the first of the next are neighbours in the list only. Where images were left out of a traverse
(`ImageFolder.without`), the others count with the numbers that they had before.
"""

import math
import os
import warnings
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.banks.truth_files import read_truth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import digest_of, read_bytes
from amusic_gym.routes.positions import HALF_TURN, Positions, check_comparable, from_names

METRES = 25.0  # within which two images show the same place, as is customary in this field


def by_index(
    reference: ImageFolder, query: ImageFolder, tolerance: int, *, exact: bool = False
) -> GroundTruth:
    """Frame q is at place q, ± ``tolerance`` places; in joined folders, part by part.

    Raises:
        ValueError: when the folders are not joined of the same number of parts, or a part of the
            query holds more images than its part of the reference, or, with ``exact``, fewer.
    """
    if reference.complete or query.complete:
        return _kept(by_index(_all(reference), _all(query), tolerance), reference, query)
    parts = list(zip(reference.parts, query.parts, strict=False))
    if len(reference.parts) != len(query.parts) or any(
        here < there or (exact and here > there) for here, there in parts
    ):
        raise ValueError(
            f"{query.path} has {_lengths(query)} images, {reference.path} {_lengths(reference)}: "
            "frame q cannot be at place q; take as many of each, or say what is true by file "
            "names (--truth-by name), by positions (--truth-by position), or in a file "
            "(--ground-truth FILE)"
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
    if reference.complete or query.complete:
        return _kept(by_name(_all(reference), _all(query), tolerance), reference, query)
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


class Places(Protocol):
    """A map, for what only counts its places."""

    @property
    def path(self) -> Path:
        """Where it is, for messages."""

    def __len__(self) -> int:
        """R."""


def by_position(
    reference: Places,
    query: ImageFolder,
    metres: float = METRES,
    *,
    heading: float | None = None,
    positions: tuple[Positions, Positions] | None = None,
) -> GroundTruth:
    """True places lie within ``metres`` of the frame. Warns when no frame has a true place.

    Without ``positions``, names say them, as @UTM_EAST@UTM_NORTH@...@.jpg. That convention is of
    VPR-methods-evaluation and its data sets:
    @EAST@NORTH@ZONE@BAND@LATITUDE@LONGITUDE@NUMBER@TILE@HEADING@..., of which the first two must
    be there.

    Args:
        reference: the map.
        query: the run.
        metres: within which a place is true.
        heading: true places are also seen in a direction within so many degrees of the frame's;
            None: in any.
        positions: of the map and of the run (:mod:`amusic_gym.routes.position_files`).

    Raises:
        ValueError: for a name without position, or without heading where that counts; for
            positions that cannot be compared; where every place is true for every frame; for
            ``metres`` or ``heading`` that are none.
    """
    if not 0 <= metres < math.inf:
        raise ValueError(f"metres is {metres!r}; give a distance of 0 or more")
    if heading is not None and not 0 <= heading <= HALF_TURN:
        raise ValueError(f"heading is {heading!r}; give degrees from 0 to {HALF_TURN}, or None")
    if positions is None:
        assert isinstance(reference, ImageFolder)
        positions = from_names(reference), from_names(query)
    here, there = positions
    check_comparable(here, there)
    near = [here.distances(point) <= metres for point in there.metres]
    if heading is not None:
        there.turns(0.0)  # refuses headings that are missing
        near = [
            row & (here.turns(each) <= heading)
            for row, each in zip(near, there.headings, strict=True)  # type: ignore[arg-type]
        ]
    truth = GroundTruth.from_lists([np.nonzero(row)[0] for row in near], len(reference))
    if len(reference) > 1 and all(row.all() for row in near):
        raise ValueError(
            f"every image of {reference.path} lies within {metres} m of every one of {query.path}, "
            "so any place would be right; give fewer metres, and check that positions are in metres"
        )
    if not truth.has_place.any():
        warnings.warn(
            f"no image in {query.path} lies within {metres} m of one in {reference.path}; check "
            "that both are in the same UTM zone, or system of coordinates",
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
    default: int | None = None,
) -> GroundTruth:
    """Ground truth from a file for two image folders (:mod:`amusic_gym.banks.truth_files`).

    Pairs may be of the images' names, with or without their folders and suffixes.
    """
    if reference.complete or query.complete:
        whole = from_file(path, _all(reference), _all(query), tolerance, trust, default)
        return _kept(whole, reference, query)
    return read_truth(
        path,
        len(query),
        len(reference),
        tolerance=tolerance,
        default=default,
        trust=trust,
        parts=reference.parts,
        names=(query.names, reference.names),
    )


def with_copies(truth: GroundTruth, reference: ImageFolder) -> GroundTruth:
    """``truth``, and where a place is true, also its neighbours that are the same file copied.

    A train that stands, or a black tunnel, can give a run of places with one and the same image
    (``reference.repeats``). No technique can tell them apart, so which of them is found is luck.
    The paper does not speak of it; its rule is the one without.
    """
    run_of = np.arange(len(reference))
    for first, last in reference.repeats:
        run_of[first : last + 1] = first
    runs = [np.unique(run_of[truth.of(query)]) for query in range(truth.queries)]
    places = [np.nonzero(np.isin(run_of, run))[0] for run in runs]
    return GroundTruth.from_lists(places, len(reference))


def warn_of_shared_files(reference: ImageFolder, query: ImageFolder) -> None:
    """Warn where images of the query are images of the map, byte for byte."""
    sizes = [{path: path.stat().st_size for path in each.paths} for each in (reference, query)]
    alike = set(sizes[0].values()) & set(sizes[1].values())
    places, frames = (
        [digest_of(read_bytes(path)) for path, size in each.items() if size in alike]
        for each in sizes
    )
    shared = sum(digest in set(places) for digest in frames)
    if shared:
        warnings.warn(
            f"images of {query.path} are on the map too, byte for byte: {shared} of {len(query)}; "
            "to find them there tells nothing of recognising places, give two recordings",
            UserWarning,
            stacklevel=2,
        )


def _all(folder: ImageFolder) -> ImageFolder:
    """The traverse before images were left out of it."""
    return folder.complete or folder


def _kept(truth: GroundTruth, reference: ImageFolder, query: ImageFolder) -> GroundTruth:
    """What of the truth of complete traverses holds for the images that were kept."""
    index = np.full(truth.references, -1)
    index[list(reference.kept) or slice(None)] = np.arange(len(reference))
    places = [index[truth.of(at)] for at in query.kept or range(len(query))]
    return GroundTruth.from_lists([each[each >= 0] for each in places], len(reference))


def _around(centres: NDArray[np.generic], tolerance: int, reference: ImageFolder) -> GroundTruth:
    """± ``tolerance`` places around each centre, but not beyond the part that it lies in."""
    truth = GroundTruth.from_places(centres, 0, len(reference))
    return truth.widened(tolerance, reference.parts)


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
