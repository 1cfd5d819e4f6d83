"""Files and folders that appear whole or not at all, and what is read with plain refusals.

Whatever is written has a hidden name, ``.amusic-….tmp``, and a lock until it is whole. What has
such a name and no lock is what a killed writer left; the next writer in its folder removes it.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import hashlib
import json
import math
import os
import secrets
import shutil
import stat
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

_PREFIX = ".amusic-"
_UNFINISHED = f"{_PREFIX}*.tmp*"
_WRITTEN = f"{_PREFIX}written.json"
_MOST_JSON = 2**28  # bytes
_OPEN_ATTEMPTS = 20
_PATIENCE = 2.0
"""Seconds to wait for a lock without a word."""

_swept: set[Path] = set()
"""Folders that this process has swept for `replacing_file`."""

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
            first = np.lib.format.read_magic(file) == (1, 0)
            form = np.lib.format
            read = form.read_array_header_1_0 if first else form.read_array_header_2_0
            shape, fortran, dtype = read(file)
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


def parse_json(content: bytes, path: Path, mend: str, kind: type = dict) -> Any:
    """The object that a JSON file holds; every number in it is finite as a float64.

    Args:
        content: of the file.
        path: of the file, for messages.
        mend: what to do about a damaged one, for messages.
        kind: list, where it holds no object but a list.

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
        raise ValueError(f"{path} is damaged (it {what}); {mend}") from None
    if not isinstance(parsed, kind):
        wanted = "list" if kind is list else "object"
        raise ValueError(f"{path} is damaged (it holds no JSON {wanted}); {mend}")
    return parsed


def read_json(path: Path, mend: str, kind: type = dict) -> Any:
    """What a JSON file of at most `_MOST_JSON` bytes holds; see `read_regular`, `parse_json`."""
    return parse_json(read_regular(path, _MOST_JSON), path, mend, kind)


def sha256(file: BufferedReader) -> str:
    """Checksum of a whole open file as 64 hexadecimal digits."""
    file.seek(0)
    return hashlib.file_digest(file, "sha256").hexdigest()


@contextlib.contextmanager
def opened_folder(path: Path) -> Iterator[int]:
    """Descriptor of a folder, by which its files are found even if another takes its name.

    One that `replacing_folder` exchanges at this moment, or whose writer died in the middle, is
    found, too.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: when it is a file.
    """
    flags = os.O_RDONLY | os.O_DIRECTORY
    for last in (*[False] * _OPEN_ATTEMPTS, True):
        try:
            descriptor = os.open(path, flags)
            break
        except FileNotFoundError:
            if last:
                raise FileNotFoundError(f"{path} does not exist; check the name") from None
        except NotADirectoryError:
            raise ValueError(f"{path} is a file; give a folder") from None
        if _asides(path):
            with locked(path.parent):  # once it is free, nobody is between two renames
                _restore_folder(path)
    try:
        yield descriptor
    finally:
        os.close(descriptor)


def was_replaced(path: Path, descriptor: int) -> bool:
    """Whether a folder's name means another folder than its descriptor by now."""
    try:
        return not os.path.samestat(os.fstat(descriptor), os.stat(path))
    except FileNotFoundError:
        return True


@contextlib.contextmanager
def _nothing_changed(path: Path) -> Iterator[None]:
    """An OSError in the block says that ``path`` is as it was."""
    try:
        yield
    except OSError as error:
        raise OSError(
            error.errno,
            f"writing {path} failed ({error.strerror or error}); nothing was changed there: "
            "free some space or choose another folder",
        ) from error


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
    with _nothing_changed(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        with locked(path.parent):  # one writer at a time looks, sweeps and renames
            refuse_to_replace_others(path, marker, contents)
            _sweep_exchange(path)
        sweep(path.parent)
        with unfinished(path.parent, make=Path.mkdir) as folder:
            yield folder
            for file in (*folder.iterdir(), folder):
                _fsync(file)
            with locked(path.parent):
                refuse_to_replace_others(path, marker, contents)
                _exchange(folder, path)
            with contextlib.suppress(OSError):  # the new folder stands; not all systems sync names
                _fsync(path.parent)


def refuse_to_replace_others(path: Path, marker: str, contents: frozenset[str]) -> None:
    """Refuse what :func:`replacing_folder` would refuse: anything but its own kind of folder.

    Raises:
        ValueError: when ``path`` is something that must not be replaced.
    """
    try:
        found = {entry.name for entry in path.iterdir()}
    except FileNotFoundError:  # perhaps while another writer exchanges it
        return
    except NotADirectoryError:
        raise ValueError(f"{path} exists and is not a folder; choose another name") from None
    if found and (marker not in found or found - contents):
        other = sorted(found - contents) or sorted(found)
        raise ValueError(
            f"{path} exists and holds other files ({other[0]}), which would be lost; "
            "choose another name"
        )


@contextlib.contextmanager
def replacing_file(path: Path) -> Iterator[Path]:
    """Yield an empty file that takes the place of ``path`` when the block ends well.

    Whatever happens (an error, a full disk, SIGKILL), ``path`` holds the old file or the new one,
    whole.

    Args:
        path: the final name; its parents are made.

    Raises:
        OSError: when writing fails; nothing at ``path`` has changed then.
    """
    with _nothing_changed(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        parent = Path(os.path.realpath(path.parent))
        if parent not in _swept:
            _swept.add(parent)
            sweep(parent)
        with unfinished(path.parent, path.suffix) as temporary:
            yield temporary
            os.replace(temporary, path)


def write_whole(path: str | os.PathLike[str], content: bytes) -> Path:
    """Write a file, whole or not at all, and make its folder; see `replacing_file`."""
    path = Path(path)
    with replacing_file(path) as temporary:
        temporary.write_bytes(content)
    return path


def keep_only(folder: Path, kind: str, files: Iterable[str | Path]) -> None:
    """Remove the files of a kind that an earlier run wrote to ``folder`` and this one did not.

    Only what was named in an earlier call is ever removed.

    Args:
        folder: with `_WRITTEN`, which remembers what was written.
        kind: of files; others stay.
        files: of this run, in ``folder`` or below.
    """
    path = folder / _WRITTEN
    written: dict[str, Any] = {}
    with contextlib.suppress(FileNotFoundError, ValueError):  # a damaged one is begun anew
        written = read_json(path, "delete it")
    names = [Path(file).relative_to(folder).as_posix() for file in files]
    before = written.get(kind)
    for name in before if isinstance(before, list) else []:
        below = isinstance(name, str) and not os.path.isabs(name) and ".." not in Path(name).parts
        if below and name not in names:
            with contextlib.suppress(OSError):
                (folder / name).unlink()
    if before != names:
        write_whole(path, json.dumps({**written, kind: names}, indent=1).encode() + b"\n")


@contextlib.contextmanager
def unfinished(
    folder: Path, suffix: str = "", make: Callable[[Path], object] = Path.touch
) -> Iterator[Path]:
    """Yield a new file or folder in ``folder`` that is gone at the end, unless it was renamed.

    Its permissions are those that the umask gives. While it is locked nobody sweeps it.

    Args:
        folder: where.
        suffix: end of its name.
        make: makes it; default: an empty file.
    """
    while True:
        path = folder / f"{_PREFIX}{secrets.token_hex(8)}.tmp{suffix}"
        make(path)
        try:
            with contextlib.ExitStack() as alive:
                try:
                    alive.enter_context(locked(path))
                except FileNotFoundError:
                    continue  # swept before it was locked
                if path.exists():
                    yield path
                    return
        finally:
            _remove(path)


@contextlib.contextmanager
def only_writer(folder: Path) -> Iterator[None]:
    """Hold ``folder``, which is made, for this process alone among those that ask so.

    What was made is gone at the end if nothing was written to it.

    Raises:
        ValueError: when another process holds it.
    """
    made = [each for each in (folder, *folder.parents) if not each.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    with contextlib.ExitStack() as alone:
        try:
            alone.enter_context(locked(folder, wait=False))
        except BlockingIOError:
            raise ValueError(
                f"{folder} is in use by another process; wait for its end or give another folder"
            ) from None
        try:
            yield
        finally:
            with contextlib.suppress(OSError):  # not empty
                for each in made:
                    each.rmdir()


@contextlib.contextmanager
def locked(path: Path, wait: bool = True) -> Iterator[bool]:
    """Hold the lock on a file or folder, which the system drops when the process ends.

    Yields:
        False where the file system has no locks: writers then go on without, and nothing is swept.

    Raises:
        BlockingIOError: where it is taken, with ``wait=False``.
    """
    descriptor = os.open(path, os.O_RDONLY)
    try:
        yield _lock(descriptor, path, wait)
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path, wait: bool) -> bool:
    patience = time.monotonic() + _PATIENCE
    while True:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return True
        except BlockingIOError:
            if not wait:
                raise
        except OSError:
            return False
        if time.monotonic() > patience:
            patience = math.inf
            warnings.warn(
                f"waiting for the lock on {path}, which another process holds (or `flock`, if it"
                " runs this command: let it lock something else)",
                stacklevel=2,
            )
        time.sleep(0.01)


def is_unfinished(path: Path) -> bool:
    """Whether a file or folder has the name of one that is being written, or never was whole."""
    return path.match(_UNFINISHED)


def sweep(folder: Path) -> None:
    """Remove what killed writers left unfinished in ``folder``, and nothing else."""
    for path in folder.glob(_UNFINISHED):
        with contextlib.suppress(OSError), locked(path, wait=False) as dead:
            if dead:
                _remove(path)


def _remove(path: Path) -> None:
    with contextlib.suppress(OSError):
        if path.is_dir():
            shutil.rmtree(path, ignore_errors=True)
        else:
            path.unlink()


def _sweep_exchange(path: Path) -> None:
    """Mend the half exchange of ``path`` that a dead writer left."""
    _restore_folder(path)
    stale = _asides(path)
    if path.exists():  # looked at after the list was made, so each of these has been replaced
        for aside in stale:
            shutil.rmtree(aside, ignore_errors=True)


def _restore_folder(path: Path) -> None:
    """Put the old folder back if a writer died while it exchanged ``path`` by two renames.

    Needed only where the system cannot swap two folders in one step; the lock of the folder that
    holds both must be held.
    """
    if not path.exists():
        for aside in _asides(path):
            with contextlib.suppress(OSError):
                os.rename(aside, path)


def _exchange(folder: Path, path: Path) -> None:
    """Rename ``folder`` to ``path``; what was at ``path`` is left to `unfinished`, or removed."""
    try:
        os.rename(folder, path)  # nothing there, or an empty folder
        return
    except OSError as error:
        if error.errno not in _OCCUPIED:
            raise
    if _swap(folder, path):
        return
    # A writer killed between the two renames leaves the old folder aside: see `_restore_folder`.
    aside = path.parent / f"{_aside_stem(path)}{secrets.token_hex(8)}.old"
    os.rename(path, aside)
    try:
        os.rename(folder, path)
    except OSError:
        os.rename(aside, path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _swap(first: Path, second: Path) -> bool:
    """Exchange two folders in one step; False where the system cannot."""
    library = ctypes.CDLL(None, use_errno=True)
    names = os.fsencode(first), os.fsencode(second)
    swap_flag = ctypes.c_uint(2)  # RENAME_EXCHANGE on Linux, RENAME_SWAP on macOS
    if hasattr(library, "renameat2"):
        here = -100  # AT_FDCWD; both paths are absolute
        failed = library.renameat2(here, names[0], here, names[1], swap_flag)
    elif hasattr(library, "renamex_np"):
        failed = library.renamex_np(*names, swap_flag)
    else:
        return False
    number = ctypes.get_errno()
    if failed and number not in _SWAP_UNSUPPORTED:
        raise OSError(number, os.strerror(number), os.fspath(second))
    return not failed


def _asides(path: Path) -> list[Path]:
    """Old folders of ``path`` that a writer has put aside, or died over."""
    return list(path.parent.glob(f"{_aside_stem(path)}*.old"))


def _aside_stem(path: Path) -> str:
    return f"{_PREFIX}{hashlib.sha256(os.fsencode(path.name)).hexdigest()[:16]}-"


def _fsync(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
