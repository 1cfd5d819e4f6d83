"""Score banks from what others have: score matrices, descriptors, VPR-Bench's matches."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import declared_seconds
from amusic_gym.banks.descriptors import DescriptorPair
from amusic_gym.banks.ground_truth import GroundTruth, resolve_ground_truth
from amusic_gym.banks.loop_closure import rows_without_recent, truth_without_recent
from amusic_gym.banks.scores import as_float32, check_names, check_rows
from amusic_gym.banks.truth_files import order_of, read_truth, unpickle
from amusic_gym.utils import reading
from amusic_gym.utils.names import suggest

VPRBENCH_MATCHES = "precomputed_data_corrected.npy"  # VPR-Bench's file in each technique's folder
_BLOCK = 2**18  # scores in memory at a time
_SURE = 4.0  # standard deviations of chance that let scores be taken for distances

_Path = str | os.PathLike[str]


def from_arrays(
    files: Mapping[str, _Path],
    seconds: Mapping[str, float],
    *,
    tolerance: int | None = None,
    ground_truth: _Path | NDArray[Any] | GroundTruth | None = None,
    name: str = "",
    exclude_recent: int | None = None,
    out: _Path | None = None,
) -> ScoreBank:
    """A bank from one .npy file of scores per technique.

    Args:
        files: technique name -> .npy file, (Q, R) numbers, higher = more similar.
        seconds: technique name -> seconds of one run on one frame.
        tolerance: see `ScoreBank`.
        ground_truth: as for `ScoreBank`, or a file (:mod:`amusic_gym.banks.truth_files`).
        name: what to call the bank in tables.
        exclude_recent: as for `extract`.
        out: the bank's folder to write; None: the bank stays in memory. With it, memory holds some
            rows at a time.

    Raises:
        FileNotFoundError: when a file is missing.
        ValueError: for a file that holds no such matrix, or distances; for seconds for other
            techniques.
        OSError: when the bank cannot be written.
    """
    names = check_names(list(files))
    paths = [Path(path) for path in files.values()]
    matrices = [_Matrix.of(path) for path in paths]
    _check_same_shape(names, matrices)
    queries, references = matrices[0].shape
    if isinstance(ground_truth, str | os.PathLike):
        ground_truth = read_truth(ground_truth, queries, references, tolerance=tolerance)
    truth, places = resolve_ground_truth(ground_truth, tolerance, queries, references)
    if exclude_recent is not None:
        truth = truth_without_recent(truth, exclude_recent)
    costs = _seconds_in_order(names, seconds)
    source = "arrays: " + ", ".join(path.name for path in paths)
    rows: Iterator[NDArray[np.float32]] = (
        block
        for technique, matrix in zip(names, matrices, strict=True)
        for block in _checked(technique, matrix.blocks(), truth)
    )
    if exclude_recent is not None:
        rows = rows_without_recent(rows, queries, exclude_recent)
    return ScoreBank.from_rows(
        rows, names, costs, truth=truth, tolerance=places, name=name, source=source, out=out
    )


def from_descriptors(
    pairs: Sequence[DescriptorPair],
    seconds: Mapping[str, float],
    *,
    tolerance: int | None = None,
    ground_truth: NDArray[Any] | GroundTruth | None = None,
    name: str = "",
    exclude_recent: int | None = None,
    out: _Path | None = None,
    advance: Callable[[int], object] = lambda done: None,
) -> ScoreBank:
    """A bank from the descriptors of one or several techniques.

    Args:
        pairs: descriptors of each technique on the map and on the run
            (`amusic_gym.routes.descriptor_files.read_descriptors` reads them).
        seconds: technique name -> seconds of one run on one frame.
        tolerance: see `ScoreBank`; likewise ``ground_truth`` and ``name``.
        ground_truth: by default, query q is at place q.
        name: what to call the bank in tables.
        exclude_recent: as for `extract`.
        out: the bank's folder to write; None: the bank stays in memory. With it, memory holds
            blocks of descriptors and of rows at a time.
        advance: called with the number of pairs of images that were compared.

    Raises:
        ValueError: for techniques with different numbers of images, a map that is its own run,
            descriptors that cannot be used, or seconds for other techniques.
        OSError: when the bank cannot be written.
    """
    names = check_names([pair.technique for pair in pairs])
    references, queries = map(len, pairs[0].sides)
    for pair in pairs:
        pair.check_counts(references, queries)
    truth, places = resolve_ground_truth(ground_truth, tolerance, queries, references)
    if exclude_recent is not None:
        truth = truth_without_recent(truth, exclude_recent)
    costs = _seconds_in_order(names, seconds)
    files = dict.fromkeys(Path(each.source).name for pair in pairs for each in pair.sides)
    rows: Iterator[NDArray[np.float32]] = (
        block for pair in pairs for block in pair.score_rows(advance)
    )
    if exclude_recent is not None:
        rows = rows_without_recent(rows, truth.queries, exclude_recent)
    else:
        for pair in pairs:
            pair.check_apart()
    return ScoreBank.from_rows(
        rows,
        names,
        costs,
        truth=truth,
        tolerance=places,
        name=name,
        source=f"descriptors: {', '.join(files)}",
        out=out,
    )


def from_recording(folder: _Path, techniques: Sequence[str] | None = None) -> ScoreBank:
    """A bank from a recording's folder: scores/NAME.npy, techniques.json, ground_truth.npy.

    ``techniques.json`` holds, per technique, ``encode_s`` and ``match_s``: seconds to encode a
    frame and to match it with one reference. ``techniques`` are those of the bank, in its order;
    None: all, by name.

    Raises:
        FileNotFoundError: when a file is missing.
        ValueError: for an unknown technique, or a damaged file.
    """
    folder = Path(folder)
    path = folder / "techniques.json"
    try:
        times = reading.read_json(path, "copy the recording again")
        names = list(techniques or sorted(times, key=str.casefold))
        for name in names:
            if name not in times:
                raise ValueError(suggest("technique", name, times))
        truth = reading.read_array(folder / "ground_truth.npy")
        per_reference = truth.shape[1]
        seconds = {n: times[n]["encode_s"] + per_reference * times[n]["match_s"] for n in names}
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(f"{path} or the ground truth beside it is damaged: {error}") from error
    files = {name: folder / "scores" / f"{name}.npy" for name in names}
    return from_arrays(files, seconds, ground_truth=truth, name=folder.name)


def from_vprbench(
    directory: _Path,
    techniques: Sequence[str],
    ground_truth: _Path | NDArray[Any] | GroundTruth,
    trust: bool = False,
    *,
    tolerance: int | None = None,
    name: str = "",
) -> ScoreBank:
    """A bank from VPR-Bench's precomputed matches.

    VPR-Bench stores pickled Python objects, and reading a pickle runs whatever its author put
    into it: hence ``trust``. A technique's seconds are its seconds to encode a frame plus R times
    its seconds to match it with one reference.

    Args:
        directory: the folder with one folder per technique (VPR-Bench's ``precomputed_matches``,
            or the data set's folder that holds it).
        techniques: which of them, in the bank's order.
        ground_truth: VPR-Bench's file (query id, list of true places), or any form that
            `from_arrays` takes.
        trust: True to unpickle these files.
        tolerance: see `ScoreBank`.
        name: what to call the bank in tables.

    Raises:
        FileNotFoundError: when the folder or a file is missing.
        ValueError: without ``trust``; for an unknown technique; for a file of another layout.
    """
    folder = _matches_folder(Path(directory))
    names = check_names(techniques)
    available = sorted(entry.parent.name for entry in folder.glob(f"*/{VPRBENCH_MATCHES}"))
    for technique in names:
        if technique not in available:
            raise ValueError(suggest("technique", technique, available))
    matches = [_read_matches(folder / technique / VPRBENCH_MATCHES, trust) for technique in names]
    _check_same_shape(names, [scores for scores, _ in matches])
    queries, references = matches[0][0].shape
    if isinstance(ground_truth, str | os.PathLike):
        ground_truth = read_truth(
            ground_truth, queries, references, tolerance=tolerance, trust=trust
        )
    truth, places = resolve_ground_truth(ground_truth, tolerance, queries, references)
    rows = (
        block
        for technique, (scores, _) in zip(names, matches, strict=True)
        for block in _checked(technique, [scores], truth)
    )
    return ScoreBank.from_rows(
        rows,
        names,
        [seconds for _, seconds in matches],
        truth=truth,
        tolerance=places,
        name=name,
        source=f"VPR-Bench: {folder.resolve().parent.name}",
    )


@dataclass(frozen=True)
class _Matrix:
    """A file's matrix of scores, of which some rows are in memory at a time."""

    path: Path
    header: reading.NpyHeader

    @classmethod
    def of(cls, path: Path) -> _Matrix:
        """That of a .npy file."""
        with reading.open_file(path) as file:
            header = reading.read_npy_header(file, path)
        if header.dtype.hasobject:
            reading.read_array(path)  # refuses
        _check_matrix(header.shape, header.dtype, path)
        return cls(path, header)

    @property
    def shape(self) -> tuple[int, ...]:
        """(Q, R)."""
        return self.header.shape

    def blocks(self) -> Iterator[NDArray[np.float32]]:
        """The rows, some at a time."""
        step = max(1, _BLOCK // self.shape[1])
        for first in range(0, self.shape[0], step):
            yield as_float32(self.header.mapped(self.path)[first : first + step])


def _check_matrix(shape: tuple[int, ...], dtype: np.dtype[Any], path: _Path) -> None:
    if len(shape) != 2 or 0 in shape or dtype.kind not in "fiub":
        raise ValueError(
            f"{path} has shape {shape} and dtype {dtype}; give a matrix "
            "[query, reference] of numbers with at least one of each"
        )


def _checked(
    technique: str, blocks: Iterable[NDArray[np.float32]], truth: GroundTruth
) -> Iterator[NDArray[np.float32]]:
    """The blocks of rows of a technique, unless they hold what is no score, or distances."""
    first, highest, lowest = 0, 0, 0
    for rows in blocks:
        check_rows(technique, rows, first)
        frames = np.arange(first, first + len(rows))
        worst = np.where(np.isneginf(rows), np.inf, rows).argmin(axis=1)
        highest += int(truth.correct(rows.argmax(axis=1), frames).sum())
        lowest += int(truth.correct(worst, frames).sum())
        first += len(rows)
        yield rows
    if lowest - highest > _SURE * (lowest + highest) ** 0.5:
        raise ValueError(
            f"scores of technique {technique!r} look like distances: the lowest of a row is at a "
            f"true place on {lowest} frames, the highest on {highest}; higher must be more "
            "similar, so negate them"
        )


def _check_same_shape(names: Sequence[str], matrices: Sequence[NDArray[Any] | _Matrix]) -> None:
    for name, matrix in zip(names, matrices, strict=True):
        if matrix.shape != matrices[0].shape:
            raise ValueError(
                f"scores of technique {name!r} have shape {matrix.shape}, those of {names[0]!r} "
                f"{matrices[0].shape}; all need the same queries and references"
            )


def _seconds_in_order(names: Sequence[str], seconds: Mapping[str, float]) -> list[float]:
    declared = declared_seconds(seconds, names)
    for name in names:
        if name not in declared:
            raise ValueError(f"no seconds for technique {name!r}; give the seconds of one run")
    return [declared[name] for name in names]


def _matches_folder(directory: Path) -> Path:
    if not directory.is_dir():
        what = "is not a folder" if directory.exists() else "does not exist"
        raise FileNotFoundError(f"{directory} {what}; give the folder of VPR-Bench's matches")
    inner = directory / "precomputed_matches"
    folder = inner if inner.is_dir() else directory
    if not any(folder.glob(f"*/{VPRBENCH_MATCHES}")):
        raise FileNotFoundError(
            f"{directory} holds no TECHNIQUE/{VPRBENCH_MATCHES}; give the folder of VPR-Bench's "
            "matches"
        )
    return folder


def _read_matches(path: Path, trust: bool) -> tuple[NDArray[np.float32], float]:
    """Scores (Q, R) in the order of the query ids, and seconds of one run."""
    items = unpickle(path, trust)
    try:
        ids = np.asarray(items[0], dtype=np.int64)
        stored = np.asarray(list(items[3]), dtype=np.float64)
        _check_matrix(stored.shape, stored.dtype, path)
        scores = as_float32(stored)
        encode, match = (float(np.mean(np.asarray(items[at], np.float64))) for at in (4, 5))
    except (IndexError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is not laid out as VPR-Bench's matches are (query ids, best reference, best "
            f"score, score rows, encode seconds, match seconds): {error}"
        ) from None
    return scores[order_of(ids, len(scores), path)], encode + scores.shape[1] * match
