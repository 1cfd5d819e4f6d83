"""Damage inside JPEG and TIFF files that decoders pass over: data that end early, or never fit.

OpenCV fills what is missing with grey or black and says nothing. So the compressed data are walked
through, without computing a pixel: each block of a JPEG must be there and nothing may be left, and
each strip of a TIFF must unpack to as many bytes as its rows have.
"""

from __future__ import annotations

import re
import struct
import zlib
from functools import lru_cache
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from amusic_gym.kernels.compiling import without_gil
from amusic_gym.routes.image_headers import JPEG_MARKER, tiff_tags

_SPARE = 8  # bytes that may be left over at the end of a JPEG's scan
_BLANK = 96  # bits of a block that are not all 0 unless the file has a hole
_MOST_COMPONENTS = 4
_RESTART = re.compile(rb"\xff+[\xd0-\xd7]")
_LOOKUP = 1 << 16
_WHOLE, _EARLY, _INVALID, _LEFT = range(4)
_WORDS = {
    _EARLY: "its picture data end too early",
    _INVALID: "its picture data hold codes that mean nothing",
    _LEFT: "its picture data go on after the last row",
}

_U8: TypeAlias = NDArray[np.uint8]
_I64: TypeAlias = NDArray[np.int64]
_U64: TypeAlias = NDArray[np.uint64]


class _Component(NamedTuple):
    """A colour channel of a JPEG, its size in blocks of 8 × 8 pixels."""

    across: int  # blocks per unit of an interleaved scan
    down: int
    width: int  # of a scan of its own
    height: int
    stride: int  # of all units
    rows: int


def check_jpeg(data: bytes) -> None:
    """Refuse a JPEG whose blocks are not all there.

    Arithmetic coding and lossless JPEG are not looked into.

    Raises:
        ValueError: with the end of a sentence whose subject is the file: "is damaged: ...".
    """
    tables: dict[int, NDArray[np.uint16]] = {}
    frame: dict[int, _Component] = {}
    masks: dict[int, _U64] = {}  # of each component, see `_walk`
    units, interval, progressive, at = (0, 0), 0, False, 2
    while marker := JPEG_MARKER.search(data, at):
        code, at = marker[1][0], marker.end()
        if code == 0xD9:
            return
        if code in (0x01, 0xD8):
            continue
        length = int(struct.unpack_from(">H", data, at)[0])
        body = data[at + 2 : at + length]
        at += length
        if code == 0xC4:
            tables.update(_tables(body))
        elif code == 0xDD:
            interval = int.from_bytes(body[:2], "big")
        elif code in (0xC0, 0xC1, 0xC2):
            progressive = code == 0xC2
            units, frame = _frame(body)
            masks = {
                name: np.zeros(one.stride * one.rows if progressive else 0, np.uint64)
                for name, one in frame.items()
            }
        elif 0xC0 <= code <= 0xCF and code not in (0xC8, 0xCC):
            return
        elif code == 0xDA:
            following = JPEG_MARKER.search(data, at)
            end = following.start() if following else len(data)
            coded = data[at:end].rstrip(b"\xff")
            _check_scan(body, coded, tables, frame, masks, units, interval, progressive)
            at = end


def _tables(body: bytes) -> dict[int, NDArray[np.uint16]]:
    found, at = {}, 0
    while at + 17 <= len(body):
        size = 17 + sum(body[at + 1 : at + 17])
        found[body[at]] = _lookup(body[at + 1 : at + size])
        at += size
    return found


@lru_cache(32)
def _lookup(table: bytes) -> NDArray[np.uint16]:
    """(65536,) of the next 16 bits: 256 × the code's length + its symbol; 0: no code."""
    lookup = np.zeros(_LOOKUP, np.uint16)
    first = 0
    symbols = iter(table[16:])
    for length, count in enumerate(table[:16], 1):
        for _, symbol in zip(range(count), symbols, strict=False):
            lookup[first : first + (_LOOKUP >> length)] = 256 * length + symbol
            first += _LOOKUP >> length
    return lookup


def _frame(body: bytes) -> tuple[tuple[int, int], dict[int, _Component]]:
    """Units across and down, and the components by name; none where sizes are not told."""
    height, width, count = struct.unpack_from(">HHB", body, 1)
    if count > _MOST_COMPONENTS:
        return (0, 0), {}
    told = [(body[6 + 3 * at], *divmod(body[7 + 3 * at], 16)) for at in range(count)]
    most_h, most_v = max(h for _, h, _ in told), max(v for _, _, v in told)
    if not height or not width or not all(h and v for _, h, v in told):
        return (0, 0), {}
    across, down = -(-width // (8 * most_h)), -(-height // (8 * most_v))
    return (across, down), {
        name: _Component(
            h,
            v,
            -(-width * h // (8 * most_h)),
            -(-height * v // (8 * most_v)),
            across * h,
            down * v,
        )
        for name, h, v in told
    }


def _check_scan(
    body: bytes,
    coded: bytes,
    tables: dict[int, NDArray[np.uint16]],
    frame: dict[int, _Component],
    masks: dict[int, _U64],
    units: tuple[int, int],
    interval: int,
    progressive: bool,
) -> None:
    names = [body[1 + 2 * at] for at in range(body[0])]
    chosen = [divmod(body[2 + 2 * at], 16) for at in range(body[0])]
    first, last, bits = body[1 + 2 * body[0] : 4 + 2 * body[0]]
    high = bits >> 4
    needs_ac = last > 0
    wanted = [dc for dc, _ in chosen if first == 0 and not high]
    wanted += [16 + ac for _, ac in chosen if needs_ac]
    if not set(names) <= set(frame) or not set(wanted) <= set(tables) or last > 63:
        return  # decoders have tables of their own, or refuse it
    parts = [frame[name] for name in names]
    if len(parts) == 1:
        parts = [parts[0]._replace(across=1, down=1)]
        units = parts[0].width, parts[0].height
    pieces = _RESTART.split(coded) if interval else [coded]
    plain = [piece.replace(b"\xff\x00", b"\xff") for piece in pieces]
    none = np.zeros(_LOOKUP, np.uint16)
    state = int(
        _walk(
            np.frombuffer(b"".join(plain) + bytes(8), np.uint8),
            np.cumsum([len(piece) for piece in plain]),
            np.array([*units, interval, first, last, high, progressive], np.int64),
            np.array([[part.across, part.down] for part in parts], np.int64),
            np.stack([tables.get(dc, none) for dc, _ in chosen]),
            np.stack([tables.get(16 + ac, none) for _, ac in chosen]),
            masks[names[0]],
            parts[0].stride,
        )
    )
    if state in _WORDS:
        raise ValueError(f"is damaged: {_WORDS[state]}")


@without_gil
def _walk(
    data: _U8,
    ends: _I64,
    scan: _I64,
    parts: _I64,
    dc: NDArray[np.uint16],
    ac: NDArray[np.uint16],
    masks: _U64,
    stride: int,
) -> int:
    """Walk through all blocks of a scan (T.81, F.2 and G.2), and say how that ends.

    Args:
        data: (n + 8,) bytes without stuffing.
        ends: where each piece between restart markers ends.
        scan: units across and down, units per piece or 0, first and last coefficient, whether
            they were told to fewer bits before, whether the image is progressive.
        parts: (C, 2) blocks of each component across and down a unit.
        dc: (C, 65536) look-up tables.
        ac: (C, 65536).
        masks: of a scan of one component's AC coefficients, which of them are not 0, as 64 bits
            for each block.
        stride: blocks in a row of ``masks``.
    """
    across, down, interval, first, last, high, progressive = scan
    total = across * down
    done, pos = 0, 0
    for piece in range(len(ends)):
        end = 8 * ends[piece]
        here = total - done
        if interval > 0 and piece < len(ends) - 1:
            here = min(here, interval)
        run = 0
        for unit in range(done, done + here):
            for part in range(len(parts)):
                block = unit // across * stride + unit % across
                for _ in range(parts[part, 0] * parts[part, 1]):
                    start = pos
                    pos, run = _block(data, pos, scan, dc[part], ac[part], masks, block, run)
                    if pos > end:
                        return _EARLY
                    if pos < 0 or (pos - start >= _BLANK and _is_blank(data, start, pos)):
                        return _INVALID
        done += here
        if end - pos >= 8 * _SPARE:
            return _LEFT
        pos = end
    return _WHOLE if done == total else _EARLY


@without_gil
def _block(
    data: _U8,
    pos: int,
    scan: _I64,
    dc: NDArray[np.uint16],
    ac: NDArray[np.uint16],
    masks: _U64,
    block: int,
    run: int,
) -> tuple[int, int]:
    """Where a block ends, and how many blocks are to be passed after it.

    The first is negative where a code means nothing, and beyond the data where they end.
    """
    _, _, _, first, last, high, progressive = scan
    k = first
    if first == 0:
        k = 1
        if high:
            pos += 1
        else:
            found = dc[_peek(data, pos)]
            if found == 0:
                return _nothing(data, pos), 0
            pos += (found >> 8) + (found & 255)
    if last == 0:
        return pos, run
    if progressive:
        return _band(data, pos, k, last, high, run, ac, masks, block)
    return _sequential(data, pos, k, ac), 0


@without_gil
def _nothing(data: _U8, pos: int) -> int:
    """What stands for a code that means nothing: -1, or the end of the data where it is there."""
    return -1 if (pos >> 3) + 8 < len(data) else 8 * len(data)


@without_gil
def _peek(data: _U8, pos: int) -> int:
    """The 16 bits from bit ``pos`` on; 0 beyond the end."""
    at = pos >> 3
    if at + 2 >= len(data):
        return 0
    three = int(data[at]) << 16 | int(data[at + 1]) << 8 | int(data[at + 2])
    return (three >> (8 - (pos & 7))) & 0xFFFF


@without_gil
def _is_blank(data: _U8, start: int, stop: int) -> bool:
    """Whether all whole bytes between two bits are 0."""
    for at in range((start + 7) >> 3, stop >> 3):
        if data[at] != 0:
            return False
    return True


@without_gil
def _sequential(data: _U8, pos: int, k: int, ac: NDArray[np.uint16]) -> int:
    """Where the AC coefficients of a block end; negative where a code means nothing."""
    while k < 64:
        found = ac[_peek(data, pos)]
        if found == 0:
            return _nothing(data, pos)
        size = found & 15
        pos += (found >> 8) + size
        k += (found >> 4 & 15) + 1
        if size == 0 and (found & 255) != 0xF0:
            return pos
    return pos if k == 64 else -1


@without_gil
def _band(
    data: _U8,
    pos: int,
    k: int,
    last: int,
    high: int,
    run: int,
    ac: NDArray[np.uint16],
    masks: _U64,
    block: int,
) -> tuple[int, int]:
    """As `_sequential`, for a band of a progressive image; and the blocks still to be passed."""
    mask = masks[block] if high else np.uint64(0)
    while k <= last and run == 0:
        found = ac[_peek(data, pos)]
        if found == 0:
            return _nothing(data, pos), 0
        size, skip = found & 15, found >> 4 & 15
        pos += (found >> 8) + size
        if size == 0 and skip < 15:
            run = (1 << skip) + (_peek(data, pos) >> (16 - skip))
            pos += skip
            break
        told = k
        k = _skipped(mask, k, last, skip)
        pos += _refined(mask, told, k)
        if k > last:
            return -1, 0
        if size:
            masks[block] |= np.uint64(1) << np.uint64(k)
        k += 1
    if run > 0:
        pos += _refined(mask, k, last + 1)
        run -= 1
    return pos, run


@without_gil
def _skipped(mask: np.uint64, k: int, last: int, skip: int) -> int:
    """The coefficient behind ``skip`` ones that are 0 in ``mask``, and all others between."""
    while k <= last:
        if not mask >> np.uint64(k) & np.uint64(1):
            if skip == 0:
                break
            skip -= 1
        k += 1
    return k


@without_gil
def _refined(mask: np.uint64, first: int, stop: int) -> int:
    """How many coefficients of ``first`` to before ``stop`` are in ``mask``: a bit for each."""
    bits = 0
    for k in range(first, stop):
        bits += int(mask >> np.uint64(k) & np.uint64(1))
    return bits


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
