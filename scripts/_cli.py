"""What all scripts import first: it finds the packages of this checkout, installed or not."""

import os
import sys
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import NoReturn

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / folder) for folder in (".", "agents", "baselines")]


def _end(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What nobody caught: a Ctrl-C while modules are imported is no fault of theirs."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    print("interrupted; what was finished is kept", file=sys.stderr, flush=True)
    os._exit(130)  # Python would kill itself by the signal


sys.excepthook = _end  # before what takes long to import

from amusic_gym.cli import start  # noqa: E402  (found by the lines above)
from amusic_gym.cli.parser import Parser, destination, pairs  # noqa: E402
from amusic_gym.cli.status import run  # noqa: E402

__all__ = ["Parser", "destination", "door", "pairs", "run", "train_weights"]


def door(name: str) -> NoReturn:
    """Run the command ``amusic NAME`` under the script's name."""
    run(partial(start, name))


def train_weights(technique: str, about: str | None, words: list[str] | None = None) -> None:
    """Train the weights of a technique that ships, as the words of the command say."""
    from amusic_gym.pretraining import add_arguments, train

    parser = Parser(description=about)
    add_arguments(parser, destination)
    train(technique, parser.parse_args(words))
