"""Shards on a Ray cluster."""

from __future__ import annotations

import contextlib
import logging
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import lru_cache
from typing import Any

from amusic_gym.extraction.blocks import array_of
from amusic_gym.extraction.processes import dumped, loaded
from amusic_gym.extraction.shards import (
    ATTEMPTS,
    Advance,
    Executor,
    Held,
    MatchShard,
    S,
    Shard,
    Workers,
    nothing,
)
from amusic_gym.utils.optional import optional


class RayCluster(Executor):
    """Runs shards as Ray tasks, one processor each.

    Workers must be able to import the class of what they hold, and find images, banks and run
    folders under the same paths; an extraction's cache is read and written by this process only.

    Args:
        address: of a running cluster; None: the one that this process is connected to, or else a
            new one on this machine, which ends with the context.

    Raises:
        ValueError: when Ray is not installed, with the command that installs it.
    """

    def __init__(self, address: str | None = None) -> None:
        self._ray = optional("ray", "the executor 'ray'", "Ray", "ray")
        self._address = address
        self._connected = False

    def workers(self, held: Held) -> _RayWorkers:
        """As many workers as the cluster has processors, once there is work."""
        return _RayWorkers(self, dumped(held))

    def connect(self) -> Any:
        """Ray, connected to a cluster; refuses an address where there is none."""
        if self._ray.is_initialized():
            return self._ray
        try:
            self._ray.init(
                address=self._address or "local",
                include_dashboard=False if self._address is None else None,
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ValueError(
                f"no Ray cluster at {self._address or 'this machine'} ({error}); start one with "
                "'ray start --head', or give its address as ray:ADDRESS"
            ) from error
        self._connected = True
        return self._ray

    def close(self) -> None:
        """Leave the cluster that was connected to, or end the one that was started."""
        if self._connected:
            self._ray.shutdown()
            self._connected = False


class _RayWorkers(Workers):
    def __init__(self, cluster: RayCluster, held: bytes) -> None:
        self._cluster = cluster
        self._held = held
        self._running: dict[Any, Any] = {}  # task -> shard

    def run(self, shards: Iterable[S], advance: Advance = nothing) -> Iterator[tuple[S, Any]]:
        waiting = iter(shards)
        shard = next(waiting, None)
        if shard is None:
            return  # before a cluster is started for nothing
        ray = self._cluster.connect()
        held = ray.put(self._held)
        # Ray starts another worker in the place of one that died.
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_bootstrap())
        ahead = 2 * int(ray.cluster_resources().get("CPU", 1))
        while shard is not None or self._running:
            while shard is not None and len(self._running) < ahead:
                task = remote.remote(sys.path, held, pickle.dumps(_portable(shard)))
                self._running[task] = shard
                shard = next(waiting, None)
            for task in ray.wait(list(self._running), num_returns=1)[0]:
                done = self._running.pop(task)
                result = _result(ray, task, done)
                advance(done.size)
                yield done, result

    def close(self) -> None:
        """Cancel the tasks that still run."""
        for task in self._running:
            with contextlib.suppress(Exception):  # the cluster may be gone
                self._cluster.connect().cancel(task, force=True)
        self._running = {}


def _portable(shard: Shard) -> Shard:
    """The shard with arrays in place of files of the cache, which workers may not see."""
    if not isinstance(shard, MatchShard):
        return shard
    return replace(shard, queries=array_of(shard.queries), references=array_of(shard.references))


def _result(ray: Any, task: Any, shard: Shard) -> Any:
    try:
        return ray.get(task)
    except ray.exceptions.RayTaskError as error:
        raise error.cause from None
    except (ray.exceptions.WorkerCrashedError, ray.exceptions.OutOfMemoryError) as error:
        raise ChildProcessError(
            f"{shard}: {ATTEMPTS} workers died of it ({error}); what was finished is kept"
        ) from error


def _bootstrap() -> Callable[[list[str], bytes, bytes], Any]:
    """The function that Ray sends to its workers, by its code, as it stands inside a function.

    Any other goes by its module's name, which workers may not find before they look where we do.
    """

    def run(path: list[str], held: bytes, shard: bytes) -> Any:
        import sys

        sys.path.extend(folder for folder in path if folder not in sys.path)
        from amusic_gym.extraction.ray_cluster import run_shard

        return run_shard(held, shard)

    return run


_held = lru_cache(1)(loaded)  # in a worker: what the last shard needed


def run_shard(held: bytes, shard: bytes) -> Any:
    """A shard's result in a worker."""
    work: Shard = pickle.loads(shard)
    return work.run(_held(held))
