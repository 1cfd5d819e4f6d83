"""The commands: ``amusic NAME``, ``python -m amusic_gym NAME``, ``python scripts/NAME.py``.

A command is a module of its name with ``add_arguments(parser)`` and, unless that adds subcommands,
``main(args)``; its docstring is what ``--help`` begins with. What input is refused, every function
here raises as a ValueError of one sentence; what is not there, as a FileNotFoundError.
"""

import sys
from collections.abc import Sequence
from functools import partial
from importlib import import_module
from typing import NoReturn

from amusic_gym import __version__
from amusic_gym.cli.parser import Parser
from amusic_gym.cli.status import run

COMMANDS = {
    "bank": "make and inspect score banks, from images or scores, recorded or simulated",
    "train": "train a selector",
    "tune": "search for a training's settings",
    "rewards": "what rules and selectors reach in the environment without a bank",
    "compare": "compare policies on score banks",
    "failures": "draw contact sheets of the failures of a comparison",
    "study": "study policies over seeds, λ and motions, with intervals",
    "reproduce": "run the paper's experiments on its data sets",
    "map": "describe a map once, as one folder that a robot loads",
    "navigate": "recognise places live, along images, a video or a camera",
    "demo": "all of it in one go, on rendered worlds",
}
"""Name → what the command does."""


def start(name: str, words: Sequence[str] | None = None, prog: str | None = None) -> None:
    """Run one of `COMMANDS` in this process, with its arguments or those of the process.

    Its help and refusals call it ``prog``, or by the name of the running script.

    Raises:
        SystemExit: for arguments that are refused, or a call for help.
        ValueError: for input that is refused; also OSError.
    """
    command = import_module(f"amusic_gym.cli.{name}")
    parser = Parser(prog=prog, description=command.__doc__)
    command.add_arguments(parser)
    args = parser.parse_args(words)
    run = args.run if "run" in args else command.main
    run(args)


def main() -> NoReturn:
    """Run the command that the first word names, and exit as `run` does."""
    name, *words = sys.argv[1:] or [""]
    if name in COMMANDS:
        prog = f"amusic {name}"
        run(partial(start, name, words, prog), prog)
    run(_help, "amusic")


def _help() -> None:
    """Show what there is, or refuse the first word."""
    parser = Parser(
        prog="amusic", description="Learned selection of visual place recognition techniques."
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for name, about in COMMANDS.items():
        commands.add_parser(name, help=about)
    parser.parse_args()
