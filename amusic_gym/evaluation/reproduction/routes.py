"""The paper's data sets as banks, and what of them differs from the paper's."""

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.extraction import extract
from amusic_gym.routes.datasets import DATASETS, LoadedRoute, load_dataset
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.techniques import Technique

ONE_DRIVE = "one_drive"  # name of the data sets joined
SMALL = 100  # images with a side of fewer pixels are not the paper's


def load(name: str, root: str | os.PathLike[str]) -> tuple[LoadedRoute, list[str]]:
    """A data set and what differs from the paper's.

    Of a folder with more images than the paper took, as many at even distances, from the first on.

    Raises:
        FileNotFoundError: when a folder is not there.
        ValueError: for folders that do not match.
    """
    dataset = DATASETS[name]
    folders = [Path(root) / folder for folder in dataset.reference]
    count = sum(len(ImageFolder(folder)) for folder in folders if folder.is_dir())
    if count > dataset.images and len(folders) == 1:
        step = count // dataset.images
        found = load_dataset(name, root, first=0, step=step)
        remarks = [f"{dataset.images} of {count} images, one in {step} from the first on"]
    else:
        found = load_dataset(name, root, images=count or None)
        few = f"{count} images, the paper took {dataset.images}"
        remarks = [few] if count != dataset.images else []
    height, width = found.reference[0].shape[:2]
    if min(height, width) < SMALL:
        remarks.append(f"images of {width}×{height} pixels")
    return found, remarks


def joined(parts: Sequence[LoadedRoute]) -> LoadedRoute:
    """Data sets one after the other on one map, driven in one go.

    Figure 7 and the words on it suggest such a drive: "when entering the Fall sequence". Where two
    have the same reference, as Winter and Fall do, the map shows its places twice, and both are
    true.
    """
    begins = np.cumsum([0, *(len(part.reference) for part in parts)]).tolist()
    true = []
    for part in parts:
        twins = [
            begin
            for begin, other in zip(begins, parts, strict=False)
            if other.reference.paths == part.reference.paths
        ]
        truth = part.ground_truth
        true += [
            np.concatenate([places + begin for begin in twins])
            for places in np.split(truth.places, truth.indptr[1:-1])
        ]
    truth = GroundTruth.from_lists(true, begins[-1])
    return LoadedRoute(
        ImageFolder.join(part.reference for part in parts),
        ImageFolder.join(part.query for part in parts),
        truth,
        truth.half_run(),
        ONE_DRIVE,
    )


def extracted(
    found: LoadedRoute,
    out: Path,
    techniques: Sequence[Technique],
    cache: str | os.PathLike[str] | None,
    executor: str,
) -> ScoreBank:
    """A data set's scores, extracted to ``out`` / its name; see `extract`."""
    return extract(
        found.reference,
        found.query,
        techniques,
        tolerance=found.tolerance,
        ground_truth=found.ground_truth,
        cache=cache,
        executor=executor,
        out=out / found.name,
        name=found.name,
        progress=True,
    )
