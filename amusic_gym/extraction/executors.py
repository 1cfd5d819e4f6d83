"""Where shards are run: in this process, in others, or on a Ray cluster."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.shards import Advance, S, nothing
from amusic_gym.techniques.protocol import Technique
from amusic_gym.utils.names import nearest

EXECUTORS = ("serial", "process:N", "ray", "ray:ADDRESS")


class Workers(Protocol):
    """Workers that hold one technique."""

    def run(
        self, shards: Iterable[S], advance: Advance = nothing
    ) -> Iterator[tuple[S, NDArray[np.float32]]]:
        """Run all ``shards`` and yield each with its result, in any order.

        ``advance`` is called with every amount of work that is done, in shards' ``size``; in this
        process image by image, elsewhere shard by shard.

        Shards are taken from the iterable as workers become free. An error inside a shard is
        raised here as it is; a shard whose worker died is run `shards.ATTEMPTS` times in all.

        Raises:
            ChildProcessError: when a shard's worker died each time.
        """
        ...


class Executor(Protocol):
    """Makes workers; a context, at whose end they are gone."""

    def workers(self, technique: Technique) -> AbstractContextManager[Workers]:
        """Workers for the shards of one technique, until the end of the context."""
        ...

    def __enter__(self) -> Executor: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class Serial:
    """Runs shards in this process, one after the other."""

    def workers(self, technique: Technique) -> _SerialWorkers:
        """This process."""
        return _SerialWorkers(technique)

    def __enter__(self) -> Serial:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class _SerialWorkers:
    def __init__(self, technique: Technique) -> None:
        self._technique = technique

    def run(
        self, shards: Iterable[S], advance: Advance = nothing
    ) -> Iterator[tuple[S, NDArray[np.float32]]]:
        for shard in shards:
            yield shard, shard.run(self._technique, advance)

    def __enter__(self) -> _SerialWorkers:
        return self

    def __exit__(self, *_: object) -> None:
        pass


def make_executor(name: str) -> Executor:
    """The executor called ``name``.

    Args:
        name: ``serial``; ``process:N``, N processes of this machine; ``ray``, a Ray cluster on
            this machine or the one that this process is connected to; ``ray:ADDRESS``, that
            cluster, whose workers must find the images under the same paths.

    Raises:
        ValueError: for another name; for ``ray`` where Ray is not installed, with the command
            that installs it.
    """
    kind, colon, argument = str(name).partition(":")
    if kind == "serial" and not colon:
        return Serial()
    if kind == "process" and argument.isdecimal() and int(argument) > 0:
        from amusic_gym.extraction.processes import Processes

        return Processes(int(argument))
    if kind == "process" and argument.isdecimal():
        raise ValueError(f"executor {name!r} has no process; give at least 1")
    if kind == "ray" and bool(colon) == bool(argument):
        from amusic_gym.extraction.ray_cluster import RayCluster

        return RayCluster(argument or None)
    near = nearest(str(name), EXECUTORS)
    hint = f" did you mean {near!r}?" if near else ""
    raise ValueError(
        f"unknown executor {name!r}:{hint} valid: {', '.join(EXECUTORS)}, N a number of processes"
    )
