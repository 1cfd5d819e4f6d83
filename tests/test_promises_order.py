"""What the project promises of the order of frames, of positions, damage and depth: 43 to 48."""

from __future__ import annotations

import io
import random
import resource
import struct
import subprocess
import sys
from pathlib import Path, PurePath

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from image_cases import encoded, picture
from PIL import Image as Pillow

from amusic_gym.banks.ground_truth import resolve_ground_truth
from amusic_gym.extraction import extract
from amusic_gym.extraction.describe import images_of
from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.image_damage import check_jpeg, check_tiff
from amusic_gym.routes.images import decode_image
from amusic_gym.routes.numbering import arranged, gaps
from amusic_gym.routes.video import Camera, VideoFile, VideoWriter

ROOT = Path(__file__).resolve().parent.parent


def make(folder: Path, names: list[str]) -> Path:
    for seed, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded(".png", image=picture(seed=seed)))
    return folder


def in_order(names: list[str]) -> list[str]:
    shuffled = random.Random(0).sample(names, len(names))
    return [shuffled[at] for at in arranged([PurePath(f"{name}.png") for name in shuffled])]


# ---- 43: several folders ------------------------------------------------------------------


def test_43_folders_of_several_cameras_are_told_with_their_numbers(tmp_path):
    make(tmp_path, ["cam0/0.png", "cam0/1.png", "cam0/2.png", "cam1/0.png", "cam1/1.png"])
    with pytest.warns(UserWarning, match=r"images of 2 folders .*: cam0 \(3\), cam1 \(2\);"):
        assert len(ImageFolder(tmp_path)) == 5


def test_43_a_map_that_holds_its_run_is_refused(tmp_path):
    make(tmp_path, ["summer/0.png", "summer/1.png", "winter/0.png", "winter/1.png"])
    with pytest.warns(UserWarning, match="2 folders"):
        both = ImageFolder(tmp_path)
    for pair in [(both, tmp_path / "winter"), (tmp_path / "winter", both)]:
        with pytest.raises(ValueError, match=r"2 of the \d images of the run .* among the \d of"):
            extract(*pair, "hog", tolerance=1)


# ---- 44: order ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "names",
    [
        [str(round(4127 + i / 30, 3)) for i in range(40)],
        ["4127.033", "4127.1"],
        [f"{1305031102.175304 + i / 30:.6f}" for i in range(90)],
        [str(i) for i in range(-12, 13)],
        [f"t_{i / 4}" for i in range(-12, 13)],
        [f"frame-{i}" for i in range(1, 20)],  # a dash
        [f"{i:x}" for i in range(40)],
        [f"frame{i:04x}" for i in range(40)],
        [f"0x{37 * i:X}" for i in range(40)],
        [f"a{i}" for i in range(1, 21)] + [f"b{i}" for i in range(1, 21)],  # not hexadecimal
        [*map(str, range(1, 8)), "7a", *map(str, range(8, 40))],  # not hexadecimal either
        [f"{i}{eye}" for i in range(1, 21) for eye in "lr"],
        [f"1.{i}" for i in range(1, 21)],  # counted, not a fraction
        ["30-06-2014_10", "01-07-2014_09"],
        ["06-30-2014_10", "07-01-2014_09"],
        ["30-Jun-2014", "1-Jul-2014"],
        ["June 30, 2014", "July 1, 2014"],
        ["01-02-2014_1", "01-02-2014_2"],
        ["at 11.58.00 AM", "at 12.59.59 PM", "at 1.00.00 PM"],
        [f"@{500 - i}.5@{7 * i % 5}.0@56@J@-27.5@153.0@d_{7 * i:05}@@@@@@@@" for i in range(9)],
        [f"@{500 - i}.5@0.0@56@J@@@key{7 * i % 5}@@@@@@20140101_1200{i:02}@@" for i in range(5)],
        [f"@0@{(7 * i) % 5}@@@@@{i}@@@@@@@@" for i in range(12)],
    ],
)
def test_44_names_are_in_the_order_of_time(names):
    assert in_order(names) == names
    assert gaps([PurePath(f"{name}.png") for name in names]) == []


@given(st.lists(st.decimals(-99, 99, places=3), unique=True, min_size=2))
def test_44_decimal_numbers_are_in_their_order_however_they_are_cut(numbers):
    names = sorted({str(float(number)) for number in numbers}, key=float)
    if all(name.startswith("-") for name in names):
        return
    assert in_order([f"{name}" for name in names]) == names


@pytest.mark.parametrize(
    ("names", "why"),
    [
        (["02-03-2014", "03-03-2014", "01-04-2014"], "day and month could be either"),
        (["-0001", "-0002"], "a minus, or a dash"),
        (["9f86d081884c7d65", "60303ae22b998861", "fd61a03af4f77d8a"], "are hashes"),
        (["@500001.0@6955000.0@56@J@", "@500000.0@6955000.0@56@J@"], "not all tell when"),
        (["@1.0@2.0@56@J@0@0@a7@@@@@@@@", "@1.0@3.0@56@J@0@0@b7@@@@@@@@"], "not all tell when"),
    ],
)
def test_44_names_that_do_not_tell_the_order_are_refused_with_the_way_to_give_it(
    tmp_path, names, why
):
    make(tmp_path, [f"{name}.png" for name in names])
    with pytest.raises(ValueError, match=rf"{why}.*; give the order as a list of names \(--order"):
        ImageFolder(tmp_path)
    listed = [f"{name}.png" for name in names]
    assert ImageFolder(tmp_path, order=listed).names == tuple(listed)


def test_44_a_lost_frame_of_a_video_at_30_hertz_is_a_gap():
    times = [f"{1305031102.175304 + i / 30:.6f}.png" for i in range(60) if i != 20]
    assert gaps([PurePath(time) for time in times]) == [19]


def test_44_a_list_gives_the_order(tmp_path):
    folder = make(tmp_path / "images", ["a.png", "b.png", "c d.png"])
    listed = tmp_path / "order.txt"
    listed.write_text("\ufeff# by hand\nc d.png\r\n\na.png\n", encoding="utf-8")
    assert ImageFolder(folder, order=listed).names == ("c d.png", "a.png")
    for text, why in [
        ("a.png\nz.png\n", "'z.png': .* is no image of the folder"),
        ("a.png\na.png\n", "'a.png': .* names it twice"),
        ("# none\n", "names no image"),
    ]:
        listed.write_text(text)
        with pytest.raises(ValueError, match=why):
            ImageFolder(folder, order=listed)


# ---- 45: positions ------------------------------------------------------------------------


def placed(folder: Path, positions: list[str]) -> ImageFolder:
    names = [f"@{where}@{at}@@@@@@@.png" for at, where in enumerate(positions)]
    return ImageFolder(make(folder, names), order=names)


def at(east: float, north: float = 6955000.0, zone: str = "56@J") -> str:
    return f"{east:.2f}@{north:.2f}@{zone}@-27.5@153.0"


def test_45_degrees_are_refused(tmp_path):
    names = [f"120.439{i}@36.599@@@@" for i in range(5)]
    here, there = placed(tmp_path / "r", names), placed(tmp_path / "q", names)
    with pytest.raises(ValueError, match=r"@120\.439.*@36\.599@ look like degrees .*; give metres"):
        image_truth.by_position(here, there)


def test_45_utm_zones_are_compared(tmp_path):
    one = placed(tmp_path / "r", [at(500000 + 30 * i, zone="55@J") for i in range(5)])
    other = placed(tmp_path / "q", [at(500000 + 30 * i) for i in range(5)])
    with pytest.raises(ValueError, match="different UTM zones: 55 south .*, 56 south"):
        image_truth.by_position(one, other)
    band = placed(tmp_path / "b", [at(500000 + 30 * i, zone="56@H") for i in range(5)])
    assert image_truth.by_position(other, band).has_place.all()  # a band is no zone


def test_45_places_that_are_all_true_are_refused(tmp_path):
    close = [at(500000 + i) for i in range(4)]
    here, there = placed(tmp_path / "r", close), placed(tmp_path / "q", close)
    with pytest.raises(ValueError, match="any place would be right; give fewer metres"):
        image_truth.by_position(here, there)
    assert image_truth.by_position(here, there, metres=1.5).places.size == 10


def test_45_a_tolerance_that_makes_every_place_true_is_refused():
    with pytest.raises(ValueError, match="every one of the 40 places is right for every frame"):
        resolve_ground_truth(None, 39, 40, 40)
    assert resolve_ground_truth(None, 38, 40, 40)[1] == 38


def test_45_headings_may_be_limited(tmp_path):
    def seen(folder: str, headings: list[str]) -> ImageFolder:
        names = [f"@{at(500000 + 9 * i)}@{i}@@{h}@@@@@@.png" for i, h in enumerate(headings)]
        return ImageFolder(make(tmp_path / folder, names))

    here, there = seen("r", ["350", "170", "10"]), seen("q", ["5", "5", "190"])
    far = image_truth.by_position(here, there, metres=10, heading=20).matrix()
    assert far.tolist() == [[1, 0, 0], [1, 0, 1], [0, 1, 0]]
    assert image_truth.by_position(here, there, metres=10).matrix()[0, 1]
    with pytest.raises(ValueError, match="in which direction it looks; the ninth field"):
        image_truth.by_position(here, seen("n", ["", "", ""]), metres=10, heading=20)
    with pytest.raises(ValueError, match="heading is 200; give degrees from 0 to 180"):
        image_truth.by_position(here, there, heading=200)


# ---- 46: videos ---------------------------------------------------------------------------


def film(path: Path, frames: int = 12) -> Path:
    with VideoWriter(path, 10) as writer:
        for i in range(frames):
            writer.write(np.full((64, 96, 3), 20 * i, np.uint8))
    return path


def all_levels(source: VideoFile) -> list[int]:
    found = []
    while (image := source.read(len(found))) is not None:
        found.append(round(float(image.mean()) / 20))
    return found


def spoiled(path: Path, chunk: int) -> Path:
    """An AVI whose frame of that number is zeros."""
    data, begin = bytearray(path.read_bytes()), -1
    for _ in range(chunk + 2):  # the first is in the header
        begin = data.find(b"00dc", begin + 1)
    size = struct.unpack_from("<I", data, begin + 4)[0]
    data[begin + 8 : begin + 8 + size] = bytes(size)
    path.write_bytes(data)
    return path


def test_46_an_undecodable_frame_is_passed_over_and_counted(tmp_path, capfd):
    source = VideoFile(spoiled(film(tmp_path / "a.avi"), 4))
    with pytest.warns(UserWarning, match="1 of 12 frames are missing or cannot be decoded"):
        assert all_levels(source) == [0, 1, 2, 3, 5, 6, 7, 8, 9, 10, 11]
    assert source.length == 11


def test_46_frames_that_are_announced_and_lacking_are_told(tmp_path, capfd):
    path = film(tmp_path / "a.avi")
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 3 // 4])
    source = VideoFile(path)
    with pytest.warns(UserWarning, match=r"\d of 12 frames are missing"):
        assert len(all_levels(source)) < 12


class Flaky:
    """A capture whose reads fail now and then, at 10 and then at 2 frames per second."""

    fails: tuple[int, ...] = ()
    frames = 20

    def __init__(self, what) -> None:
        self.at = -1

    def grab(self) -> bool:
        self.at += 1
        return self.at < self.frames and self.at not in self.fails

    def retrieve(self):
        return True, np.full((4, 6, 3), self.at, np.uint8)

    def read(self):
        return (True, self.retrieve()[1]) if self.grab() else (False, None)

    def get(self, what) -> float:
        if what == cv2.CAP_PROP_POS_MSEC:
            return self.at * 100.0 if self.at < 10 else 1000.0 + (self.at - 10) * 500.0
        return {cv2.CAP_PROP_FRAME_COUNT: 20, cv2.CAP_PROP_FPS: 10}.get(what, 4)

    def set(self, *_: object) -> None: ...

    def release(self) -> None: ...


def test_46_a_camera_that_fails_once_is_not_at_its_end(monkeypatch):
    monkeypatch.setattr("cv2.VideoCapture", Flaky)
    monkeypatch.setattr(Flaky, "fails", (3, 4))
    camera = Camera(0)
    assert [int(camera.read(i)[0, 0, 0]) for i in range(2)] == [1, 2]
    with pytest.warns(UserWarning, match="camera 0 gave no picture 2 times and then went on"):
        assert camera.read(2)[0, 0, 0] == 5
    assert [camera.read(i) is None for i in range(3, 19)] == [False] * 14 + [True] * 2


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({}, list(range(20))),
        ({"every": 6}, [0, 6, 12, 18]),
        ({"fps": 5}, [0, 2, 4, 6, 8, *range(10, 20)]),  # by time stamps: it slows down
        ({"fps": 1}, [0, 10, 12, 14, 16, 18]),
        ({"fps": 100}, list(range(20))),
    ],
)
def test_46_a_video_can_be_thinned(monkeypatch, tmp_path, options, expected):
    monkeypatch.setattr("cv2.VideoCapture", Flaky)
    (tmp_path / "a.avi").write_bytes(b"RIFF")
    source = VideoFile(tmp_path / "a.avi", **options)
    got = [int(source.read(i)[0, 0, 0]) for i in range(len(expected))]
    assert got == expected
    assert source.read(len(expected)) is None
    assert source.length == len(expected)


@pytest.mark.parametrize(("name", "value"), [("every", 0), ("fps", 0), ("fps", float("nan"))])
def test_46_a_thinning_that_is_none_is_refused(tmp_path, name, value):
    with pytest.raises(ValueError, match=f"{name} is {value}"):
        VideoFile(film(tmp_path / "a.avi", 2), **{name: value})


def test_46_large_frames_and_playlists_are_refused(monkeypatch, tmp_path):
    film(tmp_path / "a.avi", 2)
    (tmp_path / "list.avi").write_text("ffconcat version 1.0\nfile a.avi\n")
    with pytest.raises(ValueError, match=r"list\.avi is a playlist; give the video itself"):
        VideoFile(tmp_path / "list.avi")
    monkeypatch.setattr("amusic_gym.routes.video.MAX_PIXELS", 64 * 96 - 1)
    with pytest.raises(ValueError, match="frames of 96 x 64 pixels, more than the limit of 6143"):
        VideoFile(tmp_path / "a.avi")


@pytest.mark.parametrize("suffix", [".avi", ".mp4"])
def test_46_a_video_that_cannot_be_written_whole_leaves_the_old_one(tmp_path, suffix, capfd):
    path = film(tmp_path / f"old{suffix}")
    before = path.read_bytes()
    noise = np.random.default_rng(0).integers(0, 256, (40, 64, 96, 3), dtype=np.uint8)
    writer, limits = VideoWriter(path, 10), resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, limits[1]))
    try:
        for each in noise:
            writer.write(each)
        with pytest.raises(OSError, match="cannot be written whole; nothing was changed there"):
            writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


# ---- 47: damage ---------------------------------------------------------------------------


def photo(height: int = 96, width: int = 130) -> np.ndarray:
    noise = np.random.default_rng(height).integers(0, 256, (height, width, 3), dtype=np.uint8)
    return cv2.GaussianBlur(noise, (0, 0), 1.5)


def saved(kind: str, image: np.ndarray, **options: object) -> bytes:
    file = io.BytesIO()
    Pillow.fromarray(image).save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("optimize", [False, True])
@pytest.mark.parametrize("subsampling", [0, 1, 2])
def test_47_whole_jpegs_pass(progressive, optimize, subsampling):
    how = {"progressive": progressive, "optimize": optimize, "subsampling": subsampling}
    for image in (photo(), photo(17, 33), photo(1, 1), photo()[..., 0], 0 * photo()):
        for more in ({}, {"restart_marker_blocks": 3}, {"quality": 98}):
            check_jpeg(saved("JPEG", image, **how, **more))


@pytest.mark.parametrize("progressive", [False, True])
@pytest.mark.parametrize("optimize", [False, True])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("how", ["ended", "zeros", "ones", "noise"])
def test_47_jpegs_with_a_hole_or_an_early_end_are_refused(progressive, optimize, share, how):
    data = saved("JPEG", photo(240, 320), progressive=progressive, optimize=optimize)
    begin = int(share * len(data))
    noise = np.random.default_rng(0).integers(1, 255, len(data), dtype=np.uint8).tobytes()
    filler = {"ended": b"", "zeros": bytes(len(data)), "ones": b"\xff" * len(data), "noise": noise}
    bad = data[:begin] + filler[how][: len(data) - 2 - begin] + b"\xff\xd9"
    assert cv2.imdecode(np.frombuffer(bad, np.uint8), cv2.IMREAD_COLOR) is not None
    with pytest.raises(ValueError, match=r"x\.jpg is damaged: its picture data .*; copy it again"):
        decode_image(bad, "x.jpg")


def test_47_a_hole_is_seen_wherever_it_begins():
    # Here zeros are blocks of as many bits as the picture's own, so that their number is right.
    data = saved("JPEG", photo(), quality=96)
    for begin in range(len(data) // 3, len(data) - 200, 37):
        with pytest.raises(ValueError, match="is damaged: its picture data"):
            check_jpeg(data[:begin] + bytes(len(data) - 2 - begin) + b"\xff\xd9")
    smooth = cv2.GaussianBlur(photo(100, 160), (0, 0), 3)
    strips = saved("TIFF", smooth, compression="tiff_adobe_deflate")
    for begin in range(len(strips) // 4, len(strips) // 2, 331):
        with pytest.raises(ValueError, match="is damaged: strip"):
            check_tiff(strips[:begin] + bytes(len(strips) - 300 - begin) + strips[-300:])


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_47_a_spoiled_jpeg_gives_a_sentence_or_passes(data):
    whole = bytearray(saved("JPEG", photo(24, 40), progressive=data.draw(st.booleans())))
    for _ in range(data.draw(st.integers(1, 6))):
        whole[data.draw(st.integers(2, len(whole) - 1))] = data.draw(st.integers(0, 255))
    try:
        decode_image(bytes(whole), "x")
    except ValueError as error:
        assert str(error).startswith("x ")  # noqa: PT017


@pytest.mark.parametrize("compression", ["tiff_adobe_deflate", "tiff_lzw"])
@pytest.mark.parametrize("grey", [False, True])
def test_47_tiffs_with_holes_are_refused(compression, grey):
    image = photo(200, 321)[..., 0] if grey else photo(200, 321)
    data = saved("TIFF", image, compression=compression)
    check_tiff(data)
    third, half = len(data) // 3, len(data) // 2
    bad = data[:third] + bytes(half - third) + data[half:]
    with pytest.raises(ValueError, match=r"x is damaged: strip \d of its TIFF data"):
        decode_image(bad, "x")


@pytest.mark.parametrize("compression", [None, "packbits", "jpeg"])
def test_47_other_whole_tiffs_pass(compression):
    check_tiff(saved("TIFF", photo(), compression=compression))


def spoil(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-9])


def test_47_all_bad_files_of_a_folder_are_named_together(tmp_path):
    folder = ImageFolder(make(tmp_path, [f"{i}.png" for i in range(9)]))
    for bad in range(1, 8):
        spoil(folder.paths[bad])
    with pytest.raises(
        ValueError, match=r"7 images .*1\.png is .*5\.png .*and 2 more.*--skip-damaged"
    ):
        images_of(folder)
    assert list(folder.damaged()) == list(range(1, 8))


def test_47_frames_keep_their_numbers_where_damaged_ones_are_left_out(tmp_path):
    here = ImageFolder(make(tmp_path / "r", [f"{i}.png" for i in range(6)]))
    there = ImageFolder(make(tmp_path / "q", [f"{i}.png" for i in range(5)]))
    spoil(here.paths[2])
    spoil(there.paths[0])
    places, frames = here.without(here.damaged()), there.without(there.damaged())
    assert places.kept == (0, 1, 3, 4, 5)
    (tmp_path / "truth.txt").write_text("0\n1\n2\n3\n4\n")
    for truth in (
        image_truth.by_index(places, frames, 1),
        image_truth.by_name(places, frames, 1),
        image_truth.from_file(tmp_path / "truth.txt", places, frames, 1),
    ):
        expected = [[0, 1], [1, 2], [2, 3], [2, 3, 4]]  # of 0, 1, 3, 4, 5
        assert [np.flatnonzero(row).tolist() for row in truth.matrix()] == expected
    with pytest.raises(ValueError, match="no image is left"):
        there.without(range(5))


# ---- 48: kinds and depths -----------------------------------------------------------------


def test_48_files_that_look_like_images_are_counted_and_named(tmp_path):
    make(tmp_path, ["0.png", "1.jpg", "2.png"])
    for name in ("3.HEIC", "4.heic", "5.NEF"):
        (tmp_path / name).write_bytes(b"ftypheic")
    with pytest.warns(UserWarning, match=r"3 files .* \(3\.HEIC, 4\.heic, 5\.NEF\): convert them"):
        assert len(ImageFolder(tmp_path)) == 3
    only = tmp_path / "only"
    only.mkdir()
    (only / "1.heic").write_bytes(b"")
    with pytest.raises(ValueError, match=r"holds no images; .* but 1 files look like images"):
        ImageFolder(only)


def test_48_jfif_is_read(tmp_path):
    (tmp_path / "0.JFIF").write_bytes(encoded(".jpg", image=picture()))
    assert ImageFolder(tmp_path)[0].shape == (12, 16, 3)


def pgm(image: np.ndarray, maximum: int) -> bytes:
    kind = ">u2" if maximum > 255 else "u1"
    return b"P5\n%d %d\n%d\n" % (*image.shape[::-1], maximum) + image.astype(kind).tobytes()


def test_48_twelve_bits_in_sixteen_keep_their_levels():
    eight = np.arange(256, dtype=np.uint16).reshape(16, 16)
    twelve = eight << 4 | 15
    for data in (encoded(".png", image=twelve), encoded(".tif", image=twelve), pgm(twelve, 4095)):
        np.testing.assert_array_equal(decode_image(data, "x")[..., 0], eight)


def test_48_the_maximum_of_a_pnm_counts_not_that_of_its_pixels():
    dark = np.full((4, 4), 160, np.uint16)
    assert (decode_image(pgm(dark, 4095), "x") == 10).all()
    assert (decode_image(pgm(dark // 32, 15), "x") == 85).all()  # 5 of 15
    assert (decode_image(pgm(dark, 255), "x") == 160).all()


def test_48_few_grey_levels_that_are_left_are_told(tmp_path):
    thermal = np.linspace(29000, 31000, 400).astype(np.uint16).reshape(20, 20)
    (tmp_path / "0.png").write_bytes(encoded(".png", image=thermal))
    with pytest.warns(UserWarning, match=r"0\.png keeps 17 of its 400 grey levels as 8 bits"):
        images_of(ImageFolder(tmp_path))


# ---- 17: the limit cannot be passed by --------------------------------------------------------


def tiff(tags: list[tuple[int, int, int]]) -> bytes:
    """A TIFF's header; (tag, kind, value), 64-bit values at its end."""
    entries, late = b"", b""
    begin = 8 + 2 + 12 * len(tags) + 4
    for tag, kind, value in tags:
        if kind == 16:
            entries += struct.pack("<HHII", tag, kind, 1, begin + len(late))
            late += struct.pack("<Q", value)
        else:
            entries += struct.pack("<HHII", tag, kind, 1, value)
    return b"II*\0\x08\0\0\0" + struct.pack("<H", len(tags)) + entries + bytes(4) + late


@pytest.mark.parametrize(
    "data",
    [
        tiff([(256, 4, 20000), (256, 4, 5), (257, 4, 12000), (257, 4, 5)]),
        tiff([(256, 4, 5), (256, 4, 20000), (257, 4, 12000)]),
        tiff([(256, 16, 20000), (257, 16, 12000)]),
        b"P4\n" + b"0" * 20 + b"20000 " + b"0" * 30 + b"12000\n",
    ],
)
def test_17_sizes_told_twice_or_in_other_ways_count(data):
    with pytest.raises(ValueError, match="has 20000 x 12000 pixels, more than the limit"):
        decode_image(data, "x")


def test_17_opencv_has_the_same_limit_behind():
    code = "import amusic_gym, os; print(os.environ['OPENCV_IO_MAX_IMAGE_PIXELS'])"
    code += "; from amusic_gym.routes.images import MAX_PIXELS; print(MAX_PIXELS)"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    ours, its = done.stdout.split()
    assert ours == its


def test_17_a_jpeg_of_many_scans_is_refused():
    data = saved("JPEG", photo(), progressive=True)
    begin = data.rindex(b"\xff\xda")
    with pytest.raises(ValueError, match="is damaged: a JPEG of more than 64 scans"):
        decode_image(data[:begin] + 70 * data[begin:-2] + data[-2:], "x")
