"""The descriptors and scores of one technique, from the cache or computed."""

import os
import warnings
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import Images, Stored, check_shape
from amusic_gym.extraction.cache import Cache
from amusic_gym.extraction.code import describes_queries_alike, identity, key_of
from amusic_gym.extraction.progress import Progress
from amusic_gym.extraction.shards import Advance, DescribeShard, MatchShard, Workers
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import check_image, digest_of, lost_levels, read_bytes
from amusic_gym.techniques.protocol import Technique
from amusic_gym.utils.names import few

_SAMPLE = 5  # images of a traverse whose grey levels are counted
_NAMED = 5  # refused images that are named before they are only counted
FORMAT = 1  # of the cache's entries: raised when the same key would have to mean something else


def images_of(folder: ImageFolder) -> Images:
    """Paths and digests of a folder's images; reads and checks every file once.

    Warns where images of more than 8 bits lose most of their grey levels.

    Raises:
        FileNotFoundError: for an image that is not there any more.
        ValueError: for those that are empty, truncated, damaged or no images, before any work
            begins.
    """
    paths = tuple(Path(os.path.abspath(path)) for path in folder.paths)
    digests, refused, lost = [], [], ""
    for at, path in enumerate(paths):
        data = read_bytes(path)
        digests.append(digest_of(data))
        try:
            check_image(data, path)
            if at % -(-len(paths) // _SAMPLE) == 0 and not lost and (told := lost_levels(data)):
                lost = f"{path} {told}"
        except ValueError as error:
            refused.append(str(error))
    if refused:
        count = f"{len(refused)} images cannot be used: " if len(refused) > 1 else ""
        named = few(refused, _NAMED, "; ")
        raise ValueError(f"{count}{named}; or go on without (--skip-damaged)")
    if lost:
        warnings.warn(lost, UserWarning, stacklevel=2)
    return Images(paths, tuple(digests), folder.changes)


@dataclass
class ExtractionPlan:
    """One technique on one route, in blocks, and the keys of its results in the cache."""

    technique: Technique
    reference: Images
    query: Images
    references: Sequence[Images] = field(init=False)  # blocks of the map
    queries: Sequence[Images] = field(init=False)  # blocks of the query
    identity: dict[str, Any] = field(init=False)  # all that results depend on besides the images

    def __post_init__(self) -> None:
        self.references, self.queries = self.reference.blocks(), self.query.blocks()
        self.identity = identity(self.technique)

    def descriptor_key(self, images: Images, *, query: bool) -> str:
        """Key of a block's descriptors; that of a query is a map's where they are the same."""
        side = "query" if query and not describes_queries_alike(self.technique) else "map"
        return self.key("descriptors", side=side, images=images.keys)

    def score_key(self, queries: Images, references: Images) -> str:
        """Key of a block of scores."""
        return self.key("scores", queries=queries.keys, references=references.keys)

    def key(self, kind: str, **parts: Any) -> str:
        """Key of any other entry that belongs to this technique."""
        return key_of(format=FORMAT, kind=kind, technique=self.identity, **parts)


def describe(
    plan: ExtractionPlan,
    cache: Cache,
    workers: Workers,
    progress: Progress,
    *,
    query: bool,
    only: Sequence[int] | None = None,
) -> list[Stored]:
    """Descriptors of one side's blocks, from the cache or computed.

    ``query`` tells the side, ``only`` the indices of the blocks that are wanted, rising; None: all.
    New ones go to the cache as they are finished.

    Raises:
        ValueError: for an image that cannot be read or described; for descriptors of different
            shapes.
    """
    blocks = plan.queries if query else plan.references
    wanted = blocks if only is None else [blocks[at] for at in only]
    keys = [plan.descriptor_key(images, query=query) for images in wanted]
    found = {key: cache.get(key) for key in keys}
    missing = {
        key: DescribeShard(key, images, query)
        for key, images in zip(keys, wanted, strict=True)
        if found[key] is None
    }
    title = f"{plan.technique.name}: {'queries' if query else 'map'}"
    total = sum(shard.size for shard in missing.values())
    with progress.bar(title, total, "images") as advance:
        found.update(_compute(missing.values(), cache, workers, advance))
    stored = [_there(found[key]) for key in keys]
    for images, each in zip(wanted, stored, strict=True):
        check_shape(plan.technique, each.shape[1:], stored[0].shape[1:], images.paths[0])
    return stored


def match(plan: ExtractionPlan, cache: Cache, workers: Workers, progress: Progress) -> int:
    """Put the scores of all blocks into the cache; gives how many pairs had to be matched.

    Raises:
        ValueError: as :func:`describe`; for scores that are not finite numbers.
    """
    missing = {
        (q, r): key
        for q, queries in enumerate(plan.queries)
        for r, references in enumerate(plan.references)
        if cache.get(key := plan.score_key(queries, references)) is None
    }

    def described(side: int) -> dict[int, Stored]:
        only = sorted({pair[side] for pair in missing})
        stored = describe(plan, cache, workers, progress, query=side == 0, only=only)
        return dict(zip(only, stored, strict=True))

    references, queries = described(1), described(0)
    shards = (
        MatchShard(key, queries[q], references[r], plan.queries[q].paths)
        for (q, r), key in missing.items()
    )
    total = sum(queries[q].shape[0] * references[r].shape[0] for q, r in missing)
    with progress.bar(f"{plan.technique.name}: matching", total, "pairs") as advance:
        for _ in _compute(shards, cache, workers, advance):
            pass
    return total


def score_rows(plan: ExtractionPlan, cache: Cache) -> Iterator[NDArray[np.float32]]:
    """All scores, which :func:`match` has put into the cache, as blocks of rows (B, R)."""
    for queries in plan.queries:
        yield np.hstack(
            [
                _there(cache.get(plan.score_key(queries, references))).array()
                for references in plan.references
            ]
        )


def _compute(
    shards: Iterable[DescribeShard | MatchShard], cache: Cache, workers: Workers, advance: Advance
) -> Iterator[tuple[str, Stored]]:
    for shard, result in workers.run(shards, advance):
        yield shard.key, cache.put(shard.key, result)


def _there(stored: Stored | None) -> Stored:
    if stored is None:
        raise FileNotFoundError(
            "an entry of the cache was removed while it was in use; run the command again"
        )
    return stored
