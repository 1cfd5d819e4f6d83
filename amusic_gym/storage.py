"""Folders that appear whole or not at all, and arrays read from disk with plain refusals."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import hashlib
import json
import math
import os
import secrets
import shutil
import stat
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PREFIX = ".amusic-"
_SWAP_UNSUPPORTED = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EXDEV, errno.EPERM)
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST)


@dataclass(frozen=True)
class NpyHeader:
    """What a .npy file says of its array, and where the numbers begin."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool
    offset: int


def read_npy_header(file: BufferedReader, path: Path) -> NpyHeader:
    """Header of the .npy file that is open as ``file``; leaves the file at its first number.

    Raises:
        ValueError: when it is no .npy file, or holds another number of bytes than it says.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers written by Python 2
            version = np.lib.format.read_magic(file)
            if version == (1, 0):
                shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
            else:
                shape, fortran, dtype = np.lib.format.read_array_header_2_0(file)
        if not all(0 <= size < 2**63 for size in shape):
            raise ValueError(shape)
    except Exception:  # garbage raises nearly anything: tokens, syntax, values, recursion
        size = os.fstat(file.fileno()).st_size
        what = "is empty" if size == 0 else "is not a NumPy .npy file (or its header is damaged)"
        raise ValueError(f"{path} {what}; write it again with numpy.save") from None
    offset = file.tell()
    if not dtype.hasobject:
        expected = offset + math.prod(shape) * dtype.itemsize
        size = os.fstat(file.fileno()).st_size
        if size != expected:
            what = "truncated" if size < expected else "too long"
            raise ValueError(
                f"{path} is {what}: {size} bytes where its header says {expected}; "
                "copy or write it again"
            )
    return NpyHeader(dtype, shape, fortran, offset)


def read_array(path: str | os.PathLike[str]) -> NDArray[Any]:
    """The array of a .npy file; pickled objects are refused, never executed.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no whole .npy file of numbers.
    """
    path = Path(path)
    with open_file(path) as file:
        if read_npy_header(file, path).dtype.hasobject:
            raise ValueError(
                f"{path} holds pickled Python objects, which can run code when read; "
                "save it as a plain array of numbers"
            )
        file.seek(0)
        array: NDArray[Any] = np.load(file, allow_pickle=False)
    return array


def open_file(path: Path, folder: int | None = None) -> BufferedReader:
    """The regular file ``path`` open for reading: a pipe would be waited for, a device never end.

    Args:
        path: the file.
        folder: descriptor of the folder to find its name in; None: wherever ``path`` says.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for a folder, a pipe, a socket or a device.
    """

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | getattr(os, "O_NONBLOCK", 0), dir_fd=folder)

    try:
        file = open(path if folder is None else path.name, "rb", opener=opener)
    except (FileNotFoundError, NotADirectoryError):
        raise FileNotFoundError(f"{path} does not exist; check the name") from None
    except IsADirectoryError:
        raise ValueError(f"{path} is a folder; give a file") from None
    except OSError as error:
        if error.errno != errno.ENXIO:  # of a socket
            raise
    else:
        if stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            return file
        file.close()
    raise ValueError(f"{path} is a device or a pipe; give a regular file")


def read_regular(path: Path, limit: int, folder: int | None = None) -> bytes:
    """Content of a regular file of at most ``limit`` bytes; arguments as of `open_file`.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: for what is no regular file, or a larger one.
    """
    with open_file(path, folder) as file:
        size = os.fstat(file.fileno()).st_size
        content = file.read(min(size, limit) + 1)  # so much is allocated at once
    if len(content) > limit:
        raise ValueError(
            f"{path} has more than the {limit} bytes that such a file may have; check that it is "
            "the right one"
        )
    return content


def parse_json(content: bytes, path: Path, mend: str) -> dict[str, Any]:
    """The object that a JSON file holds; every number in it is finite as a float64.

    Args:
        content: of the file.
        path: of the file, for messages.
        mend: what to do about a damaged one, for messages.

    Raises:
        ValueError: for anything else, also for what is nested too deep.
    """

    def finite(text: str) -> float:
        number = float(text)
        if not math.isfinite(number):
            raise ValueError(text)
        return number

    def whole(text: str) -> int:
        finite(text)
        return int(text)

    try:
        parsed = json.loads(
            content.decode("utf-8"), parse_int=whole, parse_float=finite, parse_constant=finite
        )
        json.dumps(parsed)  # what can be read may still be too deep to be written
    except (ValueError, RecursionError):
        what = "is not whole JSON of finite numbers" if content.strip() else "is empty"
        raise ValueError(f"{path} {what}; {mend}") from None
    if not isinstance(parsed, dict):
        raise ValueError(f"{path} holds no JSON object; {mend}")
    return parsed


def sha256(file: BufferedReader) -> str:
    """Checksum of a whole open file as 64 hexadecimal digits."""
    file.seek(0)
    return hashlib.file_digest(file, "sha256").hexdigest()


class FolderReader:
    """Opens the files of one folder, the same one even if another takes its name meanwhile.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it is a file.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._descriptor: int | None = None
        try:
            if os.open in os.supports_dir_fd:
                self._descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
            else:
                os.listdir(path)
        except FileNotFoundError:
            raise FileNotFoundError(f"{path} does not exist; check the name") from None
        except NotADirectoryError:
            raise ValueError(f"{path} is a file; give a folder") from None

    def open(self, name: str) -> BufferedReader:
        """The folder's file ``name``, open for reading; raises as :func:`open_file`."""
        return open_file(self.path / name, self._descriptor)

    def read(self, name: str, limit: int) -> bytes:
        """Content of the folder's file ``name``; raises as :func:`read_regular`."""
        return read_regular(self.path / name, limit, self._descriptor)

    def was_replaced(self) -> bool:
        """Whether the folder's name means another folder by now."""
        if self._descriptor is None:
            return False
        try:
            return not os.path.samestat(os.fstat(self._descriptor), os.stat(self.path))
        except FileNotFoundError:
            return True

    def __enter__(self) -> FolderReader:
        return self

    def __exit__(self, *_: object) -> None:
        if self._descriptor is not None:
            os.close(self._descriptor)


@contextlib.contextmanager
def replacing_folder(path: Path, marker: str, contents: frozenset[str]) -> Iterator[Path]:
    """Yield an empty folder that takes the place of ``path`` when the block ends well.

    Whatever happens (an error, a full disk, SIGKILL), ``path`` holds the old folder or the new
    one, whole. Leftovers of writers that died are swept by the next one. Of two writers at once,
    the later rename wins.

    Args:
        path: the final name; its parents are made.
        marker: the file by which a folder of this kind is known.
        contents: all the files such a folder may hold: any other folder is never replaced.

    Raises:
        ValueError: when ``path`` is something that must not be replaced.
        OSError: when writing fails; nothing at ``path`` has changed then.
    """
    path = Path(os.path.realpath(path))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with _locked(path.parent):  # one writer at a time looks, sweeps and renames
            refuse_to_replace_others(path, marker, contents)
            _sweep(path)
            folder = path.parent / f"{_PREFIX}{secrets.token_hex(8)}.tmp"
            folder.mkdir()
            alive = contextlib.ExitStack()
            alive.enter_context(_locked(folder))
        with alive, _removed_at_the_end(folder):
            yield folder
            for file in (*folder.iterdir(), folder):
                _fsync(file)
            with _locked(path.parent):
                refuse_to_replace_others(path, marker, contents)
                _move_into_place(folder, path)
            with contextlib.suppress(OSError):  # the new folder stands; not all systems sync names
                _fsync(path.parent)
    except OSError as error:
        raise OSError(
            f"writing {path} failed ({error.strerror or error}); nothing was changed there: "
            "free some space or choose another folder"
        ) from error


def restore_folder(path: Path) -> None:
    """Put the old folder back if a writer died while it exchanged ``path`` by two renames.

    Needed only where the system cannot swap two folders in one step.
    """
    if not path.exists():
        for aside in path.parent.glob(f"{_aside_stem(path)}*.old"):
            with contextlib.suppress(OSError):
                os.rename(aside, path)


def refuse_to_replace_others(path: Path, marker: str, contents: frozenset[str]) -> None:
    """Refuse what :func:`replacing_folder` would refuse: anything but its own kind of folder.

    Raises:
        ValueError: when ``path`` is something that must not be replaced.
    """
    if not path.exists():
        return
    if not path.is_dir():
        raise ValueError(f"{path} exists and is not a folder; choose another name")
    found = {entry.name for entry in path.iterdir()}
    if found and (marker not in found or found - contents):
        other = sorted(found - contents) or sorted(found)
        raise ValueError(
            f"{path} exists and holds other files ({other[0]}), which would be lost; "
            "choose another name"
        )


@contextlib.contextmanager
def _removed_at_the_end(folder: Path) -> Iterator[None]:
    try:
        yield
    finally:
        shutil.rmtree(folder, ignore_errors=True)  # unfinished work, or the folder replaced


@contextlib.contextmanager
def _locked(folder: Path, wait: bool = True) -> Iterator[bool]:
    """Hold the lock on ``folder`` itself, which the system drops when the process ends.

    Yields:
        False where it is taken (``wait=False``) or the file system has no locks: writers then go
        on without, and nothing is swept.
    """
    import fcntl  # POSIX only: here, so that reading works elsewhere

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        except OSError:
            yield False
        else:
            yield True
    finally:
        os.close(descriptor)


def _sweep(path: Path) -> None:
    """Remove what dead writers left next to ``path``, and their half exchange of ``path``."""
    restore_folder(path)
    stale = list(path.parent.glob(f"{_aside_stem(path)}*.old"))
    if path.exists():  # looked at after the list was made, so each of these has been replaced
        for aside in stale:
            shutil.rmtree(aside, ignore_errors=True)
    for folder in path.parent.glob(f"{_PREFIX}*.tmp"):
        with contextlib.suppress(OSError), _locked(folder, wait=False) as dead:
            if dead:
                shutil.rmtree(folder, ignore_errors=True)


def _move_into_place(folder: Path, path: Path) -> None:
    """Rename ``folder`` to ``path``; what was at ``path`` is left to the sweep or removed."""
    while True:
        try:
            os.rename(folder, path)  # nothing there, or an empty folder
            return
        except OSError as error:
            if error.errno not in _OCCUPIED:
                raise
        if _swap(folder, path) or _replace_by_two_renames(folder, path):
            return


def _replace_by_two_renames(folder: Path, path: Path) -> bool:
    """Move ``path`` aside and ``folder`` in; False when another writer came between.

    A writer killed between the two leaves the old folder aside: `restore_folder` puts it back.
    """
    aside = path.parent / f"{_aside_stem(path)}{secrets.token_hex(8)}.old"
    with contextlib.suppress(FileNotFoundError):  # another writer has just moved it aside
        os.rename(path, aside)
    try:
        os.rename(folder, path)
    except OSError as error:
        if error.errno not in _OCCUPIED:
            with contextlib.suppress(OSError):
                os.rename(aside, path)
            raise
        shutil.rmtree(aside, ignore_errors=True)
        return False
    shutil.rmtree(aside, ignore_errors=True)
    return True


def _swap(first: Path, second: Path) -> bool:
    """Exchange two folders in one step; False where the system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    swap_flag = 2  # RENAME_EXCHANGE on Linux, RENAME_SWAP on macOS
    if sys.platform == "darwin" and hasattr(library, "renamex_np"):
        failed = library.renamex_np(*names, ctypes.c_uint(swap_flag))
    elif sys.platform == "linux" and hasattr(library, "renameat2"):
        here = -100  # AT_FDCWD; both paths are absolute
        failed = library.renameat2(here, names[0], here, names[1], ctypes.c_uint(swap_flag))
    else:
        return False
    if not failed:
        return True
    number = ctypes.get_errno()
    if number in (*_SWAP_UNSUPPORTED, errno.ENOENT):
        return False
    raise OSError(number, os.strerror(number), os.fspath(second))


def _aside_stem(path: Path) -> str:
    return f"{_PREFIX}{hashlib.sha256(os.fsencode(path.name)).hexdigest()[:16]}-"


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
