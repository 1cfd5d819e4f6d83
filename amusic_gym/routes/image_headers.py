"""Kind, size and end of an image file, from its bytes, before it is decoded.

Decoders are lenient: OpenCV gives a grey rest where the end of a JPEG is missing or full of zeros,
and any decoder first allocates what the header asks for. So both are looked at here, from the bytes
alone, in the time of a look-up.
"""

import re
import struct
from collections.abc import Callable

KINDS = "JPEG, PNG, BMP, PNM, TIFF or WebP"  # the kinds of image file that are read
MAX_SCANS = 64  # of a progressive JPEG: each costs as much time as a whole image, and ten are usual
Size = tuple[int, int]  # (width, height) in pixels, as stored: before any rotation

# A JPEG marker: 0xff and a code. 0xff00 is a 0xff in the picture's data, 0xffff is fill, and the
# restart markers d0-d7 stand between pieces of that data.
JPEG_MARKER = re.compile(rb"\xff([\x01-\xcf\xd8-\xfe])")
_JPEG_BARE = b"\x01\xd8"  # markers without a length: TEM, and a start of image out of place
_JPEG_END, _JPEG_SCAN = b"\xd9", b"\xda"
_JPEG_NO_FRAME = b"\xc4\xc8\xcc"  # in the range of the frame headers c0-cf, but something else

_PNM_GAP = rb"\s(?:\s|#[^\n]*\n)*"
_PNM = re.compile(rb"P[1-6]" + _PNM_GAP + rb"(\d+)" + _PNM_GAP + rb"(\d+)")
PNM_MAXIMUM = re.compile(
    rb"P[2356]" + _PNM_GAP + rb"\d+" + _PNM_GAP + rb"\d+" + _PNM_GAP + rb"0*(\d{1,5})\s"
)
"""Header of a grey or colour PNM with the value that is white."""


def measure(data: bytes) -> Size:
    """Width and height that an image file declares, when it is of a known kind and has its end.

    The end is looked for in JPEG, PNG and WebP, where the file says where it must be. Bytes after
    the end do no harm, and a picture inside the metadata (a thumbnail) is not taken for the image.

    Raises:
        ValueError: with the end of a sentence whose subject is the file: "is truncated: ...".
    """
    for magic, reader in _READERS:
        if magic.match(data):
            try:
                width, height = reader(data)
            except (struct.error, IndexError):  # the header itself goes on after the last byte
                raise ValueError("is truncated: it ends within its header") from None
            if width < 1 or height < 1:
                raise ValueError(f"is damaged: its header says {width} x {height} pixels")
            return width, height
    what = "is empty" if not data else f"is no {KINDS} image"
    raise ValueError(what)


def _jpeg(data: bytes) -> Size:
    size = (0, 0)
    at, scans = 2, 0
    while marker := JPEG_MARKER.search(data, at):
        code, at = marker[1], marker.end()
        if code == _JPEG_END:
            return size
        if code in _JPEG_BARE:
            continue
        scans += code == _JPEG_SCAN
        if scans > MAX_SCANS:
            raise ValueError(f"is damaged: a JPEG of more than {MAX_SCANS} scans")
        if b"\xc0" <= code <= b"\xcf" and code not in _JPEG_NO_FRAME and size == (0, 0):
            height, width = struct.unpack_from(">HH", data, at + 3)
            size = width, height
        # After a start of scan (da), the picture's data follow: the next search skips them.
        at += struct.unpack_from(">H", data, at)[0]
    raise ValueError("is truncated: a JPEG without its end-of-image marker")


def _png(data: bytes) -> Size:
    width, height = struct.unpack_from(">II", data, 16)  # IHDR is the first chunk
    at = 8
    while at + 12 <= len(data):
        length, kind = struct.unpack_from(">I4s", data, at)
        at += 12 + length
        if kind == b"IEND":
            return width, height
    raise ValueError("is truncated: a PNG without its end chunk")


def _webp(data: bytes) -> Size:
    if len(data) < 8 + struct.unpack_from("<I", data, 4)[0]:
        raise ValueError("is truncated: a WebP shorter than its header says")
    kind = data[12:16]
    if kind == b"VP8 ":
        width, height = struct.unpack_from("<HH", data, 26)
        return width & 0x3FFF, height & 0x3FFF
    if kind == b"VP8L":
        bits = struct.unpack_from("<I", data, 21)[0]
        return 1 + (bits & 0x3FFF), 1 + (bits >> 14 & 0x3FFF)
    width, high, height, top = struct.unpack_from("<HBHB", data, 24)  # VP8X: two 24-bit numbers
    return 1 + width + (high << 16), 1 + height + (top << 16)


def _bmp(data: bytes) -> Size:
    if struct.unpack_from("<I", data, 14)[0] == 12:  # the header of OS/2
        width, height = struct.unpack_from("<HH", data, 18)
    else:
        width, height = struct.unpack_from("<ii", data, 18)
    return width, abs(height)  # a negative height: rows from top to bottom


def _pnm(data: bytes) -> Size:
    found = _PNM.match(data[:4096])  # comments may be long, but not that long
    if found is None:
        raise ValueError("is damaged: a PNM without its width and height")
    width, height = (int(digits.lstrip(b"0")[:10] or b"0") for digits in found.groups())
    return width, height


def _tiff(data: bytes) -> Size:
    tags = tiff_tags(data)
    width, height = tags.get(256, ()), tags.get(257, ())  # told twice, decoders take either
    return max(width, default=0), max(height, default=0)


# Kind of a TIFF's numbers -> their letter for `struct`; others are no whole numbers.
_TIFF_KINDS = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 16: "Q", 17: "q"}


def tiff_tags(data: bytes) -> dict[int, tuple[int, ...]]:
    """Whole numbers in the first directory of a TIFF by their tag, of tags told twice all.

    Raises:
        struct.error: where the file ends within them.
    """
    order = "<" if data[:1] == b"I" else ">"
    (first,) = struct.unpack_from(order + "I", data, 4)
    (count,) = struct.unpack_from(order + "H", data, first)
    tags: dict[int, tuple[int, ...]] = {}
    for at in range(first + 2, first + 2 + 12 * count, 12):
        tag, kind, length = struct.unpack_from(order + "HHI", data, at)
        if kind not in _TIFF_KINDS:
            continue
        numbers = f"{order}{length}{_TIFF_KINDS[kind]}"
        size = struct.calcsize(numbers)
        where = at + 8
        if size > 4:
            (where,) = struct.unpack_from(order + "I", data, where)
        if where + size > len(data):
            raise struct.error
        tags[tag] = tags.get(tag, ()) + struct.unpack_from(numbers, data, where)
    return tags


_READERS: tuple[tuple[re.Pattern[bytes], Callable[[bytes], Size]], ...] = (
    (re.compile(rb"\xff\xd8\xff"), _jpeg),
    (re.compile(rb"\x89PNG\r\n\x1a\n"), _png),
    (re.compile(rb"BM"), _bmp),
    (re.compile(rb"P[1-6]\s"), _pnm),
    (re.compile(rb"II\x2a\x00|MM\x00\x2a"), _tiff),
    (re.compile(rb"RIFF.{4}WEBPVP8[ LX]", re.DOTALL), _webp),
)
