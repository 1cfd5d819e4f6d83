"""Ground truth in files: NumPy's, VPR-Bench's, or text."""

import csv
import os
import re
import warnings
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.ground_truth import GroundTruth, resolve_ground_truth
from amusic_gym.utils import reading

PAIRS_HEADER = "query,place"  # first line of a text file that lists pairs, as messages give it

_QUERY, _PLACE = (
    re.compile(rf"({words})s?([ _-]?(id|idx|index|name|image|frame|file|filename|path))?")
    for words in ("query|querie", "place|reference|ref|database|db|map")
)
_LARGEST_TEXT = 2**31  # bytes
Names = tuple[Sequence[str], Sequence[str]]  # file names of the queries and of the places


def read_truth(
    path: str | os.PathLike[str],
    queries: int,
    references: int,
    *,
    tolerance: int | None = None,
    default: int | None = None,
    trust: bool = False,
    parts: Sequence[int] = (),
    names: Names | None = None,
) -> GroundTruth:
    """Ground truth from a file.

    ``.npy``: a boolean matrix [query, reference], or one place per query, -1 for none; or the
    pickled file of VPR-Bench or of GSV-Cities (``*_gt.npy``: the true places of each query), with
    ``trust`` only, because a pickle can run code. ``.npz``: positions as Patch-NetVLAD has them,
    ``utmQ`` (Q, 2), ``utmDb`` (R, 2) and the distance ``posDistThr`` up to which places are true,
    all in metres. Anything else is text, its numbers apart by commas, semicolons or blanks, ``#``
    before a comment: one place per line and query; or a matrix of 0 and 1; or, below the line
    ``query,place`` or ``query,reference``, one true pair per line, of numbers from 0 or, where
    ``names`` are given, of file names.

    Args:
        path: the file.
        queries: Q.
        references: R, places on the map.
        tolerance: places to either side that are right too; see :meth:`GroundTruth.with_tolerance`.
        default: what it is where the file gives one place per query, and ``tolerance`` is None.
        trust: True to unpickle a file.
        parts: see :meth:`GroundTruth.widened`.
        names: of the images.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for another shape or range, a line that cannot be read, a missing tolerance, or
            one that the true places contradict.
    """
    path = Path(path)
    truth: GroundTruth | NDArray[Any]
    try:
        if path.suffix.lower() == ".npy":
            truth = _read_npy(path, trust, queries, references)
        elif path.suffix.lower() == ".npz":
            truth = _read_positions(path, queries, references)
        else:
            truth = _read_text(path, queries, references, names)
        if isinstance(truth, GroundTruth):
            return truth if tolerance is None else truth.with_tolerance(tolerance, parts)
        if truth.ndim == 1 and tolerance is None:
            tolerance = default
        return resolve_ground_truth(truth, tolerance, queries, references, parts)[0]
    except ValueError as error:
        prefix = "" if str(path) in str(error) else f"{path}: "
        raise ValueError(f"{prefix}{error}") from None


def _read_npy(path: Path, trust: bool, queries: int, references: int) -> NDArray[Any] | GroundTruth:
    with reading.open_file(path) as file:
        pickled = reading.read_npy_header(file, path).dtype.hasobject
    if not pickled:
        return reading.read_array(path)
    rows = unpickle(path, trust)
    try:
        if rows.ndim == 1 and not any(np.ndim(each) for row in rows for each in row):
            ids, lists = np.arange(len(rows)), list(rows)  # GSV-Cities
        else:
            ids = np.asarray([row[0] for row in rows], dtype=np.int64)
            lists = [row[1] for row in rows]
        places = [np.unique(np.asarray(each, dtype=np.int64)) for each in lists]
    except (IndexError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is not laid out as VPR-Bench's ground truth (query id, list of true "
            f"places) or GSV-Cities' (true places of each query) is: {error}"
        ) from None
    order = order_of(ids, queries, path)
    return GroundTruth.from_lists([places[row] for row in order], references)


def _read_positions(path: Path, queries: int, references: int) -> GroundTruth:
    """Places within ``posDistThr`` of each query, up to and including it."""
    with reading.open_file(path) as file:
        try:
            with np.load(file, allow_pickle=False) as arrays:
                frames, places = (np.asarray(arrays[key], np.float64) for key in ("utmQ", "utmDb"))
                metres = float(np.asarray(arrays["posDistThr"], np.float64).item())
        except Exception as error:  # a damaged zip raises nearly anything
            raise ValueError(
                f"{path} is not laid out as Patch-NetVLAD's ground truth is (utmQ, utmDb, "
                f"posDistThr): {error}"
            ) from None
    if (frames.shape, places.shape) != ((queries, 2), (references, 2)):
        raise ValueError(
            f"{path} has positions of {frames.shape} queries and {places.shape} places where "
            f"({queries}, 2) and ({references}, 2) are expected; give those of the same images"
        )
    if not (np.isfinite(frames).all() and np.isfinite(places).all() and 0 <= metres < np.inf):
        raise ValueError(f"{path} holds a position or distance that is no number; mend it")
    near = [np.flatnonzero(np.hypot(*(places - frame).T) <= metres) for frame in frames]
    return GroundTruth.from_lists(near, references)


def unpickle(path: Path, trust: bool) -> NDArray[Any]:
    """The object array of a VPR-Bench file; executes what the pickle says.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: without ``trust``, and for a file of another kind.
    """
    with reading.open_file(path) as file:
        reading.read_npy_header(file, path)  # no bare pickle: only what VPR-Bench writes
        if not trust:
            raise ValueError(
                f"{path} holds pickled Python objects, which can run code when read; if you "
                "trust who made it, pass trust=True (--trust)"
            )
        file.seek(0)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # NumPy on pickles of Python 2
                array: NDArray[Any] = np.load(file, allow_pickle=True, encoding="latin1")
        except Exception as error:  # a damaged pickle raises nearly anything
            raise ValueError(
                f"{path} cannot be unpickled ({type(error).__name__}: {error}); copy it again"
            ) from None
    return array


def order_of(ids: NDArray[np.int64], queries: int, path: Path) -> NDArray[np.int64]:
    """Rows by rising query id: SIC needs the frames in the order of the traverse."""
    if ids.shape != (queries,) or len(np.unique(ids)) != queries:
        raise ValueError(
            f"{path} has query ids of shape {ids.shape} with {len(np.unique(ids))} different "
            f"ones where {queries} are expected; it is damaged or of another data set"
        )
    order: NDArray[np.int64] = np.argsort(ids)
    return order


def _read_text(
    path: Path, queries: int, references: int, names: Names | None
) -> GroundTruth | NDArray[np.generic]:
    try:
        lines = reading.read_regular(path, _LARGEST_TEXT).decode("utf-8-sig").splitlines()
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is no text ({error.reason}); give .npy or text") from None
    rows = [(at, re.sub(r"(^|\s)#.*", "", line).strip()) for at, line in enumerate(lines, 1)]
    rows = [(at, line) for at, line in rows if line]
    if not rows:
        raise ValueError(f"{path} holds no ground truth; give one place per line and query")
    columns = _header(rows[0][1])
    if columns is not None:
        return _from_pairs(rows, columns, queries, references, names, path)
    numbers = [_whole_numbers(_fields(line), at, path) for at, line in rows]
    widths = {len(row) for row in numbers}
    if len(widths) != 1:
        raise ValueError(
            f"{path} has lines of {sorted(widths)} numbers; give one place per line, or a matrix "
            f"of {queries} lines with {references} numbers each, or pairs below the line "
            f"{PAIRS_HEADER}"
        )
    array = np.array(numbers)
    if widths == {1}:
        return array[:, 0]
    if not np.isin(array, (0, 1)).all():
        raise ValueError(
            f"{path} has lines of several numbers that are not 0 or 1; pairs need the line "
            f"{PAIRS_HEADER} above them"
        )
    return array.astype(np.bool_)


def _fields(line: str) -> list[str]:
    return re.findall(r"[^\s,;]+", line)


def _header(line: str) -> tuple[int, int] | None:
    """Which column holds the query and which the place, where a line says so."""
    fields = [field.strip("\"'").lower() for field in _split(line)]
    for query in range(2):
        if len(fields) == 2 and _QUERY.fullmatch(fields[query]):
            if _PLACE.fullmatch(fields[1 - query]):
                return query, 1 - query
    return None


def _split(line: str) -> list[str]:
    """Fields of a line of pairs; a comma, semicolon or tab lets names hold blanks."""
    separator = next((each for each in ",;\t" if each in line), None)
    if separator is None:
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=separator))]


def _whole_numbers(fields: list[str], line: int, path: Path) -> list[int]:
    try:
        return [int(field) for field in fields]
    except ValueError:
        raise ValueError(
            f"{path}, line {line}: {' '.join(fields)[:40]!r} are not whole numbers; give places "
            "counted from 0"
        ) from None


def _from_pairs(
    rows: list[tuple[int, str]],
    columns: tuple[int, int],
    queries: int,
    references: int,
    names: Names | None,
    path: Path,
) -> GroundTruth:
    known = [numbers_by_name(each) for each in names or ((), ())]
    places: list[set[int]] = [set() for _ in range(queries)]
    for at, line in rows[1:]:
        fields = _split(line)
        if len(fields) != 2:
            raise ValueError(
                f"{path} has lines of {[len(fields)]} numbers or names, as line {at}; give one "
                f"pair per line below {PAIRS_HEADER}"
            )
        try:
            query, place = (
                _index(fields[column], each) for column, each in zip(columns, known, strict=True)
            )
        except ValueError as error:
            raise ValueError(f"{path}, line {at}: {error}") from None
        if not (0 <= query < queries and 0 <= place < references):
            raise ValueError(
                f"{path}: query {query}, place {place} is out of range; valid: queries 0 to "
                f"{queries - 1}, places 0 to {references - 1}"
            )
        places[query].add(place)
    return GroundTruth.from_lists([sorted(row) for row in places], references)


def numbers_by_name(names: Sequence[str]) -> dict[str, int | None]:
    """Number of each image by its name, with and without folder and suffix; None: of several."""
    found: dict[str, int | None] = {}
    for at, name in enumerate(names):
        path = PurePosixPath(name)
        for key in {path.name, path.stem, path.with_suffix("").as_posix()}:
            found[key] = None if key in found else at
    return found | {name: at for at, name in enumerate(names)}


def _index(field: str, known: dict[str, int | None]) -> int:
    """The number that a field gives or whose image it names; 007 is a name where there is one."""
    number = re.fullmatch(r"-?(0|[1-9]\d*)", field)
    keys = [] if number else [field, PurePosixPath(field.replace("\\", "/")).name]
    for key in keys:
        if key in known:
            index = known[key]
            if index is None:
                raise ValueError(f"{field!r} names several images; give the path in the folder")
            return index
    if re.fullmatch(r"-?\d+", field):
        return int(field)
    which = "no image's name and no whole number" if known else "not a whole number"
    raise ValueError(
        f"{field[:80]!r} is {which}; give places counted from 0, or file names of image folders"
    )
