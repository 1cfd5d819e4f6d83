"""One thread for BLAS, OpenMP, OpenCV and PyTorch.

A sum that several threads share is added up in another order than on one thread, and its last bits
differ. So descriptors and scores are computed on one thread everywhere, in workers and on the
robot, and work is spread over images and blocks instead.

While a process forks, OpenCV has one thread, too: in a child that has only inherited the others,
it would hang.
"""

import contextlib
import os
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class _Limits:
    """The limits in force in this process, and how to undo them."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.depth = 0
        self.undo = contextlib.ExitStack()
        self.limited_at = -1  # how many modules were loaded when libraries were last limited
        self.known_at = -1  # … and when they were last looked for, which takes milliseconds
        self.controller: Any = None

    def look(self) -> Any:
        """The controller of all BLAS and OpenMP libraries that are loaded."""
        if self.known_at != len(sys.modules):
            from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

            self.controller = ThreadpoolController()
            self.known_at = len(sys.modules)
        return self.controller

    def extend(self) -> bool:
        """Limit what was loaded since the last time; whether there may be something."""
        with self.lock:
            controller = self.look()
            if self.limited_at == self.known_at:
                return False
            self.limited_at = self.known_at
            self.undo.enter_context(controller.limit(limits=1))
            for name, get, put in (
                ("cv2", "getNumThreads", "setNumThreads"),
                ("torch", "get_num_threads", "set_num_threads"),
            ):
                module = sys.modules.get(name)
                if hasattr(module, put):  # not where another thread is importing it just now
                    self.undo.callback(getattr(module, put), getattr(module, get)())
                    getattr(module, put)(1)
            return True

    def enter(self) -> None:
        with self.lock:
            self.depth += 1
            self.extend()

    def leave(self) -> None:
        with self.lock:
            self.depth -= 1
            if not self.depth:
                self.limited_at = -1
                self.undo.close()


_limits = _Limits()


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Everything inside runs on one thread of each library that is loaded by then.

    It may be nested, and used by several Python threads at once: what was before comes back when
    the last of them leaves. Nothing is loaded for it but threadpoolctl. For a call that may load
    a library itself, use :func:`alone`.
    """
    _limits.enter()
    try:
        yield
    finally:
        _limits.leave()


def alone(function: Callable[P, R], *arguments: P.args, **options: P.kwargs) -> R:
    """``function(*arguments, **options)`` on one thread of each library, and its result.

    A function may load a library by its first call, which then has all its threads. Such a call
    is made once more, so ``function`` must give the same each time.
    """
    with one_thread():
        result = function(*arguments, **options)
        return function(*arguments, **options) if _limits.extend() else result


def limit_this_thread() -> None:
    """Limit OpenMP in a new Python thread that works inside another's :func:`one_thread`.

    OpenMP keeps its number of threads per thread. What all threads share is restored by the one
    that is in :func:`one_thread`.
    """
    with _limits.lock:
        _limits.look().limit(limits=1)


_opencv: list[int | None] = []  # OpenCV's number of threads, of each fork that is under way


def _end_opencv_threads() -> None:
    """Before a fork: a child would inherit OpenCV's pool without its threads, and wait for them."""
    cv2 = sys.modules.get("cv2")
    put = getattr(cv2, "setNumThreads", None)  # not while another thread imports it
    _opencv.append(None if put is None else cv2.getNumThreads())  # type: ignore[union-attr]
    if put is not None:
        put(1)  # waits for what another thread does with them


def _allow_opencv_threads() -> None:
    number = _opencv.pop()
    if number is not None:
        sys.modules["cv2"].setNumThreads(number)


def _renew_lock() -> None:
    """In a fork's child: the thread that held the lock may not be there."""
    _limits.lock = threading.RLock()
    _allow_opencv_threads()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=_end_opencv_threads,
        after_in_parent=_allow_opencv_threads,
        after_in_child=_renew_lock,
    )
