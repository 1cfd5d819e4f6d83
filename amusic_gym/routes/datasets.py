"""The six data sets of the paper (A-MuSIC, table I and section IV-A), by name.

None of them is downloaded: docs/datasets.md says where each is to be had and how to lay it out.
Another one is one more entry in ``DATASETS``.
"""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.image_truth import by_index
from amusic_gym.routes.positions import Positions
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest


@dataclass(frozen=True)
class Dataset:
    """A route that was travelled twice."""

    reference: tuple[str, ...]  # folders of the map, from the data sets' root, joined in this order
    query: tuple[str, ...]  # folders of the run, as many
    images: int  # of each traverse in the paper
    condition: str  # what differs between the traverses
    source: str  # the part of a sentence that follows "get it from"
    tolerance: int = 1  # places to either side of the true one that count as right


@dataclass(frozen=True)
class LoadedRoute:
    """Two traverses that were found on disk, and what is true: what extraction needs."""

    reference: ImageFolder  # the map, R images
    query: ImageFolder  # the run, Q images
    ground_truth: GroundTruth
    tolerance: int | None  # places; None: as the ground truth lists them
    name: str = ""
    positions: tuple[Positions, Positions] | None = None  # of the map and of the run, where known


_NORDLAND = "NRK's video of the Nordland railway, one of its frame sets"
_DOCS = "docs/datasets.md has the addresses"

DATASETS = {
    "nordland_winter": Dataset(
        reference=("nordland/summer",),
        query=("nordland/winter",),
        images=1000,
        condition="extreme seasonal",
        source=_NORDLAND,
    ),
    "nordland_fall": Dataset(
        reference=("nordland/summer",),
        query=("nordland/fall",),
        images=1000,
        condition="moderate seasonal",
        source=_NORDLAND,
    ),
    "berlin": Dataset(
        reference=("berlin/halenseestrasse-2", "berlin/kudamm-1", "berlin/A100-1"),
        query=("berlin/halenseestrasse-1", "berlin/kudamm-2", "berlin/A100-2"),
        images=250,
        condition="strong viewpoint",
        source="the repository Ahmedest61/CNN-Region-VLAD-VPR on GitHub (images of Mapillary)",
    ),
    "night_right": Dataset(
        reference=("gardens_point/day_left",),
        query=("gardens_point/night_right",),
        images=200,
        condition="outdoor illumination; lateral shift",
        source="Zenodo, record 4590133 (Gardens Point Walking)",
    ),
    "st_lucia": Dataset(
        reference=("st_lucia/afternoon",),
        query=("st_lucia/morning",),
        images=1100,
        condition="daylight; dynamic elements",
        source="the wiki of arrenglover/openfabmap on GitHub (St Lucia Multiple Times of Day)",
    ),
    "17_places": Dataset(
        reference=("17_places/day",),
        query=("17_places/night",),
        images=2000,
        tolerance=10,
        condition="indoor illumination",
        source="Raghavender Sahdev's page of the 17 Places data set",
    ),
}
"""Name → data set."""


def load_dataset(
    name: str,
    root: str | os.PathLike[str],
    *,
    images: int | None = None,
    first: int | None = None,
    step: int = 1,
) -> LoadedRoute:
    """The two traverses of a data set, checked, with what is true.

    A folder must hold exactly as many images as the paper used, because the paper does not say
    which ones: take them by ``first`` and ``step``, or put only those into the folder that you
    want.

    Args:
        name: one of ``DATASETS``.
        root: the folder that holds the data sets' folders.
        images: another number of images than the paper's.
        first: index of the first image to take, of data sets that are one folder per traverse.
            None: all, which must be ``images``.
        step: with ``first``: take each ``step``-th from there.

    Raises:
        FileNotFoundError: when a folder is not there.
        ValueError: for an unknown name, another number of images, or parts that do not match.
    """
    if name not in DATASETS:
        inside = [each for each in DATASETS if DATASETS[each].reference[0].startswith(f"{name}/")]
        if inside:
            raise ValueError(f"{name!r} is a folder; the data set in it is {' or '.join(inside)}")
        raise ValueError(suggest("data set", name, DATASETS))
    dataset = DATASETS[name]
    number = dataset.images if images is None else whole("images", images, 1)
    if first is None and whole("step", step, 1) != 1:
        raise ValueError(
            f"step is {step!r} without first; give first=0 (--first 0), or another start"
        )
    if first is not None and len(dataset.reference) > 1:
        raise ValueError(f"first is {first!r}, but {name} joins several folders; leave it out")
    part: dict[str, Any] = {} if first is None else {"first": first, "step": step, "count": number}
    traverses = []
    for folders in (dataset.reference, dataset.query):
        paths = [Path(root) / folder for folder in folders]
        for path in paths:
            if not path.is_dir():
                raise FileNotFoundError(f"{path} does not exist. {_needs(name, root, number)}")
        found = ImageFolder.join(ImageFolder(path, **part) for path in paths)
        if len(found) != number:
            whose = "the paper used" if images is None else "you asked for"
            raise ValueError(
                f"{', '.join(map(str, paths))}: {len(found)} images, but {whose} {number}; pass "
                f"images={len(found)} (--images {len(found)}) to take all, or first and step "
                f"(--first, --step) to take {number} of one folder. {_needs(name, root, number)}"
            )
        traverses.append(found)
    reference, query = traverses
    truth = by_index(reference, query, dataset.tolerance)
    return LoadedRoute(reference, query, truth, dataset.tolerance, name)


def _needs(name: str, root: str | os.PathLike[str], images: int) -> str:
    """The layout of a data set, and its source."""
    dataset = DATASETS[name]
    reference, query = (" + ".join(side) for side in (dataset.reference, dataset.query))
    return (
        f"{name} needs below {os.fspath(root)}: {images} images in {reference} and as many in "
        f"{query}, in the same order; get it from {dataset.source}: {_DOCS}"
    )
