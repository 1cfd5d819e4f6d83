"""Files and folders that appear whole or not at all.

Whatever is written has a hidden name, ``.amusic-….tmp``, and a lock until it is whole. What has
such a name and no lock is what a killed writer left; the next writer in its folder removes it.
"""

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
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

from amusic_gym.utils.reading import read_json

T = TypeVar("T")

_PREFIX = ".amusic-"
_UNFINISHED = f"{_PREFIX}*.tmp*"
_WRITTEN = f"{_PREFIX}written.json"
_ATTEMPTS = 20
_PATIENCE = 2.0  # seconds to wait for a lock without a word
_swept: set[Path] = set()  # folders that this process has swept for `replacing_file`
_SWAP_UNSUPPORTED = (errno.EINVAL, errno.ENOSYS, errno.ENOTSUP, errno.EXDEV, errno.EPERM)
_OCCUPIED = (errno.ENOTEMPTY, errno.EEXIST)


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
    for last in (*[False] * _ATTEMPTS, True):
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


def read_whole(path: Path, kind: str, read: Callable[[int], T]) -> T:
    """What ``read`` gives of a folder, given its descriptor; again where it is replaced meanwhile.

    ``read`` fails with a FileNotFoundError or ValueError for what is not whole. A folder that is
    replaced all the time is refused with a ValueError, called by its ``kind``.
    """
    for _ in range(_ATTEMPTS):
        with opened_folder(path) as folder:
            try:
                return read(folder)
            except (FileNotFoundError, ValueError):
                if not was_replaced(path, folder):  # else: once more, from the new one
                    raise
    raise ValueError(f"{kind} {path} is being rewritten all the time; load it when that is over")


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
    """Refuse what :func:`replacing_folder` would refuse: anything but its own kind of folder."""
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
    """Put the old folder back if a writer died between its two renames of ``path``.

    The lock of the folder that holds both must be held.
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
