"""How this project compiles its numeric kernels: the one place that talks to Numba's decorators."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit, types

Function = TypeVar("Function", bound=Callable[..., Any])

KERNEL_SOURCES = (
    "_compile.py",
    "_tables.py",
    "settings.py",
    "rows.py",
    "sic.py",
    "observation.py",
    "records.py",
    "belief/places.py",
    "dynamics.py",
    "selection.py",
)

INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}

_unliteral: Any = types.unliteral
_njit: Any = njit  # its stubs know neither the cache nor the options without wrappers


@cache
def sources_digest(*sources: str) -> str:
    """Digest of all files whose code ends up in compiled functions: paths below this folder."""
    folder = Path(__file__).parent
    text = b"".join((folder / name).read_bytes() for name in sources)
    return hashlib.sha256(text).hexdigest()


def _cached(function: Function, sources: tuple[str, ...], **options: bool) -> Function:
    """Numba's dispatcher of ``function``, whose cache is stale when one of ``sources`` changes."""
    compiled_function: Function
    try:
        dispatcher = _njit(cache=True, error_model="numpy", **options)(function)
    except RuntimeError:  # neither beside the source nor in the home can be written
        _warn_of_no_cache()
        compiled_function = _njit(error_model="numpy", **options)(function)
        return compiled_function
    file = dispatcher._cache._cache_file
    file._source_stamp = (file._source_stamp, sources_digest(*sources))
    compiled_function = dispatcher
    return compiled_function


@cache
def _warn_of_no_cache() -> None:
    warnings.warn(
        "compiled code cannot be kept here and is compiled anew in every process; set"
        " NUMBA_CACHE_DIR to a folder that can be written",
        stacklevel=2,
    )


def compiled(function: Function) -> Function:
    """Compile ``function`` on first use; the machine code is cached beside the source.

    Numba watches only the file of the cached function itself, but machine code holds that of its
    callees too: without the digest, a change in one kernel file would leave another's stale.
    """
    return _cached(function, KERNEL_SOURCES)


def standalone(*sources: str, nogil: bool = True) -> Callable[[Function], Function]:
    """As :func:`compiled`, for a kernel apart from the environment's.

    Args:
        sources: further files, below this folder, whose code ends up in it. So a change in the
            environment's kernels does not make it compile again, nor the other way round.
        nogil: whether it runs without the GIL, beside other Python threads.
    """
    return lambda function: _cached(function, (Path(__file__).name, *sources), nogil=nogil)


def inner(function: Function) -> Function:
    """Compile a ``function`` into the compiled ones that call it.

    It has no way in from Python, which makes it sooner compiled, and is cached with its callers.
    Inlining pays: without it, a third of a step went into counting references to array views.
    """
    compiled_function: Function = _once(_njit(**INNER, forceinline=True)(function))
    return compiled_function


def apart(function: Function) -> Function:
    """As :func:`inner`, but kept out of its callers' code: for what runs rarely."""
    compiled_function: Function = _once(_njit(**INNER)(function))
    return compiled_function


def spliced(function: Function) -> Function:
    """As :func:`inner`, but copied into its callers' source, as it were.

    Numba optimises the code of a function again in each of its callers; of functions that call
    one another in turn, each once more. One that only calls others is better not compiled at all.
    """
    compiled_function: Function = _once(_njit(**INNER, inline="always")(function))
    return compiled_function


def _once(dispatcher: Any) -> Any:
    """Let a dispatcher take a constant for any other number of its type.

    Else Numba compiles a function anew for every constant that it is called with.
    """
    resolve = dispatcher.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        return resolve([_unliteral(arg) for arg in args], kws)

    dispatcher.get_call_template = get_call_template
    return dispatcher
