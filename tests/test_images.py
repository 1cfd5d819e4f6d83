"""Headers and decoding: sizes against an independent reader, and no surprise from odd bytes."""

from __future__ import annotations

import hashlib
import io
import struct

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_cases import FILES, encoded, picture, pillow
from PIL import Image as Pillow

from amusic_gym.routes.image_headers import measure
from amusic_gym.routes.images import (
    SUFFIXES,
    decode_image,
    digest_of,
    read_bytes,
    read_image,
)


@pytest.mark.parametrize("kind", FILES)
def test_size_and_pixels_of_every_kind(kind):
    data = FILES[kind]
    assert measure(data) == (16, 12)
    image = decode_image(data, kind)
    assert image.shape == (12, 16, 3)
    assert image.dtype == np.uint8
    np.testing.assert_array_equal(image, cv2.imdecode(np.frombuffer(data, np.uint8), 1))


def test_a_webp_of_the_extended_kind_is_among_them():
    data = pillow("WEBP", "RGBA", exif=b"Exif\0\0" + Pillow.Exif().tobytes())
    assert data[12:16] == b"VP8X"
    assert measure(data) == (16, 12)


@pytest.mark.parametrize("size", [(1, 1), (16383, 1), (1, 16383), (257, 300)])
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "BMP", "PPM", "TIFF", "WEBP"])
def test_sizes_agree_with_pillow(kind, size):
    file = io.BytesIO()
    Pillow.new("RGB", size).save(file, kind)
    assert measure(file.getvalue()) == Pillow.open(file).size == size


def test_old_and_upside_down_bitmaps():
    core = b"BM" + bytes(12) + struct.pack("<IHHHH", 12, 7, 5, 1, 24)
    assert measure(core) == (7, 5)
    top_down = b"BM" + bytes(12) + struct.pack("<Iii", 40, 7, -5)
    assert measure(top_down) == (7, 5)


def test_a_jpeg_with_fill_bytes_and_stray_bytes_between_segments():
    data = encoded(".jpg")
    assert measure(data[:2] + b"\xff\xff" + data[2:]) == (16, 12)
    after_the_first_segment = 4 + int.from_bytes(data[4:6], "big")
    head, tail = data[:after_the_first_segment], data[after_the_first_segment:]
    assert tail[:1] == b"\xff"
    assert measure(head + b"\x00stray\xff\x00" + tail) == (16, 12)


def test_restart_markers_are_no_segments():
    noise = np.random.default_rng(0).integers(0, 256, (150, 200, 3), np.uint8)
    data = encoded(".jpg", cv2.IMWRITE_JPEG_RST_INTERVAL, 1, image=noise)
    assert data.count(b"\xff\xd0") > 5
    assert measure(data) == (200, 150)


def test_tiff_sizes_in_two_and_in_four_bytes():
    for order, magic in (("<", b"II\x2a\x00"), (">", b"MM\x00\x2a")):
        head = magic + struct.pack(order + "IH", 8, 2)
        short = struct.pack(order + "HHIHHHHIHH", 256, 3, 1, 7, 0, 257, 3, 1, 5, 0)
        long = struct.pack(order + "HHIIHHII", 256, 4, 1, 70_000, 257, 4, 1, 5)
        assert measure(head + short) == (7, 5)
        assert measure(head + long) == (70_000, 5)


@pytest.mark.parametrize("kind", ["lossy WebP", "lossless WebP"])
def test_truncated_webp_is_seen_without_decoding(kind):
    with pytest.raises(ValueError, match="is truncated: a WebP shorter than its header says"):
        measure(FILES[kind][:-2])


def check_measure(data: bytes) -> None:
    """Either a size comes out, or the end of a sentence; never another error."""
    sentence, size = "", (0, 0)
    try:
        size = measure(data)
    except ValueError as error:
        sentence = str(error)
    assert min(size) > 0 or sentence.startswith("is ")


@pytest.mark.parametrize("kind", FILES)
@given(cut=st.floats(0, 1), at=st.floats(0, 0.999), byte=st.integers(0, 255))
@settings(max_examples=60, deadline=None)
def test_odd_bytes_give_a_size_or_a_sentence(kind, cut, at, byte):
    data = bytearray(FILES[kind])
    data[int(at * len(data))] = byte
    check_measure(bytes(data[: int(cut * len(data))]))


@given(
    st.binary(max_size=64), st.sampled_from([b"", b"\xff\xd8\xff", b"P6 ", b"BM", b"II\x2a\x00"])
)
@settings(deadline=None)
def test_garbage_ends_in_a_sentence(data, magic):
    check_measure(magic + data)


def test_one_read_serves_digest_and_pixels(tmp_path):
    path = tmp_path / "a.jpg"
    path.write_bytes(FILES["baseline JPEG"])
    data = read_bytes(path)
    assert digest_of(data) == hashlib.sha256(path.read_bytes()).hexdigest()
    np.testing.assert_array_equal(decode_image(data, path), read_image(path))
    path.write_bytes(FILES["progressive JPEG"])
    assert digest_of(data) != digest_of(read_bytes(path))


def test_the_kind_is_told_from_the_bytes_not_from_the_name(tmp_path):
    path = tmp_path / "really_a_png.jpg"
    path.write_bytes(FILES["PNG"])
    np.testing.assert_array_equal(read_image(path), picture())


def test_what_is_read_can_be_written_to():
    image = decode_image(FILES["PNG"], "a picture")
    image[0, 0] = 7
    assert (image[0, 0] == 7).all()


def test_every_suffix_is_that_of_a_kind_that_is_read():
    for suffix in SUFFIXES:
        grey = suffix in (".pgm", ".pbm")
        kind = {".jfif": ".jpg", ".pnm": ".ppm"}.get(suffix, suffix)
        data = encoded(kind, image=picture()[..., 0] if grey else picture())
        assert decode_image(data, suffix).shape == (12, 16, 3), suffix
