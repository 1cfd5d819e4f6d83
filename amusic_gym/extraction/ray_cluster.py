"""Shards on a Ray cluster."""

from __future__ import annotations

import contextlib
import logging
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.processes import dumped, loaded
from amusic_gym.extraction.shards import ATTEMPTS, Advance, S, Shard, nothing
from amusic_gym.techniques.protocol import Technique


class RayCluster:
    """Runs shards as Ray tasks, one processor each.

    Workers must be able to import the technique's class and read the images under the same paths;
    the cache is read and written by this process only.

    Args:
        address: of a running cluster; None: the one that this process is connected to, or else a
            new one on this machine, which ends with the context.

    Raises:
        ValueError: when Ray is not installed, with the command that installs it.
    """

    def __init__(self, address: str | None = None) -> None:
        try:
            import ray
        except ImportError:
            raise ValueError(
                "the executor 'ray' needs Ray: pip install \"amusic-gym[ray]\""
            ) from None
        self._ray: Any = ray
        self._address = address
        self._connected = False

    def workers(self, technique: Technique) -> _RayWorkers:
        """As many workers as the cluster has processors, once there is work."""
        return _RayWorkers(self, dumped(technique))

    def connected(self) -> Any:
        """Ray, connected to a cluster.

        Raises:
            ValueError: when there is none at the address.
        """
        if not self._ray.is_initialized():
            self._connect()
        return self._ray

    def _connect(self) -> None:
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

    def __enter__(self) -> RayCluster:
        return self

    def __exit__(self, *_: object) -> None:
        if self._connected:
            self._ray.shutdown()
            self._connected = False


class _RayWorkers:
    def __init__(self, cluster: RayCluster, technique: bytes) -> None:
        self._cluster = cluster
        self._technique = technique
        self._running: dict[Any, Any] = {}

    def run(
        self, shards: Iterable[S], advance: Advance = nothing
    ) -> Iterator[tuple[S, NDArray[np.float32]]]:
        waiting = iter(shards)
        shard = next(waiting, None)
        if shard is None:
            return  # before a cluster is started for nothing
        ray = self._cluster.connected()
        technique = ray.put(self._technique)
        # Ray starts another worker in the place of one that died.
        remote = ray.remote(num_cpus=1, max_retries=ATTEMPTS - 1)(_bootstrap())
        ahead = 2 * int(ray.cluster_resources().get("CPU", 1))
        while shard is not None or self._running:
            while shard is not None and len(self._running) < ahead:
                task = remote.remote(sys.path, technique, pickle.dumps(shard.portable()))
                self._running[task] = shard
                shard = next(waiting, None)
            for task in ray.wait(list(self._running), num_returns=1)[0]:
                done = self._running.pop(task)
                result = self._result(ray, task, done)
                advance(done.size)
                yield done, result

    def _result(self, ray: Any, task: Any, shard: Shard) -> NDArray[np.float32]:
        errors = ray.exceptions
        try:
            result: NDArray[np.float32] = ray.get(task)
        except errors.RayTaskError as error:
            raise error.cause from None
        except (errors.WorkerCrashedError, errors.OutOfMemoryError) as error:
            raise ChildProcessError(
                f"{shard}: {ATTEMPTS} workers died of it ({error}); what was finished is in the "
                "cache"
            ) from error
        return result

    def __enter__(self) -> _RayWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        for task in self._running:
            with contextlib.suppress(Exception):  # the cluster may be gone
                self._cluster.connected().cancel(task, force=True)
        self._running = {}


def _bootstrap() -> Callable[[list[str], bytes, bytes], Any]:
    """The function that Ray sends to its workers.

    Ray sends a function inside a function by its code, any other by the name of its module, which
    workers may not find before they look where this process does.
    """

    def run(path: list[str], technique: bytes, shard: bytes) -> Any:
        import sys

        sys.path.extend(folder for folder in path if folder not in sys.path)
        from amusic_gym.extraction.ray_cluster import run_shard

        return run_shard(technique, shard)

    return run


_last: tuple[bytes, Technique] | None = None  # in a worker: the technique it has loaded


def run_shard(technique: bytes, shard: bytes) -> NDArray[np.float32]:
    """What a worker does; it keeps the technique for the next shard."""
    global _last
    if _last is None or _last[0] != technique:
        _last = technique, loaded(technique)
    work: Shard = pickle.loads(shard)
    return work.run(_last[1])
