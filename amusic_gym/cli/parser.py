"""What the commands share: a parser that refuses in one line, arguments, values by name."""

import argparse
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from amusic_gym.banks.bank_files import refuse_within_bank
from amusic_gym.cli.options import SHARED
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.utils.escaping import for_terminal
from amusic_gym.utils.names import nearest, suggest


class Parser(argparse.ArgumentParser):
    """An argument parser whose refusal is one line that names the nearest valid word.

    What it parses has itself, or the parser of the subcommand, as ``parser``.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self._options: set[str] = set()
        plain: dict[str, Any] = {"formatter_class": argparse.RawDescriptionHelpFormatter}
        super().__init__(*args, **{"allow_abbrev": False, **plain, **kwargs})
        self.set_defaults(parser=self)

    def add_argument(self, *names: Any, **kwargs: Any) -> argparse.Action:
        """As argparse's; the options' names are remembered for suggestions."""
        self._options.update(name for name in names if name.startswith("--"))
        return super().add_argument(*names, **kwargs)

    def add_shared(self, *names: str, **changes: Any) -> None:
        """Add options of `SHARED`, with changes."""
        for name in names:
            self.add_argument(name, **{**SHARED[name], **changes})

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse's; what is unknown is refused by the parser of the subcommand."""
        given, unknown = self.parse_known_args(args, namespace)
        if unknown:
            given.parser.error(f"unrecognized arguments: {' '.join(unknown)}")
        return given

    def parse_known_args(  # type: ignore[override]
        self, args: Sequence[str] | None = None, namespace: Any = None
    ) -> tuple[Any, list[str]]:
        """As argparse's; an empty word is refused: as a path it would be the current folder."""
        words = sys.argv[1:] if args is None else list(args)
        option = "an argument"
        for word in words if self._subparsers is None else []:
            name, equals, value = word.partition("=")
            if name in self._options:
                option = name
            if not word or (name in self._options and equals and not value):
                self.error(f"{option} is empty; give a value")
        return super().parse_known_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and exit with status 2."""
        line = f"{self.prog}: {message}{self._hint(message)} (see {self.prog} --help)"
        print(for_terminal(line), file=sys.stderr)
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


Command = tuple[Callable[[argparse.Namespace], None], Callable[["Parser"], None], str]
"""What runs a subcommand and gives it its name, what adds its arguments, and its help."""


def add_commands(parser: Parser, *commands: Command) -> None:
    """Add subcommands; what is parsed has as ``run`` what runs the one that was named."""
    all_of_them = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for run, add, about in commands:
        command = all_of_them.add_parser(run.__name__, help=about)
        command.set_defaults(run=run)
        add(command)


def destination(text: str) -> Path:
    """A file or folder to write, as argparse's ``type``: nothing goes into a bank's folder."""
    try:
        refuse_within_bank(Path(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(text)


def page_folder(text: str) -> Path:
    """A `destination` in which a page ``index.html`` is to be written."""
    from amusic_gym.evaluation.report import refuse_other_page

    path = destination(text)
    try:
        refuse_other_page(path / "index.html")
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return path


def add_statistic(parser: Parser, whose: str) -> None:
    """Add ``--statistic``, ``--no-carry`` and ``--no-discount``; `insisted` reads them.

    ``whose`` is as in "for all policies but amusic".
    """
    about = f"of SIC, {whose} (default: {SICSettings.statistic})"
    parser.add_argument("--statistic", choices=STATISTICS, help=about)
    add_correction(parser, whose)


def add_correction(parser: Parser, whose: str) -> None:
    """Add what turns off the two things that the statistic `evidence` brings."""
    off: dict[str, Any] = {"action": "store_const", "const": False}
    without = f"no carried candidates for SIC, {whose}"
    parser.add_argument("--no-carry", dest="carry", help=without, **off)
    as_they_are = f"MuSIC takes alike rows as they are, {whose}"
    parser.add_argument("--no-discount", dest="discount", help=as_they_are, **off)


def insisted(args: argparse.Namespace) -> dict[str, Any]:
    """What the user said of SIC and MuSIC; None: nothing."""
    return {"statistic": args.statistic, "carry": args.carry, "discount": args.discount}


def correction_of(args: argparse.Namespace) -> dict[str, Any]:
    """SIC and MuSIC as the user wants them, with the statistic of whoever said nothing."""
    return {**insisted(args), "statistic": args.statistic or SICSettings.statistic}


def pairs(items: Sequence[str], what: str) -> dict[str, str]:
    """``["A=1", "B=2"]`` as a dictionary, each name once."""
    result: dict[str, str] = {}
    for item in items:
        name, equals, value = item.partition("=")
        if not (equals and name and value):
            raise ValueError(f"{what} {item!r} is not of the form NAME=VALUE")
        if name in result:
            raise ValueError(f"{what} names {name!r} twice; give each name once")
        result[name] = value
    return result


def by_technique(items: Sequence[str], names: Sequence[str], what: str) -> dict[str, str]:
    """NAME=VALUE of techniques, by the techniques' own spelling.

    A technique is named in upper or lower case, and a class also without its module.
    """
    known = {name.rpartition(":")[2].casefold(): name for name in names}
    known |= {name.casefold(): name for name in names}
    found = {}
    for name, value in pairs(items, what).items():
        if name.casefold() not in known:
            raise ValueError(f"{what}: {suggest('technique', name, names)}")
        found[known[name.casefold()]] = value
    return found


def numbers(values: Mapping[str, str], what: str) -> dict[str, float]:
    """The values as numbers."""
    found = {}
    for name, text in values.items():
        try:
            found[name] = float(text)
        except ValueError:
            raise ValueError(f"{what} {name}={text}: {text!r} is not a number") from None
    return found
