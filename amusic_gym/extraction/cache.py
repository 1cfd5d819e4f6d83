"""The cache: what was computed once, kept under a digest of all that it depends on.

An entry is 64 hexadecimal digits of SHA-256 and then a ``.npy`` file. The digest is of the entry's
key and of the ``.npy`` file, so an entry that is cut off, changed or under a wrong name is noticed.
It is compared the first time that a run uses the entry.
"""

import errno
import hashlib
import os
import tempfile
import warnings
from contextlib import AbstractContextManager, nullcontext
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from amusic_gym.extraction.blocks import Stored
from amusic_gym.utils import reading, storage
from amusic_gym.utils.closing import Closing

_DIGEST = 64  # bytes at the start; keeps the numbers aligned too
_INCOMING = "incoming"
_READ_ONLY = (errno.EACCES, errno.EPERM, errno.EROFS)
_ATTEMPTS = 3


def default_cache() -> Path:
    """``$XDG_CACHE_HOME/amusic-gym``, or ``~/.cache/amusic-gym``; refuses a user without a home."""
    given = os.environ.get("XDG_CACHE_HOME", "")
    try:
        base = Path(given) if os.path.isabs(given) else Path.home() / ".cache"
    except RuntimeError as error:
        raise ValueError(
            "no home folder is known for the cache; choose a folder for the cache (--cache DIR)"
        ) from error
    return base / "amusic-gym"


class Cache(Closing):
    """A folder of entries, shared by any number of processes.

    Entries appear whole or not at all. What writers that were killed left behind is swept when
    the folder is opened. Where nothing can be written, one warning says so, what is there is
    still read, and new entries go to a temporary folder, which :meth:`close` removes. The default
    folder may be unusable in any way for that; a folder that was given must be one.

    The folder grows with every new route and setting. Any part of it may be deleted at any time.

    Args:
        folder: where; None: :func:`default_cache`.

    Raises:
        ValueError: for a path that is a file.
    """

    def __init__(self, folder: str | os.PathLike[str] | None = None) -> None:
        self.folder = Path(os.path.abspath(folder or default_cache()))
        if folder and self.folder.exists() and not self.folder.is_dir():
            raise ValueError(f"the cache {self.folder} is a file; give a folder")
        self._folders = [self.folder]  # the first to write to, all to look in
        self._temporary: tempfile.TemporaryDirectory[str] | None = None
        self._checked: set[Path] = set()
        self._damaged = 0
        try:
            _prepare(self.folder)
        except OSError as error:
            if folder and error.errno not in _READ_ONLY:
                raise OSError(
                    error.errno,
                    f"the cache {self.folder} cannot be used ({error.strerror or error}); "
                    "choose another folder",
                ) from error
            warnings.warn(
                f"the cache {self.folder} cannot be written ({error.strerror}); what is computed "
                "now is not kept for the next time: choose another folder for the cache "
                "(--cache DIR)",
                stacklevel=2,
            )
            self._temporary = tempfile.TemporaryDirectory(prefix="amusic-gym-")
            self._folders.insert(0, Path(self._temporary.name))
            _prepare(self._folders[0])

    @property
    def is_temporary(self) -> bool:
        """Whether new entries go to a temporary folder."""
        return self._temporary is not None

    def get(self, key: str) -> Stored | None:
        """The entry ``key``; None where there is none, or only a damaged one.

        The first damaged one is warned of, further ones are counted until :meth:`close`.

        Raises:
            OSError: for a folder in its place.
        """
        for folder in self._folders:
            path = _path(folder, key)
            try:
                with path.open("rb") as file:
                    return self._examine(file, path, key)
            except (FileNotFoundError, NotADirectoryError, PermissionError):
                continue
            except IsADirectoryError as error:
                if folder == self._folders[0]:  # where it would be written
                    raise OSError(
                        f"the cache's {path} is a folder, where a file should be; remove it"
                    ) from error
            except (OSError, ValueError) as error:
                self._damaged += 1
                if self._damaged == 1:
                    warnings.warn(
                        f"the cache's {path} is damaged ({error}); it is computed again",
                        stacklevel=2,
                    )
        return None

    def put(self, key: str, array: NDArray[np.float32]) -> Stored:
        """Keep ``array`` under ``key`` and return where it is.

        Raises:
            OSError: when it cannot be written; an entry that was there is still there.
        """
        folder = self._folders[0]
        path = _path(folder, key)
        for attempt in range(_ATTEMPTS):
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
                with storage.unfinished(folder / _INCOMING) as temporary:
                    _write(temporary, key, array)
                    os.replace(temporary, path)
                break
            except FileNotFoundError:  # the cache is being deleted
                if attempt == _ATTEMPTS - 1:
                    raise
            except OSError as error:
                raise OSError(
                    error.errno,
                    f"writing the cache {folder} failed ({error.strerror or error}), nothing is "
                    "lost; free some space or choose another folder for the cache",
                ) from error
        self._checked.add(path)
        with path.open("rb") as file:
            return self._examine(file, path, key)

    def _examine(self, file: BufferedReader, path: Path, key: str) -> Stored:
        """An entry's address; its checksum is compared once."""
        if path not in self._checked:
            expected = file.read(_DIGEST)
            if not expected:
                raise ValueError("it is empty")
            if _digest(file, key) != expected:
                raise ValueError("its checksum differs")
            self._checked.add(path)
        file.seek(_DIGEST)
        header = reading.read_npy_header(file, path)
        if header.dtype != np.float32 or header.fortran_order:
            raise ValueError(f"it holds {header.dtype}")
        return Stored(path, header.offset, header.shape)

    def close(self) -> None:
        """Remove the temporary folder, where there is one; say how much was damaged."""
        if self._temporary is not None:
            self._temporary.cleanup()
        damaged, self._damaged = self._damaged, 0
        if damaged > 1:
            warnings.warn(
                f"{damaged} entries of the cache {self.folder} were damaged", stacklevel=2
            )


def opened(cache: str | os.PathLike[str] | Cache | None) -> AbstractContextManager[Cache]:
    """A cache's folder, or the default one, for a ``with`` block; one that is open stays open."""
    return nullcontext(cache) if isinstance(cache, Cache) else Cache(cache)


def _prepare(folder: Path) -> None:
    (folder / _INCOMING).mkdir(parents=True, exist_ok=True)
    storage.sweep(folder / _INCOMING)
    with storage.unfinished(folder / _INCOMING):  # fails where nothing can be written
        pass


def _path(folder: Path, key: str) -> Path:
    return folder / key[:2] / f"{key}.entry"


def _digest(file: BinaryIO, key: str) -> bytes:
    """Digest of the key and all of the file from where it stands."""
    digest = hashlib.sha256(key.encode())
    while piece := file.read(1 << 20):
        digest.update(piece)
    return digest.hexdigest().encode()


def _write(path: Path, key: str, array: NDArray[np.float32]) -> None:
    with path.open("r+b") as file:
        file.write(bytes(_DIGEST))
        np.lib.format.write_array(file, np.ascontiguousarray(array, "<f4"), allow_pickle=False)
        file.seek(_DIGEST)
        digest = _digest(file, key)
        file.seek(0)
        file.write(digest)
