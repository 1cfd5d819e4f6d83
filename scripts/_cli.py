"""What all scripts share: one-line refusals, and the exit status of each outcome."""

from __future__ import annotations

import argparse
import re
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NoReturn

# `python scripts/NAME.py` works from any checkout, installed or not.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from amusic_gym.names import nearest  # noqa: E402  (found by the line above)


class Parser(argparse.ArgumentParser):
    """An argument parser whose refusal is one line that names the nearest valid word."""

    _options: set[str] = set()  # of this script and its subcommands

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})

    def add_argument(self, *names: Any, **kwargs: Any) -> argparse.Action:
        """As argparse's; the options' names are remembered for suggestions."""
        self._options.update(name for name in names if name.startswith("--"))
        return super().add_argument(*names, **kwargs)

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and exit with status 2."""
        hint = self._hint(message)
        print(f"{self.prog}: {message}{hint} (see {self.prog} --help)", file=sys.stderr)
        raise SystemExit(2)

    def _hint(self, message: str) -> str:
        choice = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        unknown = re.search(r"unrecognized arguments: (--[\w-]+)", message)
        near = None
        if choice:
            near = nearest(choice[1], re.findall(r"[\w-]+", choice[2]))
        elif unknown:
            near = nearest(unknown[1], sorted(self._options))
        return f"; did you mean '{near}'?" if near else ""


def run(main: Callable[[], int | None]) -> NoReturn:
    """Run a script's ``main`` and exit.

    Exit status: what ``main`` returns, or 0; 2 for bad arguments or input, one line on stderr;
    130 on Ctrl-C. Warnings are one line on stderr too.
    """
    warnings.formatwarning = lambda message, *_, **__: (
        f"warning: {' '.join(str(message).split())}\n"
    )
    try:
        status = main() or 0
    except KeyboardInterrupt:
        print("interrupted; what was finished is kept", file=sys.stderr)
        status = 130
    except (ValueError, OSError) as error:
        print(f"{Path(sys.argv[0]).name}: {_sentence(error)}", file=sys.stderr)
        status = 2
    raise SystemExit(status)


def pairs(items: Sequence[str], what: str) -> dict[str, str]:
    """``["A=1", "B=2"]`` as a dictionary, each name once.

    Raises:
        ValueError: for an item without ``=`` or a repeated name.
    """
    result: dict[str, str] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if not (equals and name and value):
            raise ValueError(f"{what} {item!r} is not of the form NAME=VALUE")
        if name in result:
            raise ValueError(f"{what} names {name!r} twice; give each name once")
        result[name] = value
    return result


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    return f"warning: {' '.join(str(message).split())}\n"


def _sentence(error: Exception) -> str:
    text = str(error)
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        if isinstance(error, NotADirectoryError | FileExistsError | PermissionError):
            text += "; give another folder"
    return " ".join(text.split()) or type(error).__name__
