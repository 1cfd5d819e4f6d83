"""Executors by name: this process, others of this machine, or a Ray cluster."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from amusic_gym.extraction.shards import Advance, Executor, Held, S, Workers, nothing
from amusic_gym.utils.names import suggest

EXECUTORS = ("serial", "process:N", "ray", "ray:ADDRESS")


@dataclass
class _ThisProcess(Workers):
    held: Held

    def run(self, shards: Iterable[S], advance: Advance = nothing) -> Iterator[tuple[S, Any]]:
        for shard in shards:
            yield shard, shard.run(self.held, advance)


class Serial(Executor):
    """Runs shards in this process, one after the other."""

    def workers(self, held: Held) -> Workers:
        """This process."""
        return _ThisProcess(held)


def make_executor(name: str) -> Executor:
    """The executor called ``name``.

    Args:
        name: ``serial``; ``process:N``, N processes of this machine; ``ray``, a Ray cluster on
            this machine or the one that this process is connected to; ``ray:ADDRESS``, that
            cluster, whose workers must find all files under the same paths.

    Raises:
        ValueError: for another name; for ``ray`` where Ray is not installed, with the command
            that installs it.
    """
    kind, colon, argument = str(name).partition(":")
    if kind == "serial" and not colon:
        return Serial()
    if kind == "process" and argument.isdecimal():
        from amusic_gym.extraction.processes import Processes

        if int(argument) == 0:
            raise ValueError(f"executor {name!r} has no process; give at least 1")
        return Processes(int(argument))
    if kind == "ray" and bool(colon) == bool(argument):
        from amusic_gym.extraction.ray_cluster import RayCluster

        return RayCluster(argument or None)
    raise ValueError(f"{suggest('executor', str(name), EXECUTORS)}, N a number of processes")
