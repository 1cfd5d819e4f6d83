"""Reading files with plain refusals: of what is no regular file, too large, or damaged."""

import errno
import hashlib
import json
import math
import os
import stat
import warnings
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

_MOST_JSON = 2**28  # bytes


@dataclass(frozen=True)
class NpyHeader:
    """What a .npy file says of its array, and where the numbers begin."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    fortran_order: bool
    offset: int

    def mapped(self, path: Path) -> NDArray[Any]:
        """The array, memory-mapped; where it is mapped anew for each piece, pages are let go."""
        order: Literal["C", "F"] = "F" if self.fortran_order else "C"
        return np.memmap(path, self.dtype, "r", self.offset, self.shape, order)


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

    Its name is looked for in the folder of the descriptor ``folder``; None: where ``path`` says.

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


def read_lines(path: Path) -> list[str]:
    """Lines of a text file without blanks around them, empty lines and those that begin with #."""
    with open_file(path) as file:
        lines = file.read().decode("utf-8-sig", "surrogateescape").splitlines()
    return [line.strip() for line in lines if line.strip() and not line.startswith("#")]


def parse_json(content: bytes, path: Path, mend: str, kind: type = dict) -> Any:
    """The object that a JSON file holds; every number in it is finite as a float64.

    ``mend`` says what to do about a damaged one; ``kind`` is list where it holds no object but a
    list.

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
