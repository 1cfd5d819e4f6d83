"""Images from files: whole, of a bearable size, upright; or refused with a sentence.

One rule for every kind of file (JPEG, PNG, BMP, PNM, TIFF, WebP): the image is what a viewer shows,
as 8-bit colour. EXIF rotation is applied; grey becomes three equal channels; a palette is looked
up; alpha is dropped and the colour beneath it kept. Of channels with more than 8 bits, the upper
eight of those stay that the largest value needs: of a file of 16 bits that holds 12-bit numbers,
the upper eight of the twelve. In a PNM the header's maximum counts, and becomes 255. The pixels are
OpenCV's.
"""

import hashlib
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.routes.image_headers import KINDS, PNM_MAXIMUM, measure, tiff_tags
from amusic_gym.techniques.protocol import Image
from amusic_gym.utils import reading

MAX_PIXELS = 100_000_000  # width times height that is read unless more is asked for: 300 MB

SUFFIXES = tuple(".bmp .jfif .jpe .jpeg .jpg .pbm .pgm .png .pnm .ppm .tif .tiff .webp".split())
"""By which an image file is known in a folder, in lower or upper case."""

UNREAD_SUFFIXES = tuple(
    ".3fr .arw .avif .cr2 .cr3 .dng .exr .gif .hdr .heic .heif .j2k .jp2 .jxl .nef .orf .pef .raf"
    " .raw .rw2 .srw .tga".split()
)
"""Of images that cannot be read; they are counted and named."""


FEW_LEVELS = 64  # grey levels; an image of more than 8 bits that keeps fewer is doubted


def read_image(path: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> Image:
    """The image in a file, (H, W, 3) uint8, blue-green-red, upright.

    Args:
        path: the file; its kind is told from its bytes, not from its name.
        max_pixels: refuse an image of more, before memory is taken for it.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is empty, truncated, too large or no image.
    """
    return decode_image(read_bytes(path), path, max_pixels=max_pixels)


def decode_image(
    data: bytes,
    what: str | os.PathLike[str],
    *,
    max_pixels: int = MAX_PIXELS,
    checked: bool = False,
) -> Image:
    """The image in the bytes of a file, (H, W, 3) uint8, blue-green-red, upright.

    Args:
        data: the whole file, as :func:`read_bytes` gives it.
        what: the file's path, or where else the bytes are from.
        max_pixels: as for :func:`read_image`.
        checked: whether :func:`check_image` let these bytes pass.

    Raises:
        ValueError: when the bytes are empty, truncated, damaged, too large an image or none.
    """
    if not checked:
        check_image(data, what, max_pixels=max_pixels)
    image = _decoded(data, what)
    return _of_eight_bits(image, data) if image.dtype == np.uint16 else _scaled(image, data)


def check_image(data: bytes, what: str | os.PathLike[str], *, max_pixels: int = MAX_PIXELS) -> None:
    """Refuse, before any pixel is computed, what is truncated, damaged, too large or no image."""
    from amusic_gym.routes.image_damage import check_jpeg, check_tiff

    small = True
    try:
        width, height = measure(data)
        small = width * height <= max_pixels
        if small and data.startswith(b"\xff\xd8"):
            check_jpeg(data)
        elif small and data.startswith((b"II", b"MM")):
            check_tiff(data)
    except (struct.error, LookupError):
        raise ValueError(f"{os.fspath(what)} is damaged: its header; copy it again") from None
    except ValueError as error:
        known = "truncated" in str(error) or "data" in str(error)
        mend = "copy it again" if known else f"give a {KINDS} file"
        raise ValueError(f"{os.fspath(what)} {error}; {mend}") from None
    if not small:
        raise ValueError(
            f"{os.fspath(what)} has {width} x {height} pixels, more than the limit of "
            f"{max_pixels}; make it smaller"
        )


def _decoded(data: bytes, what: str | os.PathLike[str]) -> NDArray[Any]:
    import cv2

    image = None
    try:
        flags = cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        pass
    if image is None or image.dtype not in (np.uint8, np.uint16):
        raise ValueError(
            f"{os.fspath(what)} cannot be decoded: it is damaged, or of an unusual kind; "
            "copy it again, or save it as a plain JPEG or PNG"
        )
    return image


def _of_eight_bits(image: NDArray[Any], data: bytes) -> Image:
    """The upper eight bits of those that the largest value needs."""
    maximum = _pnm_maximum(data) or int(image.max(initial=0))
    return (image >> max(maximum.bit_length() - 8, 0)).astype(np.uint8)


def _scaled(image: Image, data: bytes) -> Image:
    """Of a binary PNM with a maximum below 255, so that the maximum becomes 255; others as is."""
    maximum = _pnm_maximum(data) if data[:2] in (b"P5", b"P6") else 0
    if 0 < maximum < 255:
        return (image.astype(np.uint16) * 255 // maximum).clip(max=255).astype(np.uint8)
    return image


def _pnm_maximum(data: bytes) -> int:
    found = PNM_MAXIMUM.match(data[:4096])
    return int(found[1]) if found else 0


def lost_levels(data: bytes) -> str:
    """What is lost of an image with more than 8 bits, as the end of a sentence; "" for little."""
    deep = _pnm_maximum(data) > 255 or (data[24:25] == b"\x10" and data.startswith(b"\x89PNG"))
    if data.startswith((b"II", b"MM")):
        deep = max(tiff_tags(data).get(258, (1,)), default=1) > 8
    if not deep:
        return ""
    image = _decoded(data, "")
    kept, there = len(np.unique(_of_eight_bits(image, data))), len(np.unique(image))
    if kept >= FEW_LEVELS or there < 2 * kept:
        return ""
    return f"keeps {kept} of its {there} grey levels as 8 bits; scale the images to their own range"


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a file; with :func:`digest_of` and :func:`decode_image` one read does for both.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: when it is no regular file.
    """
    with reading.open_file(Path(path)) as file:
        return file.read()


def digest_of(data: bytes) -> str:
    """SHA-256 of a file's bytes, 64 hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()
