"""What the project promises of images and folders of them: one test per row and case."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import warnings
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from image_cases import FILES, encoded, picture, pillow
from PIL import Image as Pillow
from PIL import ImageOps

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import MAX_PIXELS, decode_image, read_image

ROOT = Path(__file__).resolve().parent.parent


def png_of_size(width: int, height: int) -> bytes:
    """A whole PNG of a few bytes that claims to be large."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return len(data).to_bytes(4, "big") + body + zlib.crc32(body).to_bytes(4, "big")

    header = width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x02\0\0\0"
    pixels = chunk(b"IDAT", zlib.compress(b""))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + pixels + chunk(b"IEND", b"")


def make_images(folder: Path, names: list[str]) -> Path:
    """A folder with a different small image under each name."""
    for seed, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded(".png", image=picture(seed=seed)))
    return folder


# ---- 15: missing, empty, garbage ----------------------------------------------------------


def test_15_missing_image_is_refused_with_its_path(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.jpg does not exist"):
        read_image(tmp_path / "nowhere.jpg")


def test_15_folder_named_like_an_image_is_refused_with_its_path(tmp_path):
    (tmp_path / "x.jpg").mkdir()
    with pytest.raises(ValueError, match=r"x\.jpg is a folder; give a file"):
        read_image(tmp_path / "x.jpg")
    make_images(tmp_path, ["a.png"])
    with pytest.raises(ValueError, match=r"x\.jpg is a folder with the name of an image"):
        ImageFolder(tmp_path)


def test_15_pipe_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "x.jpg")
    with pytest.raises(ValueError, match=r"x\.jpg is a device or a pipe"):
        read_image(tmp_path / "x.jpg")


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        (b"", "is empty"),
        (b"no image at all", "is no JPEG, PNG, BMP, PNM, TIFF or WebP image"),
        (b"GIF89a" + bytes(50), "is no JPEG"),
        (b"\xff\xd8\xff\xd9" + bytes(50), "is damaged: its header says 0 x 0"),
        (b"\x89PNG\r\n\x1a\n", "is truncated: it ends within its header"),
        (png_of_size(0, 5), "is damaged: its header says 0 x 5"),
        (png_of_size(20, 10), "cannot be decoded"),
        (b"P6 twelve", "is damaged: a PNM without"),
    ],
)
def test_15_empty_and_garbage_files_are_refused_with_their_path(tmp_path, data, sentence):
    path = tmp_path / "x.jpg"
    path.write_bytes(data)
    with pytest.raises(ValueError, match=f"x.jpg {sentence}"):
        read_image(path)


def test_15_missing_folder_and_file_in_place_of_one_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere does not exist; give the folder"):
        ImageFolder(tmp_path / "nowhere")
    make_images(tmp_path, ["a.png"])
    with pytest.raises(ValueError, match=r"a\.png is a file; give the folder"):
        ImageFolder(tmp_path / "a.png")


def test_15_folder_without_images_is_refused(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing to see")
    make_images(tmp_path, ["._a.png", ".hidden/a.png"])
    with pytest.raises(ValueError, match="holds no images; give a folder with files that end in"):
        ImageFolder(tmp_path)


def test_15_bad_image_in_a_folder_is_named_when_it_is_read(tmp_path):
    make_images(tmp_path, ["0.png", "1.png"])
    (tmp_path / "1.png").write_bytes(b"")
    folder = ImageFolder(tmp_path)
    assert folder[0].shape == (12, 16, 3)
    with pytest.raises(ValueError, match=r"1\.png is empty"):
        folder[1]


# ---- 16: truncated ------------------------------------------------------------------------

JPEGS = [kind for kind in FILES if "JPEG" in kind]


@pytest.mark.parametrize("kind", [*JPEGS, "PNG", "palette PNG"])
def test_16_truncated_jpeg_and_png_are_refused_wherever_they_end(tmp_path, kind):
    data = FILES[kind]
    path = tmp_path / "x.jpg"
    for length in range(8, len(data), max(1, len(data) // 50)):
        path.write_bytes(data[:length])
        with pytest.raises(ValueError, match=r"x\.jpg is truncated: .*; copy it again"):
            read_image(path)
    path.write_bytes(data[:-1])
    with pytest.raises(ValueError, match="is truncated"):
        read_image(path)


def test_16_jpeg_whose_rest_is_zeros_is_refused():
    # A download that broke off into a file of full length: OpenCV decodes it without a word.
    noise = np.random.default_rng(0).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    whole = encoded(".jpg", image=noise)
    data = whole[: len(whole) // 4].ljust(len(whole), b"\0")
    assert cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR) is not None
    with pytest.raises(ValueError, match="is truncated"):
        decode_image(data, "x.jpg")


def test_16_thumbnail_has_an_end_of_its_own():
    whole = encoded(".jpg", image=picture(240, 320))
    thumbnail = b"Exif\0\0" + encoded(".jpg")
    segment = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    data = whole[:2] + segment + whole[2:]
    np.testing.assert_array_equal(decode_image(data, "x"), decode_image(whole, "x"))
    assert b"\xff\xd9" in data[: len(data) // 2]
    with pytest.raises(ValueError, match="is truncated"):
        decode_image(data[: len(data) * 3 // 4], "x.jpg")


@pytest.mark.parametrize("kind", [*JPEGS, "PNG", "BMP", "PPM", "TIFF", "lossless WebP"])
@pytest.mark.parametrize("rest", [b"\0" * 100, b"\xff", b"\xff\xd8\xff\xe0 another image"])
def test_16_bytes_after_the_end_do_no_harm(kind, rest):
    plain = decode_image(FILES[kind], "x")
    np.testing.assert_array_equal(decode_image(FILES[kind] + rest, "x"), plain)


@pytest.mark.parametrize(
    "kind", ["BMP", "PPM", "TIFF", "16-bit TIFF", "lossy WebP", "lossless WebP"]
)
def test_16_other_truncated_files_are_refused_too(kind, capfd):
    for share in (0.3, 0.6, 0.95):
        data = FILES[kind][: int(share * len(FILES[kind]))]
        with pytest.raises(ValueError, match="is truncated|cannot be decoded|is damaged"):
            decode_image(data, "x")


def test_16_flipped_bit_in_a_png_is_refused(capfd):
    data = bytearray(FILES["PNG"])
    data[len(data) // 2] ^= 0x10
    with pytest.raises(ValueError, match="cannot be decoded: it is damaged"):
        decode_image(bytes(data), "x.png")


# ---- 17: too large ------------------------------------------------------------------------


def test_17_image_above_the_limit_is_refused_before_it_is_allocated():
    code = (
        "import resource, sys\n"
        "from amusic_gym.routes.images import decode_image\n"
        "import cv2\n"
        "data = sys.stdin.buffer.read()\n"
        "before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "try:\n"
        "    decode_image(data, 'huge.png')\n"
        "except ValueError as error:\n"
        "    print(error)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)\n"
    )
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        input=png_of_size(40_000, 30_000),
        capture_output=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        timeout=120,
        check=True,
    )
    sentence, grown = done.stdout.decode().splitlines()
    assert sentence == (
        f"huge.png has 40000 x 30000 pixels, more than the limit of {MAX_PIXELS}; make it smaller"
    )
    assert int(grown) < 20_000, "kB"
    assert done.stderr == b""


@pytest.mark.parametrize("kind", FILES)
def test_17_the_limit_counts_pixels_and_can_be_set(kind):
    assert decode_image(FILES[kind], "x", max_pixels=16 * 12).shape == (12, 16, 3)
    with pytest.raises(ValueError, match=r"x has 16 x 12 pixels, more than the limit of 191"):
        decode_image(FILES[kind], "x", max_pixels=16 * 12 - 1)


def test_17_more_than_opencv_takes_is_refused_all_the_same(capfd):
    for size in ((40_000, 30_000), (2_000_000, 3)):  # its limits of area and of width
        with pytest.raises(ValueError, match="cannot be decoded"):
            decode_image(png_of_size(*size), "x.png", max_pixels=10**10)


# ---- 18: kinds of pixels, rotation --------------------------------------------------------


def test_18_grey_becomes_three_equal_channels():
    image = decode_image(pillow("PNG", "L"), "x")
    assert image.shape == (12, 16, 3)
    assert (image == image[..., :1]).all()


@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_18_alpha_is_dropped_and_the_colour_beneath_kept(suffix):
    transparent = np.dstack([picture(), np.zeros((12, 16), np.uint8)])
    image = decode_image(encoded(suffix, image=transparent), "x")
    np.testing.assert_array_equal(image, picture())


@pytest.mark.parametrize(("suffix", "within"), [(".png", 0), (".ppm", 0), (".tif", 0)])
def test_18_the_upper_eight_of_16_bits_stay(suffix, within):
    deep = np.random.default_rng(0).integers(0, 1 << 16, (12, 16, 3), dtype=np.uint16)
    image = decode_image(encoded(suffix, image=deep), "x")
    assert image.dtype == np.uint8
    assert np.abs(image.astype(int) - (deep >> 8)).max() <= within
    grey = decode_image(encoded(".png", image=deep[..., 0]), "x")
    np.testing.assert_array_equal(grey[..., 2], deep[..., 0] >> 8)


def test_18_palette_is_looked_up():
    few = picture() // 128 * 255
    file = io.BytesIO()
    Pillow.fromarray(few[..., ::-1]).quantize(8).save(file, "PNG", transparency=0)
    np.testing.assert_array_equal(decode_image(file.getvalue(), "x"), few)


def test_18_mixed_sizes_in_one_folder(tmp_path):
    sizes = [(12, 16), (40, 30), (1, 1)]
    for number, (height, width) in enumerate(sizes):
        data = encoded(".png", image=picture(height, width, number))
        (tmp_path / f"{number}.png").write_bytes(data)
    assert [image.shape[:2] for image in ImageFolder(tmp_path)] == sizes


@pytest.mark.parametrize("orientation", range(1, 9))
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "WEBP", "TIFF"])
def test_18_exif_rotation_is_applied_as_a_viewer_does(kind, orientation):
    exif = Pillow.Exif()
    exif[0x0112] = orientation
    options = {"JPEG": {"quality": 100}, "WEBP": {"lossless": True}}.get(kind, {})
    data = pillow(kind, exif=exif, **options)
    upright = ImageOps.exif_transpose(Pillow.open(io.BytesIO(data))).convert("RGB")
    image = decode_image(data, "x")
    assert image.shape[:2] == ((12, 16) if orientation < 5 else (16, 12))
    assert np.abs(image[..., ::-1].astype(int) - np.asarray(upright)).max() <= 3


# ---- 19: names and links ------------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    ["Zürich – 夜.png", "with some spaces .png", "'quoted\".png", "line\nbreak.png", "é.PNG"],
)
def test_19_unusual_names_are_read(tmp_path, name):
    make_images(tmp_path / "a folder ü", [name])
    folder = ImageFolder(tmp_path / "a folder ü")
    assert folder.names == (name,)
    np.testing.assert_array_equal(folder[0], picture())


def test_19_names_that_are_no_unicode_are_read(tmp_path):
    name = os.fsdecode(b"caf\xe9-\xff.png")
    make_images(tmp_path, [name])
    np.testing.assert_array_equal(ImageFolder(tmp_path)[0], picture())


def test_19_very_long_paths_are_read(tmp_path):
    longest = os.pathconf(tmp_path, "PC_PATH_MAX") - 1
    path = tmp_path
    while len(str(path)) + 202 < longest - 20:
        path /= "d" * 200
    path /= "f" * (longest - len(str(path)) - 6) + ".png"
    assert len(str(path)) > 3800
    make_images(path.parent, [path.name])
    np.testing.assert_array_equal(read_image(path), picture())
    assert ImageFolder(tmp_path).paths == (path,)


def test_19_symlink_loops_end(tmp_path):
    make_images(tmp_path, ["a/1.png", "b/2.png"])
    (tmp_path / "a" / "up").symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "a" / "other").symlink_to(tmp_path / "b", target_is_directory=True)
    (tmp_path / "b" / "back").symlink_to(tmp_path / "a", target_is_directory=True)
    (tmp_path / "self").symlink_to(tmp_path / "self")
    # Each real folder once: b is first met through a.
    with pytest.warns(UserWarning, match=r"images of 2 folders .*: a \(1\), a/other \(1\)"):
        assert ImageFolder(tmp_path).names == ("a/1.png", "a/other/2.png")


def test_19_links_are_followed_and_a_dangling_one_is_named(tmp_path):
    make_images(tmp_path / "there", ["1.png"])
    here = tmp_path / "here"
    here.mkdir()
    (here / "7.png").symlink_to(tmp_path / "there" / "1.png")
    np.testing.assert_array_equal(ImageFolder(here)[0], picture())
    for target in (tmp_path / "gone.png", here / "8.png"):
        (here / "8.png").symlink_to(target)
        with pytest.raises(FileNotFoundError, match=r"8\.png is a link to what cannot be read"):
            ImageFolder(here)
        (here / "8.png").unlink()


# ---- 20: order, gaps, repeats -------------------------------------------------------------


def test_20_img2_comes_before_img10(tmp_path):
    make_images(tmp_path, [f"img{n}.png" for n in (10, 9, 1, 2, 100)])
    with pytest.warns(UserWarning, match="numbers are missing"):
        folder = ImageFolder(tmp_path)
    assert folder.names == ("img1.png", "img2.png", "img9.png", "img10.png", "img100.png")


def test_20_gap_in_the_numbering_warns_with_the_frame_numbers(tmp_path):
    make_images(tmp_path, [f"{n:04}.png" for n in (1, 2, 3, 6, 7, 9)])
    with pytest.warns(UserWarning, match="numbers are missing") as caught:
        ImageFolder(tmp_path)
    (warning,) = caught
    assert str(warning.message) == (
        f"{tmp_path}: numbers are missing from frame 2 to 3 (0003.png, 0006.png), "
        "4 to 5 (0007.png, 0009.png); neighbouring frames must be neighbours on the route: "
        "look for lost files"
    )
    assert warning.filename == __file__


def test_20_repeated_frames_warn_with_the_frame_numbers(tmp_path):
    make_images(tmp_path, [f"{n}.png" for n in range(8)])
    for copy, original in [(2, 1), (3, 1), (7, 6)]:
        (tmp_path / f"{copy}.png").write_bytes((tmp_path / f"{original}.png").read_bytes())
    with pytest.warns(UserWarning, match="the same image is repeated in frames 1 to 3, 6 to 7;"):
        folder = ImageFolder(tmp_path)
    assert folder.repeats == ((1, 3), (6, 7))


def test_20_files_of_one_size_are_repeats_only_if_every_byte_is_the_same(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (200, 300, 3), dtype=np.uint8)
    other = image.copy()
    other[0, 0, 0] ^= 1  # a bitmap begins with its last row, so this is near the end of the file
    for number, pixels in enumerate([image, other, image]):
        (tmp_path / f"{number}.bmp").write_bytes(encoded(".bmp", image=pixels))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert ImageFolder(tmp_path).repeats == ()


def test_20_a_number_used_twice_warns(tmp_path):
    make_images(tmp_path, ["1.png", "2.png", "3.png"])
    (tmp_path / "2.jpg").write_bytes(FILES["baseline JPEG"])
    with pytest.warns(
        UserWarning, match=r"the same number is on frames 1 and 2 \(2\.jpg, 2\.png\)"
    ):
        ImageFolder(tmp_path)


@pytest.mark.parametrize(
    "numbers",
    [range(10), range(10, 100, 10), range(200, 1200, 2), [5], [1503, 1701, 1822, 2930, 3047, 3311]],
)
def test_20_even_numbering_and_times_give_no_warning(tmp_path, numbers):
    make_images(tmp_path, [f"frame-{n}.png" for n in numbers])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(ImageFolder(tmp_path)) == len(numbers)


# ---- 21: ground truth ---------------------------------------------------------------------


@pytest.fixture
def traverses(tmp_path) -> tuple[ImageFolder, ImageFolder]:
    """A map of 5 and a run of 4 images."""
    reference = make_images(tmp_path / "reference", [f"{n}.png" for n in range(5)])
    query = make_images(tmp_path / "query", [f"{n}.png" for n in range(4)])
    return ImageFolder(reference), ImageFolder(query)


@pytest.mark.parametrize(
    ("array", "sentence"),
    [
        (np.ones((4, 4), bool), r"shape \(4, 4\).*4 queries and 5 references"),
        (np.ones((5, 4), bool), r"shape \(5, 4\)"),
        (np.ones((4, 5), np.uint8), "boolean matrix"),
        (np.arange(3), r"shape \(3,\)"),
        (np.array([0, 1, 2, 5]), r"true place 5 \(entry 3\) is out of range; valid: -1 to 4"),
        (np.array([0, 1, 2, -2]), "true place -2"),
        (np.zeros(4), "list of integers"),
        (np.array(3), r"shape \(\)"),
    ],
)
def test_21_ground_truth_of_wrong_shape_or_range_is_refused(tmp_path, traverses, array, sentence):
    np.save(tmp_path / "truth.npy", array)
    with pytest.raises(ValueError, match=rf"truth\.npy: .*{sentence}"):
        image_truth.from_file(tmp_path / "truth.npy", *traverses, tolerance=1)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("", "holds no ground truth"),
        ("# nothing\n\n", "holds no ground truth"),
        ("0\n1\n2\n", r"shape \(3,\)"),
        ("0\n1\n2\n7\n", "true place 7 .* is out of range"),
        ("0\n1\n2\n99999999999999999999999\n", "list of integers"),
        ("0\n1\ntwo\n3\n", "line 3: 'two' are not whole numbers"),
        ("0\n1\n2.5\n3\n", "line 3: '2.5' are not whole numbers"),
        ("0 1\n1\n", r"lines of \[1, 2\] numbers"),
        ("0,1\n1,2\n", "pairs need the line query,place"),
        ("0,1\n1,0\n", r"shape \(2, 2\)"),
        ("query,place\n0,1\n4,0\n", "query 4, place 0 is out of range"),
        ("query,place\n0,1\n3,5\n", "query 3, place 5 is out of range"),
        ("query,place\n0,1,2\n", r"lines of \[3\] numbers"),
        (b"\xff\xfe\x00", "is no text"),
    ],
)
def test_21_text_of_wrong_shape_or_range_is_refused(tmp_path, traverses, text, sentence):
    path = tmp_path / "truth.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=rf"truth\.csv.*{sentence}"):
        image_truth.from_file(path, *traverses, tolerance=1)


def test_21_places_without_a_tolerance_are_refused(tmp_path, traverses):
    (tmp_path / "truth.txt").write_text("0\n1\n2\n3\n")
    with pytest.raises(ValueError, match=r"truth\.txt: tolerance is missing"):
        image_truth.from_file(tmp_path / "truth.txt", *traverses)
    with pytest.raises(ValueError, match="tolerance is -1"):
        image_truth.from_file(tmp_path / "truth.txt", *traverses, tolerance=-1)


def test_21_query_without_a_true_place_counts_as_wrong(tmp_path, traverses):
    (tmp_path / "truth.csv").write_text("0\n-1\n2\n3\n")
    truth = image_truth.from_file(tmp_path / "truth.csv", *traverses, tolerance=0)
    bank = ScoreBank(np.eye(4, 5)[None], ["T"], [1.0], ground_truth=truth, tolerance=0)
    assert bank.truth.correct([0, 1, 2, 3]).tolist() == [True, False, True, True]
    assert bank.truth.has_place.tolist() == [True, False, True, True]


def test_24_pickled_ground_truth_needs_trust(tmp_path, traverses):
    rows = np.empty((4, 2), object)
    for query in range(4):
        rows[query] = query, [query, query + 1]
    np.save(tmp_path / "ground_truth_new.npy", rows, allow_pickle=True)
    path = tmp_path / "ground_truth_new.npy"
    with pytest.raises(ValueError, match=r"ground_truth_new\.npy holds pickled .* trust=True"):
        image_truth.from_file(path, *traverses)
    truth = image_truth.from_file(path, *traverses, trust=True)
    expected = np.eye(4, 5, dtype=bool) | np.eye(4, 5, 1, dtype=bool)
    np.testing.assert_array_equal(truth.matrix(), expected)
    rows[3] = 3, [5]
    np.save(path, rows, allow_pickle=True)
    with pytest.raises(ValueError, match=r"ground_truth_new\.npy: true place 5"):
        image_truth.from_file(path, *traverses, trust=True)
