"""Damage inside JPEG and TIFF files that decoders pass over: data that end early, or never fit.

OpenCV fills what is missing with grey or black and says nothing. So the compressed data are
unpacked once more: libjpeg must not warn of a JPEG, and each strip of a TIFF must unpack to as
many bytes as its rows have.
"""

import re
import zlib
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import without_gil
from amusic_gym.routes.image_headers import tiff_tags

# Some cameras pad the end of the data, where all blocks were there; a hole may leave as many zeros.
_PADDING = re.compile("Corrupt JPEG data: [1-8] extraneous bytes before marker 0xd9")
_HOLE = bytes(16) + b"\xff\xd9"

_U8: TypeAlias = NDArray[np.uint8]


def check_jpeg(data: bytes) -> None:
    """Refuse a JPEG whose blocks are not all there, or are followed by more than padding.

    Raises:
        ValueError: with the end of a sentence whose subject is the file: "is damaged: ...".
    """
    import simplejpeg

    fast = {"fastdct": True, "fastupsample": True, "min_height": 1, "min_width": 1, "min_factor": 8}
    try:
        simplejpeg.decode_jpeg(data, "GRAY", strict=True, **fast)  # at an eighth of its size
    except ValueError as error:
        if _HOLE in data or not _PADDING.fullmatch(str(error)):
            raise ValueError(f"is damaged: its picture data are not whole ({error})") from None


def check_tiff(data: bytes) -> None:
    """Refuse a TIFF with a strip or tile that is not all there.

    Only plain, deflate and LZW data are unpacked; of others, the place in the file is checked.

    Raises:
        ValueError: with the end of a sentence whose subject is the file: "is damaged: ...".
    """
    tags = tiff_tags(data)
    width, height = max(tags[256]), max(tags[257])
    tiled = 322 in tags
    offsets, counts = tags.get(324 if tiled else 273, ()), tags.get(325 if tiled else 279, ())
    kind = tags.get(259, (1,))[0]
    samples = 1 if tags.get(284, (1,))[0] == 2 else tags.get(277, (1,))[0]
    columns = tags[322][0] if tiled else width
    rows = tags[323][0] if tiled else min(tags.get(278, (height,))[0], height)
    line = -(-columns * samples * tags.get(258, (1,))[0] // 8)
    planes = max(1, -(-height // max(rows, 1)))
    for number, (offset, count) in enumerate(zip(offsets, counts, strict=False)):
        here = rows if tiled else min(rows, height - rows * (number % planes))
        if count < 1 or offset + count > len(data):
            raise ValueError(f"is damaged: strip {number} of its TIFF data is not there")
        if _unpacked(data[offset : offset + count], kind, line * here) < line * here:
            raise ValueError(
                f"is damaged: strip {number} of its TIFF data cannot be unpacked whole"
            )


def _unpacked(coded: bytes, kind: int, wanted: int) -> int:
    """How many bytes a strip unpacks to, or ``wanted`` where that is not looked into."""
    if kind == 1:
        return len(coded)
    if kind == 5:
        return int(_lzw_length(np.frombuffer(coded + bytes(4), np.uint8), wanted))
    if kind not in (8, 32946):
        return wanted
    stream = zlib.decompressobj()
    try:
        length = len(stream.decompress(coded, 2 * wanted + 1))
    except zlib.error:
        return 0
    return length if stream.eof else 0  # the checksum stands at the end


@without_gil
def _peek(data: _U8, pos: int) -> int:
    """The 16 bits from bit ``pos`` on; 0 beyond the end."""
    at = pos >> 3
    if at + 2 >= len(data):
        return 0
    three = int(data[at]) << 16 | int(data[at + 1]) << 8 | int(data[at + 2])
    return (three >> (8 - (pos & 7))) & 0xFFFF


@without_gil
def _lzw_length(data: _U8, wanted: int) -> int:
    """Bytes that LZW data unpack to; 0 where a code is not in the table yet."""
    lengths = np.ones(4097, np.int64)
    pos, bits, free, before, length = 0, 9, 258, -1, 0
    end = 8 * (len(data) - 4)
    while length < wanted and pos + bits <= end:
        code = (_peek(data, pos) >> (16 - bits)) & ((1 << bits) - 1)
        pos += bits
        if code == 257:
            break
        if code == 256:
            bits, free, before = 9, 258, -1
            continue
        if code > free or (code == free and before < 0) or (before < 0 and code > 255):
            return 0
        if before >= 0 and free < 4096:
            lengths[free] = lengths[before] + 1
            free += 1
            if free >= (1 << bits) - 1 and bits < 12:
                bits += 1
        length += lengths[code]
        before = code
    return length
