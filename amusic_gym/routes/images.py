"""Images from files: whole, of a bearable size, upright; or refused with a sentence.

One rule for every kind of file (JPEG, PNG, BMP, PNM, TIFF, WebP): the image is what a viewer shows,
as 8-bit colour. EXIF rotation is applied; grey becomes three equal channels; a palette is looked
up; of 16 bits per channel the upper eight stay (in a TIFF, to within 1); alpha is dropped and the
colour beneath it kept. The pixels are OpenCV's.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

import numpy as np

from amusic_gym import storage
from amusic_gym.routes.image_headers import KINDS, measure
from amusic_gym.techniques.protocol import Image

MAX_PIXELS = 100_000_000
"""Width times height that is read unless more is asked for: 300 MB once decoded."""

SUFFIXES = (".bmp", ".jpeg", ".jpg", ".pbm", ".pgm", ".png", ".ppm", ".tif", ".tiff", ".webp")
"""By which an image file is known in a folder, in lower or upper case."""


def read_image(path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Image:
    """The image in a file.

    Args:
        path: the file; its kind is told from its bytes, not from its name.
        max_pixels: refuse an image of more, before memory is taken for it.

    Returns:
        (H, W, 3) uint8, blue-green-red, upright.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, truncated, too large or no image.
    """
    return decode_image(read_bytes(path), path, max_pixels=max_pixels)


def decode_image(
    data: bytes, what: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS
) -> Image:
    """The image in the bytes of a file; ``what`` names them in an error.

    Args:
        data: the whole file, as :func:`read_bytes` gives it.
        what: the file's path, or where else the bytes are from.
        max_pixels: as for :func:`read_image`.

    Returns:
        (H, W, 3) uint8, blue-green-red, upright.

    Raises:
        ValueError: when the bytes are empty, truncated, too large an image or none.
    """
    import cv2

    try:
        width, height = measure(data)
    except ValueError as error:
        mend = "copy it again" if "truncated" in str(error) else f"give a {KINDS} file"
        raise ValueError(f"{os.fspath(what)} {error}; {mend}") from None
    if width * height > max_pixels:
        raise ValueError(
            f"{os.fspath(what)} has {width} x {height} pixels, more than the limit of "
            f"{max_pixels}; make it smaller"
        )
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise ValueError(
            f"{os.fspath(what)} cannot be decoded: it is damaged, or of an unusual kind; "
            "copy it again, or save it as a plain JPEG or PNG"
        )
    return image.astype(np.uint8, copy=False)


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a file; with :func:`digest_of` and :func:`decode_image` one read does for both.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no regular file.
    """
    with storage.open_file(Path(path)) as file:
        return file.read()


def digest_of(data: bytes) -> str:
    """SHA-256 of a file's bytes, 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def image_digest(path: str | os.PathLike[str]) -> str:
    """SHA-256 of an image file's bytes, 64 hexadecimal digits; nothing is decoded.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is a folder.
    """
    return digest_of(read_bytes(path))
