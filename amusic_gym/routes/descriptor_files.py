"""Descriptors that were computed elsewhere, brought into the order of a traverse.

Which layouts are read, and what each says of the order of its rows, is in docs/datasets.md.
"""

import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path, PurePosixPath

from amusic_gym.banks import descriptors
from amusic_gym.banks.descriptors import H5_SUFFIXES, Descriptors
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import SUFFIXES
from amusic_gym.routes.numbering import HOW, arranged
from amusic_gym.utils.reading import open_file, read_array, read_lines

SORTED = {"reference": "database_descriptors.npy", "query": "queries_descriptors.npy"}
"""Files of VPR-methods-evaluation, whose rows are in the string order of the images' paths."""

PATCH_NETVLAD = "globalfeats.npy"

_Path = str | os.PathLike[str]


def read_traverse(path: _Path, order: _Path | None = None) -> ImageFolder:
    """A traverse of a folder of images, or of a list of their names.

    Args:
        path: the folder; or a text file with a name on each line, or a .npy of names (GSV-Cities'
            ``*_dbImages.npy``), in the order of the route. The images of a list need not be there.
        order: of a folder; see `ImageFolder`.

    Raises:
        FileNotFoundError: when there is no such file or folder.
        ValueError: for a list without names or with one twice; as `ImageFolder`.
    """
    path = Path(path)
    if path.is_dir() or not path.exists():
        return ImageFolder(path, order=order)
    if order is not None:
        raise ValueError(f"{path} is a list and gives the order itself; leave --order out")
    if path.suffix.lower() == ".npy":
        array = read_array(path)
        if array.ndim != 1 or array.dtype.kind not in "US":
            raise ValueError(
                f"{path} has shape {array.shape} and dtype {array.dtype}; give a list of names"
            )
        return named(path, array.astype(str).tolist())
    return named(path, read_lines(path))


def named(path: Path, names: Sequence[str]) -> ImageFolder:
    """A traverse of which only the names of the images are known, each once."""
    if not names or len(set(names)) < len(names):
        what = "names an image twice" if names else "names no image"
        raise ValueError(f"{path} {what}; give each image's name once")
    made = object.__new__(ImageFolder)
    paths = tuple(path / name.lstrip("/") for name in names)
    vars(made).update(path=path, paths=paths, parts=(len(names),))
    return made


def read_descriptors(path: _Path, images: ImageFolder | None, side: str) -> Descriptors:
    """The descriptors of a traverse, one for each image, in its order.

    Args:
        path: a file or folder of one of the layouts; below an HDF5 file, a group: FILE.h5/GROUP.
        images: the traverse; None: the natural order of the names in the file, or, without names,
            the order of its rows.
        side: "reference" or "query", for a folder that holds both.

    Raises:
        FileNotFoundError: when there is no such file or folder.
        ValueError: for another layout; where images lack a descriptor, rows lack an image, or the
            order of the rows cannot be known.
    """
    source, by_path = _open(Path(path), side)
    if images is None:
        if by_path:
            raise ValueError(
                f"{source.source} has its rows in the string order of the images' paths (img10"
                f" before img2), not in that of the route; give --{side}-images DIR or a list of"
                " the names"
            )
        if source.names is None:
            return source
        try:
            return source.take(arranged([PurePosixPath(name) for name in source.names]))
        except ValueError as error:
            told = str(error).replace(HOW, f"give the order as --{side}-images LIST")
            raise ValueError(f"{source.source}: {told}") from None
    names = source.names or _row_names(source, images, by_path)
    return source.take(_matched(images, names, source.source))


def _open(path: Path, side: str) -> tuple[Descriptors, bool]:
    """What lies there, and whether its rows are in the string order of the images' paths."""
    if path.is_dir():
        for name in (SORTED[side], PATCH_NETVLAD):
            if (path / name).is_file():
                return _open(path / name, side)
        files = sorted(path.rglob("*.npy"))
        if not files or (path / SORTED["query" if side == "reference" else "reference"]).is_file():
            raise FileNotFoundError(
                f"{path} holds no descriptors of the {side}; give a folder with {SORTED[side]},"
                f" {PATCH_NETVLAD}, or a .npy file for each image"
            )
        return descriptors.from_npy_files(path, files), False
    for file in (path, *path.parents):
        if file.suffix.lower() in H5_SUFFIXES and file.is_file():
            group = path.relative_to(file).as_posix()
            return descriptors.from_h5(file, "" if group == "." else group), False
    open_file(path).close()
    if path.suffix.lower() != ".npy":
        raise ValueError(
            f"{path} is no file of descriptors that can be read; give .npy, "
            f"{', '.join(H5_SUFFIXES)} or a folder of .npy files"
        )
    return descriptors.from_npy(path), path.name in SORTED.values()


def _row_names(source: Descriptors, images: ImageFolder, by_path: bool) -> Sequence[str]:
    """The image of each row of a file that names none."""
    names = (images.complete or images).names
    beside = Path(f"{os.fspath(images.path)}_images_paths.txt")
    listed = images.path.is_file() and images.path.suffix.lower() not in H5_SUFFIXES
    if by_path and not listed:
        names = tuple(read_lines(beside) if beside.is_file() else sorted(names))
    elif not listed and list(names) != sorted(names):
        first = next(name for name, other in zip(names, sorted(names), strict=True) if name > other)
        raise ValueError(
            f"{source.source} names no images, and those of {images.path} are in another order by"
            f" number than by letters (see {first}): which one do its rows have? Give a list of"
            " the names in the order of the rows in place of the folder"
        )
    if len(source) != len(names):
        raise ValueError(
            f"{source.source} has {len(source)} descriptors for the {len(names)} images of"
            f" {images.path}; give those of the same images"
        )
    return names


def _matched(images: ImageFolder, rows: Sequence[str], source: str) -> list[int]:
    """The row of each image: by its path, also below a folder that only one side knows."""
    names, whole = images.names, f"{images.path.absolute().as_posix()}/"
    for stems, below in product((False, True), repeat=2):
        wanted = [_stem(name) if stems else name for name in names]
        known = {_stem(row) if stems else row: at for at, row in enumerate(rows)}
        if len(known) < len(rows):
            continue
        if below:  # the images' own folder is not in the rows' names
            folder = os.path.commonpath([os.path.dirname(name) for name in wanted])
            wanted = [os.path.relpath(name, folder) for name in wanted] if folder else wanted
        first = f"/{wanted[0]}"
        heads = {row[: 1 - len(first)] for row in known if f"/{row}".endswith(first)}
        fits = [head for head in sorted(heads) if all(head + name in known for name in wanted)]
        if len(fits) > 1:  # both traverses in one file, with the same names
            fits = [head for head in fits if whole.endswith(f"/{head}")] or fits
        if len(fits) > 1:
            raise ValueError(
                f"{source}: {names[0]!r} may be {fits[0] + wanted[0]!r} or"
                f" {fits[1] + wanted[0]!r}; give the group, FILE.h5/{fits[0].rstrip('/')}, or a"
                " list of full names"
            )
        if fits:
            return [known[fits[0] + name] for name in wanted]
    held = {PurePosixPath(_stem(row)).name for row in rows}
    missing = [name for name in names if PurePosixPath(_stem(name)).name not in held]
    raise ValueError(
        f"{source} has no descriptor of {len(missing) or len(names)} of the {len(names)} images,"
        f" such as {(missing or list(names))[0]!r} (it has one of {rows[0]!r}); give those of the"
        " same images"
    )


def _stem(name: str) -> str:
    """A name without the suffix of an image."""
    head, suffix = os.path.splitext(name)
    return head if suffix.lower() in SUFFIXES else name
