"""What all scripts share: one-line refusals, and the exit status of each outcome."""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import re
import select
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, NoReturn

INTERRUPTED, READER_GONE = 130, 141  # as a shell counts a death by SIGINT and by SIGPIPE

STOPS = (signal.SIGTERM, signal.SIGHUP)
"""Signals that a script takes as it takes Ctrl-C."""

SAME = 10.0
"""Seconds in which more of them are no second request: a closing terminal sends several."""


def _tell(line: str) -> None:
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(line, file=sys.stderr, flush=True)


def _tell_interrupt() -> None:
    _tell("interrupted; what was finished is kept")


def _end(kind: type[BaseException], error: BaseException, trace: TracebackType | None) -> None:
    """What nobody caught: a Ctrl-C while the modules are imported is no fault of theirs."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, trace)
        return
    _tell_interrupt()
    os._exit(INTERRUPTED)  # Python would kill itself by the signal


sys.excepthook = _end  # scripts import this module before what takes long

# `python scripts/NAME.py` works from any checkout, installed or not.
ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / folder) for folder in (".", "agents", "baselines")]

from amusic_gym.utils.escaping import for_terminal  # noqa: E402  (found by the line above)
from amusic_gym.utils.names import nearest  # noqa: E402


class Parser(argparse.ArgumentParser):
    """An argument parser whose refusal is one line that names the nearest valid word."""

    _options: set[str] = set()  # of this script and its subcommands

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **{"allow_abbrev": False, **kwargs})

    def add_argument(self, *names: Any, **kwargs: Any) -> argparse.Action:
        """As argparse's; the options' names are remembered for suggestions."""
        self._options.update(name for name in names if name.startswith("--"))
        return super().add_argument(*names, **kwargs)

    def parse_args(self, args: Sequence[str] | None = None, namespace: Any = None) -> Any:  # type: ignore[override]
        """As argparse's; an empty word is refused: as a path it would be the current folder."""
        words = sys.argv[1:] if args is None else list(args)
        option = "an argument"
        for word in words:
            name, equals, value = word.partition("=")
            if name in self._options:
                option = name
            if not word or (name in self._options and equals and not value):
                self.error(f"{option} is empty; give a value")
        return super().parse_args(words, namespace)

    def error(self, message: str) -> NoReturn:
        """Print one line on stderr and exit with status 2."""
        hint = self._hint(message)
        print(
            for_terminal(f"{self.prog}: {message}{hint} (see {self.prog} --help)"), file=sys.stderr
        )
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


def add_correction(parser: Parser, whose: str) -> None:
    """Add what turns off the two things that the statistic `evidence` brings.

    Args:
        parser: of a script that takes ``--statistic``.
        whose: as in "for all policies but amusic".
    """
    off: dict[str, Any] = {"action": "store_const", "const": False}
    parser.add_argument(
        "--no-carry", dest="carry", help=f"no carried candidates for SIC, {whose}", **off
    )
    parser.add_argument(
        "--no-discount",
        dest="discount",
        help=f"MuSIC takes alike rows as they are, {whose}",
        **off,
    )


def destination(text: str) -> Path:
    """A file or folder to write, as argparse's ``type``: nothing goes into a bank's folder."""
    from amusic_gym.banks.bank_files import refuse_within_bank  # here: it takes long to import

    try:
        refuse_within_bank(Path(text))
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
    return Path(text)


def insisted(args: argparse.Namespace) -> dict[str, Any]:
    """What the user said of SIC and MuSIC; None: nothing."""
    return {"statistic": args.statistic, "carry": args.carry, "discount": args.discount}


@contextlib.contextmanager
def _stops_as_ctrl_c() -> Iterator[list[int]]:
    """Let `STOPS` do what Ctrl-C does at that time; one that is ignored (``nohup``) stays so.

    Yields:
        The numbers of those that came.
    """
    came: list[int] = []
    until = -1.0

    def stop(number: int, frame: FrameType | None) -> None:
        nonlocal until
        if time.monotonic() < until:
            return
        until = time.monotonic() + SAME
        came.append(number)
        handler = signal.getsignal(signal.SIGINT)
        (handler if callable(handler) else signal.default_int_handler)(signal.SIGINT, frame)

    usual = {number: signal.getsignal(number) for number in STOPS}
    changed = [number for number in STOPS if usual[number] is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        changed = []  # only the main thread hears signals
    for number in changed:
        signal.signal(number, stop)
    try:
        yield came
    finally:
        for number in changed:
            signal.signal(number, usual[number])


def run(main: Callable[[], int | None]) -> NoReturn:
    """Run a script's ``main`` and exit.

    Exit status: what ``main`` returns, or 0; 2 for bad arguments or input, one line on stderr;
    130 on Ctrl-C, 143 on SIGTERM and 129 on SIGHUP, which do the same; 141, and not a word, when
    who reads stdout has gone (``| head``). Warnings are one line on stderr too.
    """
    warnings.formatwarning = _one_line
    _escape_output()
    status: Any = 2
    failure: Exception | None = None
    with _stops_as_ctrl_c() as came:
        try:
            status = main() or 0
        except SystemExit as ended:
            status = ended.code
        except KeyboardInterrupt:
            _tell_interrupt()
            status = INTERRUPTED
        except (ValueError, OSError, MemoryError) as error:
            failure = error
        lost = _lost_output()
    failure = failure or lost
    if came and (isinstance(failure, OSError) or status == INTERRUPTED):
        status = 128 + came[0]  # with a terminal that hangs up, all output is lost
    elif isinstance(failure, BrokenPipeError) and (lost is not None or _reader_gone()):
        status = READER_GONE
    elif failure is not None:
        _tell(f"{Path(sys.argv[0]).name}: {_sentence(failure)}")
        status = 2
    raise SystemExit(status)


def _escape_output() -> None:
    """Let names in what is printed be shown, not obeyed, and ``?`` for what a terminal lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if sys.stdout is not None:
        write = sys.stdout.write
        sys.stdout.write = lambda text: write(for_terminal(text))  # type: ignore[method-assign]


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


def by_technique(
    given: Mapping[str, str], names: Sequence[str]
) -> tuple[dict[str, str], list[str]]:
    """What was given by technique, in the techniques' own spelling.

    Args:
        given: what `pairs` made of NAME=VALUE; NAME in upper or lower case, and a class also
            without its module.
        names: of the techniques: names, or ``package.module:Class``.

    Returns:
        Name of a technique → value, and the given names that are no technique's.
    """
    known = {name.rpartition(":")[2].casefold(): name for name in names}
    known |= {name.casefold(): name for name in names}
    found = {name: known.get(name.casefold()) for name in given}
    matched = {own: given[name] for name, own in found.items() if own is not None}
    return matched, [name for name, own in found.items() if own is None]


def number(what: str, text: str) -> float:
    """The number that ``text`` is.

    Raises:
        ValueError: when it is none, naming ``what`` it was given for.
    """
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{what}={text}: {text!r} is not a number") from None


def _lost_output() -> OSError | None:
    """Why stdout takes no more, if so; what is left to be written is then thrown away."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError as error:
        # Else Python complains when it writes the rest at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return error
    return None


def _reader_gone() -> bool:
    """Whether stdout is a pipe that nobody reads, though nothing is left to be written to it."""
    poll = select.poll()
    poll.register(1, 0)  # errors are told whatever is asked for
    return bool(poll.poll(0))


def _one_line(message: Warning | str, *_: Any, **__: Any) -> str:
    return f"warning: {for_terminal(' '.join(str(message).split()))}\n"


def _sentence(error: Exception) -> str:
    text = str(error)
    if isinstance(error, MemoryError):
        return " ".join(f"not enough memory; ask for less. {text}".split())
    if isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        if isinstance(error, NotADirectoryError | FileExistsError | PermissionError):
            text += "; give another folder"
    return for_terminal(" ".join(text.split())) or type(error).__name__
