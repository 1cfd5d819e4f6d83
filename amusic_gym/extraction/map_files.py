"""A described map's folder: ``map.json``, descriptors, thumbnails and positions."""

import json
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks import bank_files
from amusic_gym.banks.bank_files import checksum, parse_manifest, size_and_checksum, write_floats
from amusic_gym.extraction.blocks import BLOCK, Stored, array_of
from amusic_gym.extraction.thumbnails import Thumbnails
from amusic_gym.routes.positions import Positions
from amusic_gym.techniques.protocol import Descriptor
from amusic_gym.utils import reading, storage

FORMAT_VERSION = 1
MANIFEST, THUMBNAILS, ENDS, POSITIONS = "map.json", "thumbnails.npy", "ends.npy", "positions.npy"
MOST_TECHNIQUES = 64

_REBUILD = "copy the map again or build it anew with amusic map build"
_MOST_MANIFEST = 2**28  # bytes: it holds a name for each place


def _descriptors(number: int) -> str:
    return f"descriptors-{number}.npy"


FILES = frozenset(
    {MANIFEST, THUMBNAILS, ENDS, POSITIONS, *map(_descriptors, range(MOST_TECHNIQUES))}
)


@dataclass(frozen=True)
class DescribedBy:
    """What a technique's descriptors in a map depend on, and what a run cost where it was made."""

    spec: str  # as `make_technique` takes it
    weights: str | None  # the file that it was given; None: what ships, or none
    seconds: float  # of one run against the whole map
    identity: Mapping[str, Any]  # see :func:`amusic_gym.extraction.code.identity`

    @property
    def name(self) -> str:
        """The technique's."""
        return str(self.identity["name"])


@dataclass(frozen=True)
class MapContents:
    """All that a map's folder holds; arrays of descriptors stay on disk."""

    name: str  # of the map
    techniques: Sequence[DescribedBy]  # T of them
    # of each technique, its blocks of up to ``BLOCK`` places
    descriptors: Sequence[Sequence[Stored | Descriptor]]
    thumbnails: Thumbnails  # R of them
    names: Sequence[str]  # R names of images
    parts: Sequence[int]  # lengths of the traverses that the map is joined of
    positions: Positions | None  # R of them; None where they are not known
    digest: str = ""  # of all that; "" before it is written


def check_destination(path: Path) -> None:
    """Refuse a path that :func:`write` would refuse, before long work is begun for it."""
    path = Path(os.path.realpath(path))
    storage.refuse_to_replace_others(path, MANIFEST, FILES)
    bank_files.refuse_within_bank(path)


def write(path: Path, contents: MapContents) -> None:
    """Write a map's folder, whole or not at all; descriptors are copied block by block.

    Raises:
        ValueError: when ``path`` is something other than a map.
        OSError: when writing fails; what was at ``path`` is still there then.
    """
    check_destination(path)
    with storage.replacing_folder(Path(os.path.realpath(path)), MANIFEST, FILES) as folder:
        for number, blocks in enumerate(contents.descriptors):
            shape = (len(contents.names), *blocks[0].shape[1:])
            write_floats(folder / _descriptors(number), map(array_of, blocks), shape)
        np.save(folder / THUMBNAILS, contents.thumbnails.data)
        np.save(folder / ENDS, contents.thumbnails.ends)
        if contents.positions is not None:
            np.save(folder / POSITIONS, _columns(contents.positions))
        manifest = {
            "format_version": FORMAT_VERSION,
            "name": contents.name,
            "techniques": [vars(each) for each in contents.techniques],
            "parts": list(contents.parts),
            "names": list(contents.names),
            "positions": _described(contents.positions),
            "files": {file.name: size_and_checksum(file) for file in sorted(folder.iterdir())},
        }
        manifest["sha256"] = checksum(manifest)
        text = json.dumps(manifest, indent=1, ensure_ascii=False) + "\n"
        (folder / MANIFEST).write_text(text, encoding="utf-8")


def read(path: Path, *, verify: bool) -> MapContents:
    """What a map's folder holds, checked to agree; descriptors are not read.

    ``verify`` compares the checksums of all files, too, which reads them.

    Raises:
        FileNotFoundError: when the folder or a file in it is missing.
        ValueError: when it is damaged or from a newer format.
    """
    if not path.is_dir():
        what = "is a file; give the folder of a map" if path.exists() else "does not exist"
        raise (ValueError if path.exists() else FileNotFoundError)(f"{path} {what}")
    try:
        content = reading.read_regular(path / MANIFEST, _MOST_MANIFEST)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path} has no {MANIFEST}, so it is no map; {_REBUILD}") from None
    manifest = parse_manifest(content, path / MANIFEST, "map", FORMAT_VERSION, _REBUILD)
    try:
        return _read(path, manifest, verify)
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"{path / MANIFEST} lacks an entry ({error!r}); {_REBUILD}") from None


def _read(path: Path, manifest: Mapping[str, Any], verify: bool) -> MapContents:
    for name, told in manifest["files"].items():
        with reading.open_file(path / name) as file:
            size = os.fstat(file.fileno()).st_size
            if size != told["bytes"] or (verify and reading.sha256(file) != told["sha256"]):
                raise ValueError(f"{path / name} is damaged: its checksum differs; {_REBUILD}")
    techniques = [DescribedBy(**each) for each in manifest["techniques"]]
    names = manifest["names"]
    descriptors = [_blocks(path / _descriptors(t), len(names)) for t in range(len(techniques))]
    images = Thumbnails(path, *(reading.read_array(path / each) for each in (THUMBNAILS, ENDS)))
    if sum(manifest["parts"]) != len(names) or len(images) != len(names):
        raise ValueError(f"{path}: its files are of another number of places; {_REBUILD}")
    positions = None
    if (found := manifest["positions"]) is not None:
        columns = reading.read_array(path / POSITIONS)
        headings = columns[:, -1] if found["headings"] else None
        metres = columns[:, :-1] if found["headings"] else columns
        zones = {zone: str(path) for zone in found["zones"]}
        positions = Positions(metres, found["system"], headings, zones, str(path))
    about = (manifest["name"], techniques, descriptors, images, names, manifest["parts"])
    return MapContents(*about, positions, manifest["sha256"])


def _blocks(path: Path, places: int) -> list[Stored]:
    with reading.open_file(path) as file:
        header = reading.read_npy_header(file, path)
    if header.dtype != np.dtype("<f4") or header.fortran_order or header.shape[:1] != (places,):
        raise ValueError(f"{path} holds {header.dtype} of shape {header.shape}; {_REBUILD}")
    of_one = header.shape[1:]
    size = 4 * int(np.prod(of_one))
    return [
        Stored(path, header.offset + first * size, (min(BLOCK, places - first), *of_one))
        for first in range(0, places, BLOCK)
    ]


def _columns(positions: Positions) -> NDArray[np.float64]:
    """(R, D), or (R, D + 1) with the headings last."""
    if positions.headings is None:
        return positions.metres
    return np.column_stack([positions.metres, positions.headings])


def _described(positions: Positions | None) -> dict[str, Any] | None:
    if positions is None:
        return None
    return {
        "system": positions.system,
        "headings": positions.headings is not None,
        "zones": sorted(positions.zones),
    }


def joined(blocks: Iterable[Iterable[Stored | Descriptor]]) -> list[Descriptor]:
    """The blocks of several traverses as those of one, of ``BLOCK`` places each but the last."""
    arrays = [array_of(block) for traverse in blocks for block in traverse]
    whole = np.concatenate(arrays)
    return [whole[first : first + BLOCK] for first in range(0, len(whole), BLOCK)]
