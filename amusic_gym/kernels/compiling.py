"""How this project compiles its numeric kernels: the one place that talks to Numba's decorators."""

from __future__ import annotations

import contextlib
import pickle
import sys
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from numba import njit, types
from numba.core.caching import FunctionCache
from numba.extending import intrinsic

from amusic_gym.utils.imports import digest_of, source_files

Function = TypeVar("Function", bound=Callable[..., Any])

INNER = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True, "error_model": "numpy"}

_unliteral: Any = types.unliteral
_FunctionCache: Any = FunctionCache
_njit: Any = njit  # its stubs know neither the cache nor the options without wrappers


class _Cache(_FunctionCache):  # type: ignore[misc]
    """Numba's cache of a function's machine code, stale when any file that it is made of changes.

    Numba watches only the file of the function itself, but machine code holds that of its callees
    too, and constants of other files. A damaged cache is begun anew, and one that cannot be
    written is gone without.
    """

    def __init__(self, function: Callable[..., Any]) -> None:
        super().__init__(function)
        files = source_files(Path(function.__code__.co_filename), lazily=False)
        self._cache_file._source_stamp = self._cache_file._source_stamp, digest_of(*files)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        found = None
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # whatever a pickle that is cut short or overwritten may raise
            with contextlib.suppress(OSError):
                self.flush()
        if found is None:
            _announce()
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)
        except (OSError, EOFError, pickle.UnpicklingError):
            _warn_of_no_cache()


def _cached(function: Function, **options: bool) -> Function:
    """Numba's dispatcher of ``function``, whose machine code is cached where that can be."""
    compiled_function: Function
    dispatcher = _njit(error_model="numpy", **options)(function)
    try:
        dispatcher._cache = _Cache(function)  # as its enable_caching does
    except (RuntimeError, OSError):  # neither beside the source nor in the home can be written
        _warn_of_no_cache()
    compiled_function = dispatcher
    return compiled_function


@cache
def _announce() -> None:
    """Say on a terminal why nothing happens for some seconds."""
    if sys.stderr.isatty():
        print("amusic_gym: compiling kernels, once; this takes 10 to 30 seconds", file=sys.stderr)


@cache
def _warn_of_no_cache() -> None:
    warnings.warn(
        "compiled code cannot be kept here and is compiled anew in every process; set"
        " NUMBA_CACHE_DIR to a folder that can be written",
        stacklevel=2,
    )


def compiled(function: Function) -> Function:
    """Compile ``function`` on first use; the machine code is cached beside the source."""
    return _cached(function)


def without_gil(function: Function) -> Function:
    """As :func:`compiled`, to run beside other Python threads."""
    return _cached(function, nogil=True)


def inner(function: Function) -> Function:
    """Compile a ``function`` into the compiled ones that call it.

    It has no way in from Python, which makes it sooner compiled, and is cached with its callers.
    Inlining pays: without it, a third of a step went into counting references to array views.
    """
    compiled_function: Function = _once(_njit(**INNER, forceinline=True)(function))
    return compiled_function


def summing(function: Function) -> Function:
    """As :func:`apart`, for sums in any order: their loops run in SIMD, on finite numbers only.

    The order is that of the machine's lanes, and differs between machines. The function must write
    to no array: LLVM lets a loop that does run in SIMD only where arrays are far enough from each
    other, so that the order would depend on where they lie.
    """
    freely = {"reassoc", "nsz", "nnan"}
    compiled_function: Function = _once(_njit(**INNER, fastmath=freely)(function))
    return compiled_function


def apart(function: Function) -> Function:
    """As :func:`inner`, but kept out of its callers' code: for what runs rarely, or is large.

    What is inlined is optimised anew in each caller. A call costs little where arguments are
    numbers and tables; arrays among them are counted.
    """
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


def _larger(typing_context: Any, one: types.Type, other: types.Type) -> Any:
    """The larger of two numbers that are not NaN; the highest of many runs in SIMD by it."""

    def codegen(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        flags = ("nnan", "nsz")
        more = builder.fcmp_ordered(">", *arguments, flags=flags)
        return builder.select(more, *arguments, flags=flags)

    return one(one, one), codegen


larger: Any = intrinsic(_larger)
