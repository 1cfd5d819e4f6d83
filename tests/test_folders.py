"""Folders as traverses: order, parts, joins; and what is true between two of them."""

from __future__ import annotations

import copy
import os
import pickle
import warnings
from pathlib import Path, PurePath

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_cases import encoded, picture

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.banks.importers import from_vprbench
from amusic_gym.routes import image_truth
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.numbering import arranged, gaps, natural_key, same_numbers

DATA = os.environ.get("AMUSIC_DATA")
needs_data = pytest.mark.skipif(not DATA, reason="AMUSIC_DATA names no folder of recordings")

# Names as people give them: few letters, so that they often begin alike, and numbers with zeros.
names = st.text(alphabet="aBZ_.-@é0123789 ", min_size=1, max_size=10)


def make_images(folder: Path, stems: list[str], seed: int = 0) -> Path:
    for number, stem in enumerate(stems, seed):
        path = folder / f"{stem}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(encoded(".png", image=picture(seed=number)))
    return folder


def traverse(folder: Path, stems: list[str]) -> ImageFolder:
    return ImageFolder(make_images(folder, stems))


def numbered(folder: Path, images: int, **options: int) -> ImageFolder:
    return ImageFolder(make_images(folder, [f"{n}" for n in range(images)]), **options)


# ---- natural order ------------------------------------------------------------------------


@given(st.lists(names, unique=True), st.randoms())
def test_natural_order_does_not_depend_on_the_order_before(given_names, random):
    shuffled = given_names.copy()
    random.shuffle(shuffled)
    assert sorted(shuffled, key=natural_key) == sorted(given_names, key=natural_key)


@given(
    st.text(alphabet="aBZ_.-@é ", max_size=5),
    st.lists(st.integers(0, 10**20), unique=True),
    st.integers(0, 8),
    st.text(alphabet="aBZ_.-@é ", max_size=5),
)
def test_natural_order_agrees_with_the_order_of_integers(before, numbers, width, after):
    before = before.rstrip("-")  # that would be a sign
    texts = [f"{before}{number:0{width}}{after}" for number in numbers]
    expected = [f"{before}{number:0{width}}{after}" for number in sorted(numbers)]
    assert sorted(texts, key=natural_key) == expected


@given(st.lists(st.tuples(*[st.integers(0, 30)] * 3), unique=True))
def test_natural_order_agrees_with_the_order_of_several_integers(rows):
    texts = [f"run{a}_cam{b}/frame{c}" for a, b, c in rows]
    expected = [f"run{a}_cam{b}/frame{c}" for a, b, c in sorted(rows)]
    assert [texts[at] for at in arranged([PurePath(text) for text in texts])] == expected


@given(st.lists(st.text(alphabet="abcz_-", max_size=6)))
def test_natural_order_without_numbers_is_that_of_the_text(texts):
    assert sorted(texts, key=natural_key) == sorted(texts)


@given(st.lists(names, min_size=2, max_size=2, unique=True))
def test_no_two_names_are_equal(pair):
    assert natural_key(pair[0]) != natural_key(pair[1])


def test_upper_and_lower_case_only_break_ties():
    ordered = ["IMG1", "img1", "img2", "IMG3"]
    assert sorted(ordered[::-1], key=natural_key) == ordered


def test_shorter_names_come_first_and_folders_compare_as_wholes():
    paths = ["a10/1.png", "a2/9.png", "a2/10.png", "a2-b/1.png", "img1-2.png", "img1.png"]
    ordered = ["a2/9.png", "a2/10.png", "a2-b/1.png", "a10/1.png", "img1.png", "img1-2.png"]
    assert [paths[at] for at in arranged([PurePath(path) for path in paths])] == ordered


# ---- gaps ---------------------------------------------------------------------------------


def paths_of(*stems: object) -> list[PurePath]:
    return [PurePath(f"{stem}.png") for stem in stems]


@given(st.integers(0, 1000), st.integers(1, 50), st.integers(4, 30), st.data())
def test_exactly_the_lost_frames_are_found(start, stride, count, data):
    numbers = range(start, start + stride * count, stride)
    # Inner frames, apart: so that most steps stay the usual one.
    lost = data.draw(st.sets(st.sampled_from(range(3, count - 1, 4) or [3]), max_size=5))
    kept = [at for at in range(count) if at not in lost]
    expected = [i for i, (a, b) in enumerate(zip(kept, kept[1:], strict=False)) if b - a > 1]
    assert gaps(paths_of(*(f"f{numbers[at]:05}_x" for at in kept))) == expected


@pytest.mark.parametrize(
    ("stems", "expected"),
    [
        ((), []),
        (("a",), []),
        ((7,), []),
        (("a", "b", "c"), []),
        ((1, 5), []),  # one step only: it is the usual one
        ((1, 2, 5), [1]),
        ((1, 5, 6), [0]),
        ((10, 20, 30, 35, 40, 50, 70), [5]),  # a frame too many is no gap
        (("a1", "a2", "b7", "b8", "b11"), [3]),  # two series
        (("a1", "a2", "a3", "b10", "b20", "b30"), []),  # each with its own step
        (("@0@1.5@9", "@0@2.5@10", "@0@3.9@90"), []),  # positions
        ((1503, 1701, 1822, 2930, 3047), []),  # times
        (("key-640-00266", "key-640-00267", "key-640-00269", "key-640-00270"), [1]),
    ],
)
def test_gaps(stems, expected):
    assert gaps(paths_of(*stems)) == expected


def test_numbers_used_twice():
    assert same_numbers([PurePath("1.jpg"), PurePath("1.png"), PurePath("2.png")]) == [0]
    assert same_numbers(paths_of("01", "1", "2", "3", "03")) == [0, 3]
    assert same_numbers(paths_of("a1", "b1")) == []


def test_series_of_different_folders_are_different():
    paths = [PurePath(path) for path in ("a/1.png", "a/2.png", "b/8.png", "b/9.png")]
    assert gaps(paths) == []


# ---- ImageFolder --------------------------------------------------------------------------


def test_a_folder_is_a_sequence_of_images(tmp_path):
    folder = numbered(tmp_path, 12)
    assert len(folder) == len(folder.paths) == 12
    assert folder.names[:3] == ("0.png", "1.png", "2.png")
    assert folder.paths[10] == tmp_path / "10.png"
    assert folder.parts == (12,)
    for number, image in enumerate(folder):
        np.testing.assert_array_equal(image, picture(seed=number))
    np.testing.assert_array_equal(folder[-1], picture(seed=11))
    np.testing.assert_array_equal(folder[np.int64(3)], picture(seed=3))
    with pytest.raises(IndexError):
        folder[12]
    with pytest.raises(TypeError):
        folder[1.0]


def test_only_image_files_count(tmp_path):
    make_images(tmp_path, ["1", "._1", "sub/2", ".git/3", "__MACOSX/._4"])
    (tmp_path / "1.png.json").write_text("{}")
    (tmp_path / "Thumbs.db").write_bytes(b"")
    (tmp_path / "png").write_bytes(b"")
    (tmp_path / "5.PNG").write_bytes(encoded(".png", image=picture(seed=9)))
    with pytest.warns(UserWarning, match=r"images of 2 folders .*: \. \(2\), sub \(1\)"):
        assert ImageFolder(tmp_path).names == ("1.png", "5.PNG", "sub/2.png")


def test_subfolders_are_followed_in_natural_order(tmp_path):
    with pytest.warns(UserWarning, match="images of 3 folders"):
        folder = traverse(tmp_path, ["part10/1", "part9/2", "part9/1", "part9/deeper/5"])
    assert folder.names == ("part9/1.png", "part9/2.png", "part9/deeper/5.png", "part10/1.png")


def test_text_and_relative_paths_do_as_well(tmp_path, monkeypatch):
    make_images(tmp_path / "run", ["1"])
    monkeypatch.chdir(tmp_path)
    folder = ImageFolder("run")
    assert folder.paths == (Path("run/1.png"),)
    assert folder.names == ("1.png",)
    assert folder == ImageFolder(Path("run"))


def test_a_part_is_taken_by_first_step_and_count(tmp_path):
    folder = numbered(tmp_path, 12, first=2, step=3, count=3)
    assert folder.names == ("2.png", "5.png", "8.png")
    assert folder.parts == (3,)
    assert ImageFolder(tmp_path, first=9).names == ("9.png", "10.png", "11.png")
    assert ImageFolder(tmp_path, step=5).names == ("0.png", "5.png", "10.png")
    assert ImageFolder(tmp_path, step=50, count=1).names == ("0.png",)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"first": 12}, "holds 12 images, but first=12, step=1, count=None needs 13"),
        ({"count": 13}, "holds 12 images, but first=0, step=1, count=13 needs 13"),
        ({"first": 1, "step": 5, "count": 4}, "first=1, step=5, count=4 needs 17; take fewer"),
        ({"first": -1}, "first is -1; give a whole number >= 0"),
        ({"step": 0}, "step is 0; give a whole number >= 1"),
        ({"count": 0}, "count is 0; give a whole number >= 1 or None"),
        ({"step": 1.5}, "step is 1.5"),
    ],
)
def test_a_part_that_is_not_there_is_refused(tmp_path, options, sentence):
    with pytest.raises(ValueError, match=sentence):
        numbered(tmp_path, 12, **options)


def test_only_the_part_that_is_taken_is_doubted(tmp_path):
    make_images(tmp_path, ["0", "1", "2", "3", "50", "51"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ImageFolder(tmp_path, count=4)
        ImageFolder(tmp_path, first=4)
    with pytest.warns(UserWarning, match="numbers are missing from frame 3 to 4"):
        ImageFolder(tmp_path)


def test_many_gaps_are_counted(tmp_path):
    make_images(tmp_path, [f"{n}" for n in range(40) if n % 5])
    with pytest.warns(UserWarning, match=r"frame 3 to 4 .*19 to 20 \(24.png, 26.png\) and 2 more;"):
        ImageFolder(tmp_path)


def test_making_one_opens_no_file(tmp_path, monkeypatch):
    make_images(tmp_path, ["1", "2", "3"])
    monkeypatch.setattr(Path, "open", None)
    monkeypatch.setattr("builtins.open", None)
    assert len(ImageFolder(tmp_path)) == 3


def test_it_does_not_change_and_travels(tmp_path):
    folder = numbered(tmp_path, 3)
    with pytest.raises(AttributeError):
        folder.paths = ()  # type: ignore[misc]
    (tmp_path / "2.png").unlink()  # copies do not look again
    for twin in (pickle.loads(pickle.dumps(folder)), copy.deepcopy(folder)):
        assert twin == folder
        assert hash(twin) == hash(folder)
        assert len(twin) == 3
    assert folder != ImageFolder(tmp_path)
    assert repr(folder) == f"ImageFolder(path={tmp_path!r}, parts=(3,))"


# ---- joins --------------------------------------------------------------------------------


def test_joined_folders_are_one_traverse(tmp_path):
    one, two = numbered(tmp_path / "x" / "one", 3), numbered(tmp_path / "x" / "two", 2, first=1)
    joined = ImageFolder.join([one, two])
    assert joined.path == tmp_path / "x"
    assert joined.names == ("one/0.png", "one/1.png", "one/2.png", "two/1.png")
    assert joined.parts == (3, 1)
    np.testing.assert_array_equal(joined[3], two[0])
    assert ImageFolder.join([joined, one]).parts == (3, 1, 3)
    assert ImageFolder.join([one]) == one
    assert pickle.loads(pickle.dumps(joined)) == joined
    with pytest.raises(ValueError, match="no folders to join"):
        ImageFolder.join([])


def test_joined_folders_keep_their_repeats(tmp_path):
    make_images(tmp_path / "a", ["0", "1"])
    make_images(tmp_path / "b", ["0", "1", "2"], seed=7)
    (tmp_path / "b" / "2.png").write_bytes((tmp_path / "b" / "1.png").read_bytes())
    with pytest.warns(UserWarning, match="repeated in frames 1 to 2"):
        repeating = ImageFolder(tmp_path / "b")
    assert ImageFolder.join([ImageFolder(tmp_path / "a"), repeating]).repeats == ((3, 4),)


# ---- ground truth -------------------------------------------------------------------------


def band(queries: int, references: int, tolerance: int) -> np.ndarray:
    return abs(np.subtract.outer(np.arange(queries), np.arange(references))) <= tolerance


def test_by_index_is_what_a_bank_takes_by_default(tmp_path):
    reference, query = numbered(tmp_path / "r", 6), numbered(tmp_path / "q", 4)
    truth = image_truth.by_index(reference, query, tolerance=1)
    np.testing.assert_array_equal(truth.matrix(), band(4, 6, 1))
    default = ScoreBank(
        np.zeros((1, 4, 6)),
        ["T"],
        [1.0],
        tolerance=1,
        ground_truth=np.arange(4),
    )
    bank = ScoreBank(np.zeros((1, 4, 6)), ["T"], [1.0], tolerance=1, ground_truth=truth)
    np.testing.assert_array_equal(bank.truth.matrix(), default.truth.matrix())


def test_by_index_goes_part_by_part_and_does_not_cross(tmp_path):
    reference = ImageFolder.join([numbered(tmp_path / "a", 4), numbered(tmp_path / "b", 3)])
    query = ImageFolder.join([numbered(tmp_path / "c", 3), numbered(tmp_path / "d", 3)])
    expected = np.zeros((6, 7), bool)
    expected[:3, :4] = band(3, 4, 1)
    expected[3:, 4:] = band(3, 3, 1)
    truth = image_truth.by_index(reference, query, tolerance=1)
    np.testing.assert_array_equal(truth.matrix(), expected)


def test_by_index_needs_as_many_places_as_frames(tmp_path):
    long, short = numbered(tmp_path / "l", 4), numbered(tmp_path / "s", 3)
    with pytest.raises(ValueError, match=r"s has 3.* frame q cannot be at place q|l has 4 images"):
        image_truth.by_index(short, long, tolerance=1)
    one, two = ImageFolder.join([long, short]), ImageFolder.join([short, long])
    with pytest.raises(ValueError, match=r"3 \+ 4 images, .* 4 \+ 3: frame q cannot be at place q"):
        image_truth.by_index(one, two, tolerance=1)
    with pytest.raises(ValueError, match=r"has 4 images, .* 4 \+ 3:"):
        image_truth.by_index(one, long, tolerance=1)


def test_by_name_finds_namesakes(tmp_path):
    with pytest.warns(UserWarning, match="images of 2 folders"):
        reference = traverse(tmp_path / "r", ["a", "b", "c", "d", "sub/a"])
    with pytest.warns(UserWarning, match="images of 2 folders"):
        query = traverse(tmp_path / "q", ["b", "d", "sub/a", "x"])
    truth = image_truth.by_name(reference, query, tolerance=0)
    np.testing.assert_array_equal(np.argwhere(truth.matrix()), [[0, 1], [1, 3], [2, 4]])
    assert truth.has_place.tolist() == [True, True, True, False]
    wider = image_truth.by_name(reference, query, tolerance=1).matrix()
    assert np.flatnonzero(wider[0]).tolist() == [0, 1, 2]


def test_by_name_looks_in_the_same_part_only(tmp_path):
    reference = ImageFolder.join(
        [traverse(tmp_path / "r1", ["a", "b"]), traverse(tmp_path / "r2", ["a", "b"])]
    )
    query = ImageFolder.join([traverse(tmp_path / "q1", ["b"]), traverse(tmp_path / "q2", ["a"])])
    truth = image_truth.by_name(reference, query, tolerance=5)
    expected = [[True, True, False, False], [False, False, True, True]]
    np.testing.assert_array_equal(truth.matrix(), expected)


def test_by_name_refuses_what_it_cannot_tell(tmp_path):
    reference = traverse(tmp_path / "r", ["a", "b"])
    with pytest.raises(ValueError, match="no image in .*q has the name of one in .*r; give"):
        image_truth.by_name(reference, traverse(tmp_path / "q", ["x"]), tolerance=1)
    (tmp_path / "r" / "a.jpg").write_bytes(encoded(".jpg"))
    twice = ImageFolder(tmp_path / "r")
    with pytest.raises(ValueError, match=r"a\.jpg and .*a\.png have the same name"):
        image_truth.by_name(twice, reference, tolerance=1)


def test_by_position_counts_metres(tmp_path):
    places = ["@0550000.0@4180000.0@17@T@1@", "@0550024.0@4180007.0@17@T@2@"]
    places.append("@0550025.5@4180000@3@")
    frames = ["@550000@4180000@", "@550050.5@4180000@", "@0@0@"]
    reference, query = (
        ImageFolder(make_images(tmp_path / side, names), order=[f"{name}.png" for name in names])
        for side, names in (("r", places), ("q", frames))
    )
    order = [query.names.index(f"{name}.png") for name in ("@550000@4180000@", "@0@0@")]
    here, nowhere = image_truth.by_position(reference, query).matrix()[order]
    assert here.tolist() == [True, True, False]  # 24 and 7 metres make 25, which is still near
    assert nowhere.tolist() == [False, False, False]
    assert image_truth.by_position(reference, query, metres=26).matrix()[order[0]].all()
    assert image_truth.by_position(reference, query, metres=24.9).matrix()[order[0]].sum() == 1


def test_by_position_refuses_names_and_distances_that_are_none(tmp_path):
    reference = traverse(tmp_path / "r", ["@1@2@"])
    for stem in ("1", "@1", "@x@2@", "@nan@2@", "@1@inf@"):
        query = traverse(tmp_path / f"q{stem}", [stem])
        with pytest.raises(ValueError, match="does not say where it is; its name must begin with"):
            image_truth.by_position(reference, query)
    for metres in (-1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match=r"metres is .*; give a distance"):
            image_truth.by_position(reference, reference, metres=metres)
    far = traverse(tmp_path / "far", ["@900@2@"])
    with pytest.warns(UserWarning, match="check that both are in the same UTM zone"):
        assert not image_truth.by_position(reference, far).has_place.any()


@pytest.fixture
def pair(tmp_path) -> tuple[ImageFolder, ImageFolder]:
    return numbered(tmp_path / "r", 5), numbered(tmp_path / "q", 4)


PLACES = [0, 2, -1, 4]


@pytest.mark.parametrize(
    "text",
    [
        "0\n2\n-1\n4\n",
        "\ufeff# place of each query\r\n0\r\n\r\n2\r\n -1 # none\r\n4",
    ],
)
def test_from_file_reads_a_place_per_line(tmp_path, pair, text):
    (tmp_path / "truth.txt").write_text(text, encoding="utf-8")
    truth = image_truth.from_file(tmp_path / "truth.txt", *pair, tolerance=1)
    expected = GroundTruth.from_places(PLACES, 1, 5).matrix()
    np.testing.assert_array_equal(truth.matrix(), expected)


@pytest.mark.parametrize("separator", [",", ";", " ", "\t", " , "])
def test_from_file_reads_a_matrix_and_pairs(tmp_path, pair, separator):
    matrix = GroundTruth.from_places(PLACES, 1, 5).matrix()
    rows = [separator.join(map(str, row)) for row in matrix.astype(int)]
    (tmp_path / "matrix.csv").write_text("\n".join(rows))
    truth = image_truth.from_file(tmp_path / "matrix.csv", *pair)
    np.testing.assert_array_equal(truth.matrix(), matrix)
    pairs = [f"{q}{separator}{r}" for q, r in np.argwhere(matrix)]
    (tmp_path / "pairs.csv").write_text("\n".join([f"Query{separator}place", *pairs[::-1], *pairs]))
    truth = image_truth.from_file(tmp_path / "pairs.csv", *pair)
    np.testing.assert_array_equal(truth.matrix(), matrix)


@pytest.mark.filterwarnings("ignore:.*images of 2 folders are read as one route")
@pytest.mark.parametrize("header", ["query,reference", "Query_Name;Ref Name", "reference\tquery"])
def test_43_from_file_reads_pairs_of_file_names(tmp_path, header):
    reference = traverse(tmp_path / "r", ["a 1", "b", "sub/b", "0005"])  # sorted: 0005, a 1, …
    query = traverse(tmp_path / "q", ["x", "y"])
    separator = next(each for each in ",;\t" if each in header)
    rows = [("x.png", "a 1.png"), ("q/y.png", "sub/b.png"), ("y", "0005"), ("1", "2")]
    if header.startswith("reference"):
        rows = [(place, query) for query, place in rows]
    text = [separator.join(row) for row in rows]
    (tmp_path / "pairs.csv").write_text("\n".join(["# of mine", header, *text]))
    truth = image_truth.from_file(tmp_path / "pairs.csv", reference, query)
    numbers = {name: at for at, name in enumerate(reference.names)}
    expected = np.zeros((2, 4), bool)
    expected[0, numbers["a 1.png"]] = True
    expected[1, [numbers["sub/b.png"], numbers["0005.png"], 2]] = True
    np.testing.assert_array_equal(truth.matrix(), expected)


@pytest.mark.filterwarnings("ignore:.*images of 2 folders are read as one route")
@pytest.mark.parametrize(
    ("row", "sentence"),
    [
        ("x,b.jpg", r"line 2: 'b\.jpg' is no image's name and no whole number"),
        ("x,elsewhere/b.png", "'elsewhere/b.png' names several images; give the path"),
        ("z,b", "'z' is no image's name"),
        ("0,1,2", r"lines of \[3\] numbers or names, as line 2"),
    ],
)
def test_43_from_file_refuses_names_that_are_no_image_s(tmp_path, row, sentence):
    reference, query = traverse(tmp_path / "r", ["a/b", "c/b"]), traverse(tmp_path / "q", ["x"])
    (tmp_path / "pairs.csv").write_text(f"query,reference\n{row}\n")
    with pytest.raises(ValueError, match=sentence):
        image_truth.from_file(tmp_path / "pairs.csv", reference, query)


@pytest.mark.parametrize("form", ["pairs.csv", "matrix.npy", "matrix.csv"])
@pytest.mark.parametrize(("width", "tolerance"), [(0, 2), (2, 2), (1, 2), (2, 0), (0, 0)])
def test_42_a_tolerance_beside_a_list_holds_or_is_refused(tmp_path, form, width, tolerance):
    pair = numbered(tmp_path / "r", 30), numbered(tmp_path / "q", 9)
    centres = 3 * np.arange(9)
    listed = GroundTruth.from_places(centres, width, 30)
    match form:
        case "pairs.csv":
            rows = [f"{q},{r}" for q, r in np.argwhere(listed.matrix())]
            (tmp_path / form).write_text("\n".join(["query,place", *rows]))
        case "matrix.npy":
            np.save(tmp_path / form, listed.matrix())
        case _:
            np.savetxt(tmp_path / form, listed.matrix(), "%d", ",")
    if width not in (0, tolerance):
        with pytest.raises(
            ValueError, match=rf"tolerance is {tolerance}, but .* stand for {width}"
        ):
            image_truth.from_file(tmp_path / form, *pair, tolerance=tolerance)
        return
    truth = image_truth.from_file(tmp_path / form, *pair, tolerance=tolerance)
    expected = GroundTruth.from_places(centres, tolerance, 30)
    np.testing.assert_array_equal(truth.matrix(), expected.matrix())


def test_from_file_reads_numpy_files(tmp_path, pair):
    matrix = GroundTruth.from_places(PLACES, 1, 5).matrix()
    np.save(tmp_path / "matrix.npy", matrix)
    np.save(tmp_path / "places.npy", np.array(PLACES, np.int16))
    for truth in (
        image_truth.from_file(tmp_path / "matrix.npy", *pair),
        image_truth.from_file(str(tmp_path / "places.npy"), *pair, tolerance=1),
    ):
        np.testing.assert_array_equal(truth.matrix(), matrix)
    with pytest.raises(FileNotFoundError, match=r"nowhere\.npy does not exist"):
        image_truth.from_file(tmp_path / "nowhere.npy", *pair)


def test_from_file_does_not_cross_the_end_of_a_part(tmp_path):
    joined = ImageFolder.join([numbered(tmp_path / "a", 2), numbered(tmp_path / "b", 2)])
    (tmp_path / "truth.txt").write_text("1\n2\n-1\n0\n")
    truth = image_truth.from_file(tmp_path / "truth.txt", joined, joined, tolerance=1)
    expected = [[1, 1, 0, 0], [0, 0, 1, 1], [0, 0, 0, 0], [1, 1, 0, 0]]
    np.testing.assert_array_equal(truth.matrix(), np.array(expected, bool))


def test_with_copies_counts_each_copy_of_a_true_place(tmp_path):
    make_images(tmp_path, [f"{n}" for n in range(7)])
    for stem in ("2", "3"):
        (tmp_path / f"{stem}.png").write_bytes((tmp_path / "1.png").read_bytes())
    with pytest.warns(UserWarning, match="repeated in frames 1 to 3"):
        folder = ImageFolder(tmp_path)
    truth = image_truth.by_index(folder, folder, tolerance=1)
    with_copies = image_truth.with_copies(truth, folder).matrix()
    rows = [np.flatnonzero(row).tolist() for row in with_copies]
    run = [1, 2, 3]
    assert rows == [[0, *run], [0, *run], run, [*run, 4], [*run, 4, 5], [4, 5, 6], [5, 6]]
    plain = numbered(tmp_path / "plain", 3)
    same = image_truth.by_index(plain, plain, tolerance=1)
    np.testing.assert_array_equal(image_truth.with_copies(same, plain).matrix(), same.matrix())
    none = GroundTruth.from_places([-1, 1, -1], 0, 3)
    np.testing.assert_array_equal(image_truth.with_copies(none, plain).matrix(), none.matrix())


# ---- real recordings ----------------------------------------------------------------------


@needs_data
def test_corridor_and_its_ground_truth():
    root = Path(DATA or "")
    reference, query = (ImageFolder(root / "corridor" / side) for side in ("reference", "query"))
    assert len(reference) == len(query) == 111
    assert query[0].shape == (120, 160, 3)
    stored = np.load(root / "corridor" / "ground_truth.npy")
    plain = image_truth.from_file(root / "corridor" / "ground_truth.npy", reference, query)
    np.testing.assert_array_equal(plain.matrix(), stored)
    path = root / "vprbench_corridor" / "ground_truth_new.npy"
    pickled = image_truth.from_file(path, reference, query, trust=True)
    bank = from_vprbench(path.parent, ["HOG"], path, trust=True)
    np.testing.assert_array_equal(pickled.matrix(), bank.truth.matrix())


@needs_data
def test_part_of_nordland():
    root = Path(DATA or "") / "nordland"
    part = {"first": 200, "step": 2, "count": 500}
    summer, winter = (ImageFolder(root / season, **part) for season in ("summer", "winter"))
    assert summer.names == winter.names
    assert summer.names[0] == "images-02010.png"
    assert summer.names[-1] == "images-11990.png"
    by_name = image_truth.by_name(summer, winter, tolerance=1)
    by_index = image_truth.by_index(summer, winter, tolerance=1)
    np.testing.assert_array_equal(by_name.places, by_index.places)
    with pytest.warns(UserWarning, match="the same image is repeated in frames 0 to 16"):
        assert len(ImageFolder(root / "summer")) == 2000
