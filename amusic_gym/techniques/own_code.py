"""Users' own code: recognised by its place, its errors reported in one line."""

import sysconfig
import traceback
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")

_PACKAGE = "amusic_gym"
_OURS = str(Path(__file__).resolve().parent.parent)
_INSTALLED = {"site-packages", "dist-packages"}


@cache
def is_local(file: str) -> bool:
    """Whether a source file is of somebody's own: neither installed nor Python's."""
    path = Path(file)
    if file.startswith("<") or _INSTALLED & set(path.parts):
        return False
    return not any(
        path.is_relative_to(sysconfig.get_path(kind)) for kind in ("stdlib", "platstdlib")
    )


def guarded(
    what: str, owner: object, call: Callable[P, R], *given: P.args, **options: P.kwargs
) -> R:
    """``call(*given, **options)``; what a technique's code raises becomes a ValueError.

    The techniques that ship refuse with sentences of their own, which stay as they are.

    ``what`` is the beginning of the sentence, ``owner`` the technique, its class or its factory.

    Raises:
        ValueError: with the error's kind and text and where in somebody's own code it was raised;
            its cause is the error. Ctrl-C passes.
    """
    try:
        return call(*given, **options)
    except (Exception, SystemExit) as error:
        module = str(getattr(owner, "__module__", ""))
        if isinstance(error, ValueError | OSError) and module.partition(".")[0] == _PACKAGE:
            raise
        raise ValueError(f"{what}: {told(error)}") from error


def told(error: BaseException) -> str:
    """An error's kind, text and place in one line."""
    text = error.msg if isinstance(error, SyntaxError) else str(error)
    line = ": ".join(filter(None, [type(error).__name__, " ".join(text.split())]))
    if isinstance(error, SyntaxError):
        return f"{line} ({Path(error.filename or '?').name}:{error.lineno})"
    frames = [
        frame
        for frame in traceback.extract_tb(error.__traceback__)
        if is_local(frame.filename) and not Path(frame.filename).is_relative_to(_OURS)
    ]
    return f"{line} ({Path(frames[-1].filename).name}:{frames[-1].lineno})" if frames else line
