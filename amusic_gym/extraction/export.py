"""Descriptors of techniques that run here, for others: hloc's file of features, and its pairs."""

import os
from pathlib import Path

import numpy as np

from amusic_gym.banks.descriptors import H5_KEY, DescriptorPair, from_h5
from amusic_gym.banks.ranking import TOP, highest
from amusic_gym.extraction.cache import Cache, opened
from amusic_gym.extraction.code import describes_queries_alike
from amusic_gym.extraction.describe import ExtractionPlan, describe, images_of
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.progress import Progress
from amusic_gym.routes.folders import ImageFolder, check_apart
from amusic_gym.routes.image_headers import measure
from amusic_gym.routes.images import read_bytes
from amusic_gym.techniques import Technique
from amusic_gym.utils.checks import whole
from amusic_gym.utils.optional import optional
from amusic_gym.utils.storage import replacing_file, write_whole


def save_descriptors(
    out: str | os.PathLike[str],
    technique: Technique,
    reference: ImageFolder,
    query: ImageFolder | None = None,
    *,
    top: int = TOP,
    cache: str | os.PathLike[str] | Cache | None = None,
    executor: str = "serial",
    progress: bool = False,
) -> tuple[Path, Path]:
    """Write the descriptors of two traverses as hloc does, and the pairs of most similar images.

    ``NAME.h5`` has a group for each image, by its path from the folder that holds both traverses,
    with ``global_descriptor`` (D,) float32 and ``image_size`` (width, height) as stored.
    ``NAME-pairs.txt`` has a line for each pair, the query first, the best place first.

    Args:
        out: the folder to write to; made if it is not there.
        technique: one that matches by the dot product of one vector of each image.
        reference: the map.
        query: the run; None: pairs are of the map's own images, each with others.
        top: pairs per query.
        cache: the cache's folder, or an open cache; None: the default one.
        executor: see :func:`amusic_gym.extraction.executors.make_executor`.
        progress: show bars on a terminal.

    Returns:
        The two files.

    Raises:
        FileNotFoundError: for an image that is not there.
        ValueError: without h5py; for a technique that matches otherwise; for an image that cannot
            be read or described.
        OSError: when a file cannot be written.
    """
    h5py = optional("h5py", "hloc's file of features", "the package h5py", "hdf5")
    whole("top", top, 1)
    _check_global(technique, alone=query is None)
    check_apart(reference, query)
    sides = [reference] if query is None else [reference, query]
    root = os.path.commonpath([os.path.abspath(side.path) for side in sides])
    images = [images_of(side) for side in sides]
    names = [[os.path.relpath(path, root) for path in each.paths] for each in images]
    plan = ExtractionPlan(technique, images[0], images[-1])
    features = Path(out) / f"{technique.name}.h5"
    with (
        opened(cache) as store,
        make_executor(executor) as where,
        where.workers(technique) as workers,
        replacing_file(features) as temporary,  # which is locked by that
        h5py.File(temporary, "w", locking=False) as file,
    ):
        for side, each in enumerate(images):
            blocks = describe(plan, store, workers, Progress(progress), query=side == 1)
            rows = (row for block in blocks for row in block.array())
            for label, path, row in zip(names[side], each.paths, rows, strict=True):
                group = file.create_group(label)
                group[H5_KEY] = row.ravel()
                group["image_size"] = np.array(measure(read_bytes(path)))
    found = from_h5(features)
    at = {label: row for row, label in enumerate(found.names or ())}
    places, frames = (found.take([at[label] for label in names[side]]) for side in (0, -1))
    lines, frame = [], 0
    for block in DescriptorPair(technique.name, places, frames, "dot").score_rows():
        for row in block:
            if query is None:
                row[frame] = -np.inf
            lines += [f"{names[-1][frame]} {names[0][place]}" for place in highest(row, top)]
            frame += 1
    pairs = Path(out) / f"{technique.name}-pairs.txt"
    return features, write_whole(pairs, "\n".join(lines).encode())


def _check_global(technique: Technique, alone: bool) -> None:
    """Refuse a technique whose scores are no dot products of one vector per image."""
    if type(technique).match is not Technique.match:
        how = "otherwise than by a dot product"
    elif alone and not describes_queries_alike(technique):
        how = "that are described as places with others that are described as queries"
    else:
        return
    raise ValueError(
        f"technique {technique.name!r} matches images {how}, which one global descriptor for each"
        " cannot tell; take another technique"
    )
