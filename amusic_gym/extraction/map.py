"""The described map: what live navigation matches its frames against."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import Images, Stored, aligned, describe_one, match_one
from amusic_gym.extraction.cache import Cache, opened
from amusic_gym.extraction.describe import ExtractionPlan, describe, images_of
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.progress import Progress
from amusic_gym.routes.folders import Folder, folder_of
from amusic_gym.techniques import Descriptor, Image, Technique, make_technique
from amusic_gym.utils.threads import limit_this_thread, one_thread


class DescribedMap:
    """A map as one technique describes it: a sequence of blocks, and the scores of a query.

    It does not change, and copies share it. Memory-mapped, it pickles as the addresses of its
    files in the cache.

    Args:
        technique: the technique.
        blocks: each (B, ...) float32, B = ``BLOCK`` but for the last; arrays, or entries of the
            cache.
        threads: how many blocks are matched at once; None: one per processor, at most 4.

    Attributes:
        technique: the technique.
        references: R, places on the map.
    """

    def __init__(
        self,
        technique: Technique,
        blocks: Sequence[Descriptor | Stored],
        *,
        threads: int | None = None,
    ) -> None:
        self.technique = technique
        self.references = sum(block.shape[0] for block in blocks)
        self._threads = min(4, os.cpu_count() or 1) if threads is None else threads
        self._given = tuple(blocks)
        self._open()

    def _open(self) -> None:
        self._blocks = tuple(_read_only(block) for block in self._given)
        self._pool: ThreadPoolExecutor | None = None
        self._owner = os.getpid()  # of the pool: a forked process has it without its threads

    def __getitem__(self, at: int) -> Descriptor:
        """Block ``at``, read-only, (up to ``BLOCK``, ...)."""
        return self._blocks[at]

    def __len__(self) -> int:
        """How many blocks."""
        return len(self._blocks)

    def describe_query(self, image: Image) -> Descriptor:
        """Descriptor of a query image, with the bits that a score bank is made of."""
        return describe_one(self.technique, image, query=True)

    def scores(self, query: Descriptor) -> NDArray[np.float32]:
        """Scores (R,) of a query against the whole map, with the bits that a score bank has.

        Blocks are matched on several Python threads, each on one thread of its libraries, so that
        their number changes nothing in the result.

        Raises:
            ValueError: when the technique gives something else than one finite number for each
                reference.
        """
        with one_thread():
            return np.concatenate(list(self._match(query)))

    def _match(self, query: Descriptor) -> Iterator[NDArray[np.float32]]:
        if self._threads == 1 or len(self) == 1:
            return (match_one(self.technique, query, block) for block in self._blocks)
        if self._pool is None or self._owner != os.getpid():
            self._owner = os.getpid()
            self._pool = ThreadPoolExecutor(
                self._threads, "amusic-match", initializer=limit_this_thread
            )
        return self._pool.map(lambda block: match_one(self.technique, query, block), self._blocks)

    def close(self) -> None:
        """End the threads; they come back with the next query."""
        if self._pool is not None and self._owner == os.getpid():
            self._pool.shutdown()
        self._pool = None

    def __copy__(self) -> DescribedMap:
        return self

    def __deepcopy__(self, memo: dict[int, Any]) -> DescribedMap:
        return self

    def __getstate__(self) -> dict[str, Any]:
        return {key: value for key, value in vars(self).items() if key not in ("_blocks", "_pool")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._open()


def describe_map(
    folder: Folder,
    technique: Technique | str,
    *,
    cache: str | os.PathLike[str] | Cache | None = None,
    executor: str = "serial",
    in_memory: bool = False,
    threads: int | None = None,
    progress: bool = False,
) -> DescribedMap:
    """Describe all images of a folder as the map of one technique, or take that from the cache.

    Args:
        folder: the reference traverse, R images, or its path.
        technique: the technique, or its name as `amusic_gym.techniques.make_technique` takes it.
        cache: the cache's folder, or an open cache; None: the default one.
        executor: see :func:`amusic_gym.extraction.executors.make_executor`.
        in_memory: hold all descriptors in memory; else they stay in the cache's files,
            memory-mapped, unless the cache cannot be written.
        threads: see :class:`DescribedMap`.
        progress: show a bar on a terminal, or one line elsewhere.

    Raises:
        FileNotFoundError: for an image that is not there.
        ValueError: for one that cannot be read or described.
    """
    technique = make_technique(technique) if isinstance(technique, str) else technique
    places = folder_of(folder)
    with opened(cache) as store:
        plan = ExtractionPlan(technique, images_of(places), Images((), ()))
        with make_executor(executor) as where, where.workers(technique) as workers:
            blocks: Sequence[Stored] = describe(
                plan, store, workers, Progress(progress), query=False
            )
        if not (in_memory or store.is_temporary):
            return DescribedMap(technique, blocks, threads=threads)
        held = [np.array(block.array()) for block in blocks]
        return DescribedMap(technique, held, threads=threads)


def _read_only(block: Descriptor | Stored) -> Descriptor:
    view = (block.array() if isinstance(block, Stored) else aligned(block)).view()
    view.flags.writeable = False
    return view
