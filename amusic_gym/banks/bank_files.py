"""A score bank's folder: ``scores.npy``, ``ground_truth.npz`` and ``bank.json``."""

import hashlib
import json
import math
import os
import zipfile
from collections.abc import Iterable, Sequence
from io import BufferedReader, BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.ground_truth import GroundTruth, check_tolerance
from amusic_gym.utils import reading, storage
from amusic_gym.utils.checks import number, whole

FORMAT_VERSION = 1
MANIFEST, SCORES, TRUTH = "bank.json", "scores.npy", "ground_truth.npz"
IMAGES = "images.json"  # of banks that were made of images, for who looks at them

FILES = frozenset((MANIFEST, SCORES, TRUTH, IMAGES))
_MOST_MANIFEST, _MOST_HEADERS = 2**24, 2**16  # bytes; of ground_truth.npz beside its numbers
_REBUILD = "copy the bank again or build it anew with amusic bank"


def write(
    path: Path,
    *,
    scores: Iterable[NDArray[np.float32]],
    truth: GroundTruth,
    techniques: Sequence[tuple[str, float]],
    tolerance: int,
    name: str,
    source: str,
    costs: str,
) -> None:
    """Write a bank's folder, whole or not at all; arguments as of `ScoreBank.from_rows`.

    Each matrix of ``scores`` is written as it comes, so that memory need not hold them all.

    Raises:
        ValueError: when ``path`` is something other than a bank or in one, or rows are missing.
        OSError: when writing fails; what was at ``path`` is still there then.
    """
    path = Path(os.path.realpath(path))
    check_destination(path)
    with storage.replacing_folder(path, MANIFEST, FILES) as folder:
        shape = (len(techniques), truth.queries, truth.references)
        write_floats(folder / SCORES, scores, shape)
        np.savez(
            folder / TRUTH,
            indptr=truth.indptr,
            places=truth.places,
            references=np.int64(truth.references),
        )
        manifest: dict[str, Any] = {
            "format_version": FORMAT_VERSION,
            "name": name,
            "source": source,
            "techniques": [{"name": each, "seconds": seconds} for each, seconds in techniques],
            "costs": costs,
            "tolerance": tolerance,
            "queries": truth.queries,
            "references": truth.references,
            "files": {file: size_and_checksum(folder / file) for file in (SCORES, TRUTH)},
        }
        manifest["sha256"] = checksum(manifest)
        text = json.dumps(manifest, indent=2, ensure_ascii=False) + "\n"
        (folder / MANIFEST).write_text(text, encoding="utf-8")


def refuse_within_bank(path: Path) -> None:
    """Refuse to write to a bank's folder, or below it, anything but the bank."""
    path = Path(os.path.realpath(path))
    for folder in (path, *path.parents):
        if (folder / MANIFEST).is_file() and (folder / SCORES).is_file():
            raise ValueError(
                f"{path} is in the folder of a score bank ({folder}), which holds nothing else;"
                " give another place"
            )


def check_destination(path: Path) -> None:
    """Refuse a path that :func:`write` would refuse, before long work is begun for it.

    Raises:
        ValueError: when it is something other than a bank, which must not be replaced, or in one.
        OSError: when its folder cannot be made.
    """
    path = Path(os.path.realpath(path))
    storage.refuse_to_replace_others(path, MANIFEST, FILES)
    refuse_within_bank(path.parent)
    path.parent.mkdir(parents=True, exist_ok=True)


def read(path: Path, *, verify: bool) -> tuple[NDArray[np.float32], GroundTruth, dict[str, Any]]:
    """Scores (T, Q, R), memory-mapped, ground truth and manifest of a bank, checked to agree.

    ``verify`` compares the checksum of the scores, too, which reads them all.

    Raises:
        FileNotFoundError: when the folder or a file in it is missing.
        ValueError: when it is damaged or from a newer format.
    """
    return storage.read_whole(path, "bank", lambda folder: _read_once(path, folder, verify))


def _read_once(
    path: Path, folder: int, verify: bool
) -> tuple[NDArray[np.float32], GroundTruth, dict[str, Any]]:
    try:
        content = reading.read_regular(path / MANIFEST, _MOST_MANIFEST, folder)
    except FileNotFoundError:
        raise FileNotFoundError(
            f"{path} has no {MANIFEST}, so it is not a whole bank; {_REBUILD}"
        ) from None
    manifest = parse_manifest(content, path / MANIFEST, "bank", FORMAT_VERSION, _REBUILD)
    try:
        checksums = {name: str(manifest["files"][name]["sha256"]) for name in (SCORES, TRUTH)}
        for each in manifest["techniques"]:
            number("seconds", each["seconds"], "a number above 0")
            each["name"]
        queries, references = (whole(key, manifest[key], 1) for key in ("queries", "references"))
        check_tolerance(manifest["tolerance"])
        manifest |= {key: str(manifest[key]) for key in ("name", "source", "costs", "sha256")}
        shape = (len(manifest["techniques"]), queries, references)
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path / MANIFEST} lacks an entry or has a wrong one ({error}); {_REBUILD}"
        ) from None
    with reading.open_file(path / SCORES, folder) as file:
        scores = _map_scores(file, path / SCORES, shape)
        if verify:
            _compare(reading.sha256(file), path / SCORES, checksums[SCORES])
    most = 8 * (queries + 2 + queries * references) + _MOST_HEADERS
    content = reading.read_regular(path / TRUTH, most, folder)
    _compare(hashlib.sha256(content).hexdigest(), path / TRUTH, checksums[TRUTH])
    return scores, _read_truth(content, path / TRUTH, shape), manifest


def parse_manifest(
    content: bytes, path: Path, kind: str, most: int, rebuild: str
) -> dict[str, Any]:
    """The manifest of a folder, with a checksum of itself; refuses a damaged or a newer one."""
    manifest: dict[str, Any] = reading.parse_json(content, path, rebuild)
    version = manifest.get("format_version")
    if not isinstance(version, int) or version < 1:
        raise ValueError(f"{path} names no format version; {rebuild}")
    if version > most:
        raise ValueError(
            f"{kind} {path.parent} has format version {version}; it needs an amusic-gym that reads "
            f"version {version} (this one reads up to {most}): upgrade amusic-gym"
        )
    if manifest.get("sha256") != checksum(manifest):
        raise ValueError(f"{path} was damaged or edited: its checksum differs; {rebuild}")
    return manifest


def checksum(manifest: dict[str, Any]) -> str:
    """Digest of a manifest but for its own entry ``sha256``."""
    rest = {key: value for key, value in manifest.items() if key != "sha256"}
    return hashlib.sha256(json.dumps(rest, sort_keys=True).encode()).hexdigest()


def size_and_checksum(path: Path) -> dict[str, Any]:
    """What a manifest says of a file."""
    with path.open("rb") as file:
        return {"bytes": path.stat().st_size, "sha256": reading.sha256(file)}


def write_floats(path: Path, arrays: Iterable[NDArray[np.float32]], shape: tuple[int, ...]) -> None:
    """Write a .npy file of float32 from arrays that follow each other and must fill the shape."""
    header = {
        "descr": np.lib.format.dtype_to_descr(np.dtype("<f4")),
        "fortran_order": False,
        "shape": shape,
    }
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        begin = file.tell()
        for array in arrays:
            file.write(np.ascontiguousarray(array, "<f4").data.cast("B"))
        written = file.tell() - begin
    if written != 4 * math.prod(shape):
        raise ValueError(f"{written} bytes of numbers where shape {shape} needs others; give all")


def _map_scores(
    file: BufferedReader, path: Path, shape: tuple[int, int, int]
) -> NDArray[np.float32]:
    header = reading.read_npy_header(file, path)
    if header.dtype != np.dtype("<f4") or header.fortran_order:
        raise ValueError(
            f"{path} holds {header.dtype} where float32 in C order is expected "
            f"(pickled objects are never read); {_REBUILD}"
        )
    if header.shape != shape or 0 in shape:
        raise ValueError(
            f"{path} has shape {header.shape} where {MANIFEST} says {shape}; {_REBUILD}"
        )
    return np.memmap(file, header.dtype, "r", header.offset, header.shape).view(np.ndarray)


def _read_truth(content: bytes, path: Path, shape: tuple[int, int, int]) -> GroundTruth:
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in archive.infolist()):
                raise ValueError("compressed, which no bank's is")
        with np.load(BytesIO(content), allow_pickle=False) as arrays:
            truth = GroundTruth(arrays["indptr"], arrays["places"], arrays["references"].item())
    except Exception as error:  # a damaged zip raises nearly anything
        raise ValueError(f"{path} cannot be read ({error}); {_REBUILD}") from None
    if (truth.queries, truth.references) != shape[1:]:
        raise ValueError(
            f"{path} is for {truth.queries} queries and {truth.references} references where "
            f"{MANIFEST} says {shape[1:]}; {_REBUILD}"
        )
    return truth


def _compare(found: str, path: Path, checksum: str) -> None:
    if found != checksum:
        raise ValueError(f"{path} is damaged: its checksum differs; {_REBUILD}")
