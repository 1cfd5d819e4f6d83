"""What the commands of bank.py share that run techniques on images: images | tour."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from _cli import Parser, by_technique, number, pairs

from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.techniques import Technique


@dataclass(frozen=True)
class Techniques:
    """The techniques of a command, and the seconds that were given for some."""

    made: list[Technique]
    seconds: dict[str, float]

    @classmethod
    def of(cls, args: argparse.Namespace) -> Techniques:
        """Those of ``--techniques``, ``--weights`` and ``--seconds``.

        Raises:
            FileNotFoundError: for a file of weights that is not there.
            ValueError: for an unknown name, weights that do not fit, or seconds that are no number.
        """
        from amusic_gym.techniques import make_technique

        specs = [spec.strip() for spec in args.techniques.split(",")]
        files = _by_technique(args.weights, specs, "--weights")
        made = [make_technique(spec, files.get(spec)) for spec in specs]
        names = [technique.name for technique in made]
        given = _by_technique(args.seconds, names, "--seconds")
        seconds = {name: number(f"--seconds {name}", text) for name, text in given.items()}
        return cls(made, seconds)


def extract_bank(
    args: argparse.Namespace, techniques: Techniques, reference: Any, query: Any, **more: Any
) -> None:
    """Extract scores to ``--out``, and tell of it; ``more`` is passed on to `extract`."""
    from amusic_gym.extraction import extract

    bank = extract(
        reference,
        query,
        techniques.made,
        seconds=techniques.seconds,
        measure_again=args.measure_again,
        cache=args.cache,
        executor=args.executor,
        out=args.out,
        progress=True,
        **more,
    )
    count, queries, references = bank.shape
    print(f"{bank.path}: {count} techniques, {queries} queries, {references} references")


def add_extraction(parser: Parser, *, tolerance_required: bool, name: str) -> None:
    """The options of both commands.

    Args:
        parser: of the command.
        tolerance_required: whether ``--tolerance`` must be given.
        name: what the bank is called without ``--name``, for the help.
    """
    add = parser.add_argument
    add(
        "--techniques",
        required=True,
        metavar="A,B",
        help="hog, cohog, calc, netvlad, or package.module:Class",
    )
    add(
        "--weights",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=FILE",
        help="weights of a technique, in place of those that ship",
    )
    add(
        "--seconds",
        nargs="+",
        action="extend",
        default=[],
        metavar="NAME=S",
        help="seconds of one run on one frame, in place of those measured here",
    )
    add(
        "--measure-again",
        action="store_true",
        help="measure the seconds even if the cache remembers them of this machine",
    )
    add(
        "--tolerance",
        type=int,
        required=tolerance_required,
        metavar="N",
        help="places to either side of the true one that count as right",
    )
    add(
        "--cache",
        type=Path,
        metavar="DIR",
        help="where finished pieces are kept (default: $XDG_CACHE_HOME/amusic-gym, or "
        "~/.cache/amusic-gym)",
    )
    add(
        "--executor",
        default="serial",
        metavar="serial|process:N|ray[:ADDRESS]",
        help="where the work is done (default: %(default)s)",
    )
    add("--name", help=f"what to call it in tables (default: {name})")
    add("--out", type=Path, required=True, metavar="BANK", help="the folder")


def _by_technique(items: Sequence[str], names: Sequence[str], what: str) -> dict[str, str]:
    found, unknown = by_technique(pairs(items, what), names)
    if unknown:
        raise ValueError(f"{what}: " + suggest("technique", unknown[0], names))
    return found
