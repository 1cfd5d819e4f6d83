"""Tours: image routes one after the other on one map, driven in one go under changing conditions.

The map is all references end to end, the run all queries. Frame q is at place q, part by part. The
references stay as they are; the query's conditions change every 40 to 80 frames. Which technique is
any good changes with the conditions: that is what a selector is for.

Nothing is decoded before it is asked for, and a condition is applied when its image is read, so a
tour takes no more memory than its file names.
"""

import json
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.routes.conditions import CONDITIONS, Change, Condition
from amusic_gym.routes.folders import Folder, ImageFolder, folder_of
from amusic_gym.routes.image_truth import by_index
from amusic_gym.routes.route_model import no_repeats
from amusic_gym.utils import storage
from amusic_gym.utils.checks import whole

SHORTEST, LONGEST = 40, 80  # frames of a spell; the last one ends with the tour and may be shorter
SPELLS = "segments.json"  # file of the spells in a folder of `write_tour`
REFERENCE, QUERY = "reference", "query"  # folders of the images in a folder of `write_tour`


@dataclass(frozen=True)
class Spell:
    """Some frames under one condition."""

    first: int  # number of the first frame; the spell ends where the next begins
    condition: Condition  # of all of them

    def __str__(self) -> str:
        return f"{self.first} {self.condition}"


@dataclass(frozen=True)
class Tour:
    """One drive along several image routes; see `make_tour`."""

    reference: ImageFolder  # the map, R images
    query: ImageFolder  # the run, as many; ``query[q]`` reads image q and applies its condition
    spells: tuple[Spell, ...]  # in rising order; the first begins at frame 0
    seed: int  # of the spells and of all that the conditions draw
    names: tuple[str, ...] = field(repr=False)  # of each part, its folders

    def ground_truth(self, tolerance: int) -> GroundTruth:
        """Frame q is at place q, ± ``tolerance`` places (>= 0), but never in another part."""
        return by_index(self.reference, self.query, tolerance)

    @property
    def source(self) -> str:
        """For a bank: the parts, the seed and the spells, which :func:`spells_in` reads again."""
        spells = ", ".join(map(str, self.spells))
        return f"tour: {', '.join(self.names)}; seed {self.seed}; spells: {spells}"


def make_tour(
    parts: Sequence[tuple[Folder, Folder]],
    conditions: Sequence[Condition | str] = tuple(CONDITIONS),
    *,
    seed: int = 0,
) -> Tour:
    """Join image routes into one drive.

    Spells of 40 to 80 frames follow each other, whatever part they are in. The conditions come in
    random order, each of them once before one comes back, and never one twice running.

    Args:
        parts: (reference, query) of each: folders, or `ImageFolder`, with as many images in the one
            as in the other.
        conditions: of the query, as `Condition.parse` takes them; one that is given twice counts
            once.
        seed: whole number >= 0, for the spells and for all that the conditions draw.

    Raises:
        FileNotFoundError: for a folder that is not there.
        ValueError: for no part, or one whose two folders differ in length; for no condition, or an
            unknown one; for a seed that is none.
    """
    seed = whole("seed", seed, 0)
    chosen = _conditions(conditions)
    if not parts:
        raise ValueError("a tour has no part; give at least one reference and query")
    folders = [tuple(map(folder_of, part)) for part in parts]
    for number, (reference, query) in enumerate(folders, 1):
        if len(reference) != len(query):
            raise ValueError(
                f"part {number} of the tour has {len(reference)} images in {reference.path} and "
                f"{len(query)} in {query.path}, so frame q cannot be at place q; give folders "
                "with as many images each"
            )
    joined = ImageFolder.join(query for _, query in folders)
    spells = _spells(len(joined), chosen, np.random.default_rng(seed))
    return Tour(
        reference=ImageFolder.join(reference for reference, _ in folders),
        query=joined.under(_changes(spells, len(joined), seed)),
        spells=spells,
        seed=seed,
        names=tuple(f"{q.path.name} on {r.path.name}" for r, q in folders),
    )


def spells_in(source: str) -> tuple[Spell, ...]:
    """The spells of the tour that a bank was made of, from its ``source``; refuses any other.

    Of a re-timed bank they are those of the recording.
    """
    found = re.search(r"\btour: .*; spells: (0 .+)", source)
    if found is None:
        raise ValueError(f"source {source[:80]!r} is not that of a tour; give a tour's bank")
    pairs = [text.split(" ") for text in found[1].split(", ")]
    return tuple(Spell(int(first), Condition.parse(text)) for first, text in pairs)


def check_destination(out: str | os.PathLike[str]) -> None:
    """Refuse a folder that :func:`write_tour` would refuse, before long work is begun."""
    storage.refuse_to_replace_others(Path(os.path.realpath(out)), SPELLS, _WRITTEN)


def write_tour(
    tour: Tour, out: str | os.PathLike[str], progress: Callable[[int], object] | None = None
) -> Path:
    """Write a tour's images as two folders to look at: ``reference/``, ``query/``.

    They are PNG files, without loss, so scores extracted from them are those of the tour.
    ``segments.json`` beside them holds [first frame, condition] of every spell.

    Args:
        tour: the tour.
        out: the folder to make, whole or not at all; a tour that was written there is replaced.
        progress: called with the number of images done since the last call.

    Returns:
        The folder's absolute path.

    Raises:
        ValueError: when ``out`` holds something else, or an image cannot be read.
        OSError: when writing fails.
    """
    import cv2

    out = Path(os.path.realpath(out))
    digits = max(4, len(str(len(tour.query) - 1)))
    with storage.replacing_folder(out, SPELLS, _WRITTEN) as folder:
        for name, images in ((REFERENCE, tour.reference), (QUERY, tour.query)):
            (folder / name).mkdir()
            for number, image in enumerate(images):
                good, data = cv2.imencode(".png", image)
                if not good:
                    raise ValueError(f"{images.paths[number]} cannot be written as PNG; convert it")
                (folder / name / f"{number:0{digits}d}.png").write_bytes(data.tobytes())
                if progress is not None:
                    progress(1)
        spells = [[spell.first, str(spell.condition)] for spell in tour.spells]
        (folder / SPELLS).write_text(json.dumps(spells, indent=1) + "\n", encoding="utf-8")
    return out


_WRITTEN = frozenset((REFERENCE, QUERY, SPELLS))


def _conditions(given: Sequence[Condition | str]) -> list[Condition]:
    if isinstance(given, str):
        raise ValueError(f"conditions is the text {given!r}; give a list, as [{given!r}]")
    chosen = [each if isinstance(each, Condition) else Condition.parse(each) for each in given]
    if not chosen:
        raise ValueError(f"no condition; give some of {', '.join(CONDITIONS)}")
    return list(dict.fromkeys(chosen))


def _spells(
    frames: int, conditions: Sequence[Condition], rng: np.random.Generator
) -> tuple[Spell, ...]:
    firsts = [0]
    while (following := firsts[-1] + int(rng.integers(SHORTEST, LONGEST + 1))) < frames:
        firsts.append(following)
    order = no_repeats(rng, len(firsts), len(conditions)).tolist()
    return tuple(Spell(first, conditions[at]) for first, at in zip(firsts, order, strict=True))


def _changes(spells: Sequence[Spell], frames: int, seed: int) -> list[Change | None]:
    changes: list[Change | None] = []
    for spell, end in zip(spells, [*(spell.first for spell in spells[1:]), frames], strict=True):
        plain = not spell.condition.parts
        changes += [
            None if plain else Change(spell.condition, seed, frame)
            for frame in range(spell.first, end)
        ]
    return changes
