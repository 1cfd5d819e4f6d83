"""How a command ends: its exit status, and one line on stderr where something is wrong."""

import contextlib
import io
import os
import select
import signal
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from amusic_gym.utils.escaping import for_terminal

INTERRUPTED, READER_GONE = 130, 141  # as a shell counts a death by SIGINT and by SIGPIPE
STOPS = (signal.SIGTERM, signal.SIGHUP)  # signals that a command takes as it takes Ctrl-C
SAME = 10.0  # seconds in which more of them are no second request: a closing terminal sends several


def run(main: Callable[[], int | None], prog: str | None = None) -> NoReturn:
    """Run ``main`` and exit.

    Exit status: what ``main`` returns, or 0; 2 for bad arguments or input, one line on stderr;
    130 on Ctrl-C, 143 on SIGTERM and 129 on SIGHUP, which do the same; 141, and not a word, when
    who reads stdout has gone (``| head``). Warnings are one line on stderr too. A refusal begins
    with ``prog``, None being the name of the script.
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
            _tell("interrupted; what was finished is kept")
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
        _tell(f"{prog or Path(sys.argv[0]).name}: {_sentence(failure)}")
        status = 2
    raise SystemExit(status)


def _tell(line: str) -> None:
    with contextlib.suppress(OSError):  # the terminal may be gone
        print(line, file=sys.stderr, flush=True)


@contextlib.contextmanager
def _stops_as_ctrl_c() -> Iterator[list[int]]:
    """Let `STOPS` do what Ctrl-C does at that time; one that is ignored (``nohup``) stays so.

    The numbers of those that came are yielded.
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

    changed = [number for number in STOPS if signal.getsignal(number) is signal.SIG_DFL]
    if threading.current_thread() is not threading.main_thread():
        changed = []  # only the main thread hears signals
    for number in changed:
        signal.signal(number, stop)
    try:
        yield came
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL)


def _escape_output() -> None:
    """Let names in what is printed be shown, not obeyed, and ``?`` for what a terminal lacks."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    if sys.stdout is not None:
        write = sys.stdout.write
        sys.stdout.write = lambda text: write(for_terminal(text))  # type: ignore[method-assign]


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
        text = f"not enough memory; ask for less. {text}"
    elif isinstance(error, OSError) and error.strerror:
        text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
        if isinstance(error, NotADirectoryError | FileExistsError | PermissionError):
            text += "; give another folder"
    return for_terminal(" ".join(text.split())) or type(error).__name__
