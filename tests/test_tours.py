"""Tours: several image routes joined into one drive, and `bank.py tour`."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import cv2
import numpy as np
import pytest
from extraction_cases import Tiny, make_images
from hypothesis import given
from hypothesis import strategies as st

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.extraction import BLOCK, describe_map, extract
from amusic_gym.extraction.describe import ExtractionPlan, images_of
from amusic_gym.routes import folders as folders_module
from amusic_gym.routes.conditions import CONDITIONS, Change, Condition
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.routes.images import read_image
from amusic_gym.routes.retime import retime
from amusic_gym.routes.tours import LONGEST, SHORTEST, _spells, make_tour, spells_in, write_tour

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"
COUNTS = (70, 45, 60)  # images of the parts: spells go across their ends, and blocks of images too


@pytest.fixture(scope="module")
def parts(tmp_path_factory) -> list[tuple[Path, Path]]:
    """Three parts, the second with images of another size."""
    root = tmp_path_factory.mktemp("parts")
    made = []
    for number, count in enumerate(COUNTS):
        size = (24, 30) if number == 1 else (20, 32)
        here = make_images(root / f"here{number}", count, seed=number, size=size)
        there = make_images(root / f"there{number}", count, seed=10 + number, size=size)
        made.append((here, there))
    return made


@pytest.fixture(scope="module")
def tour(parts):
    return make_tour(parts, ["plain", "night", "blur:0.5", "fog+rain:0.3"], seed=4)


# ---- the tour ----------------------------------------------------------------------------


def test_the_map_is_all_references_and_the_run_all_queries(parts, tour):
    for at, folder in ((0, tour.reference), (1, tour.query)):
        paths = [path for part in parts for path in sorted(part[at].iterdir())]
        assert list(folder.paths) == paths
        assert folder.parts == COUNTS
    assert not tour.reference.changes
    assert tour.names == tuple(f"there{n} on here{n}" for n in range(3))


def test_truth_is_by_index_in_each_part_and_does_not_cross_its_end(tour):
    matrix = tour.ground_truth(2).matrix()
    ends = np.cumsum((0, *COUNTS))
    expected = np.zeros_like(matrix)
    for begin, end in zip(ends[:-1], ends[1:], strict=True):
        for q in range(begin, end):
            expected[q, max(begin, q - 2) : min(end, q + 3)] = True
    assert np.array_equal(matrix, expected)


def test_each_image_is_under_the_condition_of_its_spell(tour):
    firsts = [spell.first for spell in tour.spells]
    conditions = [Condition.parse(text) for text in ("plain", "night", "blur:0.5", "fog+rain:0.3")]
    assert firsts[0] == 0
    assert {spell.condition for spell in tour.spells} <= set(conditions)
    for q in range(len(tour.query)):
        spell = tour.spells[np.searchsorted(firsts, q, side="right") - 1]
        plain = read_image(tour.query.paths[q])
        expected = spell.condition.apply(plain, seed=4, frame=q)
        assert np.array_equal(tour.query[q], expected)
        assert np.array_equal(plain, expected) == (spell.condition == Condition())
    assert all(
        np.array_equal(one, tour.query[q]) for q, one in zip(range(5), tour.query, strict=False)
    )


@given(st.integers(1, 1000), st.integers(1, 7), st.integers(0, 2**40))
def test_spells_are_as_long_as_they_should_be_and_never_the_same_twice_running(frames, kinds, seed):
    conditions = [Condition(((name, 0.5),)) for name in list(CONDITIONS)[:kinds]]
    spells = _spells(frames, conditions, np.random.default_rng(seed))
    firsts = np.array([spell.first for spell in spells])
    assert firsts[0] == 0
    assert np.isin(np.diff(firsts), range(SHORTEST, LONGEST + 1)).all()
    assert 1 <= frames - firsts[-1] <= LONGEST
    order = [spell.condition for spell in spells]
    assert len(set(order[:kinds])) == min(kinds, len(order))
    assert kinds == 1 or all(a != b for a, b in zip(order, order[1:], strict=False))


def test_a_seed_is_a_tour_and_another_one_another(parts, tour):
    again = make_tour(parts, ["plain", "night", "blur:0.5", "fog+rain:0.3"], seed=4)
    assert again == tour
    assert pickle.loads(pickle.dumps(tour)) == tour
    others = [make_tour(parts, seed=seed) for seed in range(5)]
    assert len({each.spells for each in others}) == 5
    assert {s.condition for each in others for s in each.spells} == {
        Condition.parse(name) for name in CONDITIONS
    }


def test_nothing_is_read_before_it_is_asked_for(parts, monkeypatch):
    read = []
    monkeypatch.setattr(folders_module, "read_image", lambda path: read.append(path) or PICTURE)
    made = make_tour(parts, ["night"])
    assert not read
    made.query[100]
    assert read == [made.query.paths[100]]


PICTURE = np.full((4, 5, 3), 200, np.uint8)


def test_folders_that_are_open_and_conditions_that_are_made_will_do(parts):
    reference, query = (ImageFolder(folder, first=3, step=2, count=20) for folder in parts[0])
    made = make_tour([(reference, query), parts[1]], [Condition.parse("fog:1")], seed=1)
    assert made.query.parts == (20, COUNTS[1])
    assert made.query.paths[0].name == "0003.png"
    twice = make_tour(parts[:1], ["night", "night:0.7"], seed=1)
    assert {str(spell.condition) for spell in twice.spells} == {"night:0.7"}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"parts": []}, "a tour has no part; give at least one reference and query"),
        ({"conditions": []}, "no condition; give some of plain, night"),
        ({"conditions": ["nigt"]}, "did you mean 'night'"),
        ({"conditions": "night"}, r"conditions is the text 'night'; give a list, as \['night'\]"),
        ({"seed": -1}, "seed is -1; give a whole number >= 0"),
        ({"seed": 1.0}, "seed is 1.0"),
    ],
)
def test_what_makes_no_tour_is_refused(parts, change, sentence):
    given = {"parts": parts, "conditions": ["night"], "seed": 0, **change}
    with pytest.raises(ValueError, match=sentence):
        make_tour(given["parts"], given["conditions"], seed=given["seed"])


def test_parts_of_two_lengths_are_refused(parts, tmp_path):
    with pytest.raises(ValueError, match=r"part 2 of the tour has 45 images in .*here1 and 60 in "):
        make_tour([parts[0], (parts[1][0], parts[2][1])])
    with pytest.raises(FileNotFoundError, match="nowhere does not exist"):
        make_tour([(parts[0][0], tmp_path / "nowhere")])


# ---- folders under changes ---------------------------------------------------------------


def test_changes_of_a_folder_are_joined_and_counted(parts):
    folder = ImageFolder(parts[1][0])
    change = Change(Condition.parse("fog"), 1, 2)
    foggy = folder.under([change, *[None] * 44])
    assert folder.under([None] * 45) == folder != foggy
    assert not np.array_equal(foggy[0], folder[0])
    assert np.array_equal(foggy[1], folder[1])
    joined = ImageFolder.join([folder, foggy])
    assert [at for at, each in enumerate(joined.changes) if each] == [45]
    assert ImageFolder.join([folder, folder]).changes == ()
    with pytest.raises(ValueError, match="1 changes for 45 images; give one for each"):
        folder.under([change])


# ---- scores ------------------------------------------------------------------------------


def test_the_cache_tells_conditions_strengths_seeds_and_frames_apart(parts):
    folder = ImageFolder(parts[0][0])
    keys = set()
    for text, seed, frame in (
        *(("night", 0, 0), ("night:0.6", 0, 0), ("night", 1, 0), ("night", 0, 1)),
        *(("fog", 0, 0), ("night+fog", 0, 0), ("fog+night", 0, 0)),
    ):
        change = Change(Condition.parse(text), seed, frame)
        images = images_of(folder.under([change] * len(folder)))
        plan = ExtractionPlan(Tiny(), images, images)
        keys |= {plan.descriptor_key(block, query=True) for block in plan.queries}
        keys.add(plan.score_key(plan.queries[0], images_of(folder)))
    assert len(keys) == 7 * 3  # two blocks, and scores
    plain = images_of(folder)
    assert plain.keys == plain.digests  # as ever: what was cached before is found


@pytest.fixture(scope="module")
def bank(tour, tmp_path_factory) -> ScoreBank:
    return extract(
        tour.reference,
        tour.query,
        "hog",
        tolerance=2,
        cache=tmp_path_factory.mktemp("cache"),
        source=tour.source,
    )


def test_scores_are_those_of_the_written_folders(tour, bank, tmp_path):
    done = []
    assert write_tour(tour, tmp_path / "images", done.append) == (tmp_path / "images").resolve()
    assert sum(done) == 2 * sum(COUNTS)
    written = extract(
        tmp_path / "images" / "reference",
        tmp_path / "images" / "query",
        "hog",
        tolerance=2,
        cache=tmp_path / "cache",
    )
    assert np.array_equal(written.scores, bank.scores)
    assert sum(COUNTS) > BLOCK
    spells = json.loads((tmp_path / "images" / "segments.json").read_text())
    assert [(first, Condition.parse(text)) for first, text in spells] == [
        (spell.first, spell.condition) for spell in tour.spells
    ]


def test_one_technique_is_described_anew_only_where_the_tour_is_another(parts, tour, tmp_path):
    log = tmp_path / "log"

    def described(made) -> int:
        log.write_text("")
        options = {"tolerance": 1, "cache": tmp_path / "cache", "seconds": {"Tiny": 1.0}}
        extract(made.reference, made.query, Tiny(log=log), **options)
        return len(log.read_text().split())

    one = make_tour([parts[0], parts[2]], ["night"], seed=1)  # images of one size
    assert described(one) == 2 * 130
    assert described(one) == 0
    assert described(make_tour([parts[0], parts[2]], ["night"], seed=2)) == 130
    assert described(make_tour([parts[0], parts[2]], ["night:0.5"], seed=1)) == 130


def test_processes_see_the_same_images(tour, bank, tmp_path):
    options = {"tolerance": 2, "cache": tmp_path / "cache", "executor": "process:2"}
    made = extract(tour.reference, tour.query, "hog", seconds={"HOG": 1.0}, **options)
    assert np.array_equal(made.scores, bank.scores)


def test_a_tour_is_driven_live_with_the_scores_of_its_bank(tour, bank, tmp_path):
    maps = [describe_map(tour.reference, "hog", cache=tmp_path / "cache")]
    for frame in (0, 63, 174):
        seen = maps[0].describe_query(tour.query[frame])
        assert np.array_equal(maps[0].scores(seen), bank.scores[0, frame])


def test_truth_of_an_extracted_tour_goes_part_by_part(tour, bank):
    assert np.array_equal(bank.truth.matrix(), tour.ground_truth(2).matrix())


def test_a_bank_tells_its_spells_re_timed_or_not(tour, bank, tmp_path):
    assert spells_in(bank.source) == tour.spells
    assert spells_in(ScoreBank.load(bank.save(tmp_path / "bank")).source) == tour.spells
    assert spells_in(retime(bank, 1).source) == tour.spells
    assert bank.source.startswith("tour: there0 on here0, there1 on here1, there2 on here2; seed 4")
    with pytest.raises(ValueError, match="source 'simulated' is not that of a tour"):
        spells_in("simulated")


def test_images_are_written_whole_or_not_at_all_and_replace_a_tour_only(parts, tour, tmp_path):
    short = make_tour(parts[1:2], ["fog"])
    out = write_tour(short, tmp_path / "out")
    assert sorted(path.name for path in out.iterdir()) == ["query", "reference", "segments.json"]
    assert write_tour(make_tour(parts[2:], ["night"]), out) == out
    assert len(list((out / "query").iterdir())) == COUNTS[2]
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "thesis.txt").write_text("mine")
    with pytest.raises(ValueError, match="mine exists and holds other files"):
        write_tour(short, tmp_path / "mine")
    broken = make_images(tmp_path / "broken", COUNTS[1])
    (broken / "0003.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"0003.png"):
        write_tour(make_tour([(parts[1][0], broken)]), tmp_path / "new")
    assert not (tmp_path / "new").exists()


# ---- bank.py tour ------------------------------------------------------------------------


@pytest.fixture
def run(monkeypatch, amusic, tmp_path):
    """`bank.py tour` in a folder of its own: exit status, stdout and stderr."""
    monkeypatch.syspath_prepend(str(SCRIPTS))
    monkeypatch.chdir(tmp_path)
    for name, seed in (("a", 0), ("b", 1), ("c", 2), ("d", 3)):
        make_images(Path(name), 30, seed=seed)
    make_images(Path("e"), 29)
    return lambda words: amusic("bank", "tour", *words.split())


TWO = "--part a:b c:d --techniques extraction_cases:Tiny --cache cache"


def test_the_command_makes_the_bank_of_the_tour(run, tmp_path):
    options = "--conditions night,blur:0.5 --seed 3 --tolerance 2 --seconds Tiny=0.5 --name ride"
    code, out, err = run(f"{TWO} {options} --out bank --images images")
    assert (code, err) == (0, "")
    made = make_tour([("a", "b"), ("c", "d")], ["night", "blur:0.5"], seed=3)
    lines = out.splitlines()
    assert lines[-len(made.spells) - 1] == (
        f"{tmp_path.resolve() / 'bank'}: 1 techniques, 60 queries, 60 references"
    )
    expected = [f"from frame {spell.first}: {spell.condition}" for spell in made.spells]
    assert lines[-len(made.spells) :] == expected
    written = ScoreBank.load("bank", verify=True)
    assert (written.name, written.tolerance, written.source) == ("ride", 2, made.source)
    assert written.seconds.tolist() == [0.5]
    assert np.array_equal(written.truth.matrix(), made.ground_truth(2).matrix())
    seen = cv2.imread("images/query/0059.png")
    assert np.array_equal(seen, made.query[59])
    scores = written.scores[0]
    described = Tiny().describe(seen) @ Tiny().describe(made.reference[7])
    assert scores[59, 7] == pytest.approx(described, rel=1e-5)


def test_all_conditions_are_drawn_from_unless_some_are_named(run):
    assert run(f"{TWO} --tolerance 1 --seconds Tiny=1 --out bank")[0] == 0
    assert ScoreBank.load("bank").source == make_tour([("a", "b"), ("c", "d")]).source
    assert ScoreBank.load("bank").name == "bank"


def test_a_part_is_cut_as_a_list_is(run):
    options = "--techniques extraction_cases:Tiny --cache cache --tolerance 1 --seconds Tiny=1"
    assert run(f"--part a:b@3:20:2 c:d@0:5:1 {options} --out bank")[0] == 0
    cuts = [{"first": 3, "step": 2, "count": 9}, {"count": 5}]
    folders = [
        tuple(ImageFolder(name, **cut) for name in part)
        for part, cut in zip((("a", "b"), ("c", "d")), cuts, strict=True)
    ]
    made = make_tour(folders)
    written = ScoreBank.load("bank")
    assert written.source == made.source
    assert np.array_equal(written.truth.matrix(), made.ground_truth(1).matrix())


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (f"{TWO} --out new", "required: --tolerance"),
        ("--tolerance 1 --techniques hog --out new", "required: --part"),
        (f"{TWO} --tolerance -1 --out new", "tolerance is -1"),
        (f"{TWO} --tolerance 1 --conditions nigth --out new", "did you mean 'night'?"),
        (f"{TWO} --tolerance 1 --conditions night:2 --out new", "strength is '2'"),
        (f"{TWO} --tolerance 1 --conditions night,,fog --out new", "unknown condition ''"),
        (f"{TWO} --tolerance 1 --seed -1 --out new", "seed is -1"),
        (
            f"{TWO} --part a --tolerance 1 --out new",
            "--part 'a' is not of the form REFERENCE:QUERY",
        ),
        (f"{TWO} --part a:b:c --tolerance 1 --out new", "with one colon between them"),
        (f"{TWO} --part a:b@1:5 --tolerance 1 --out new", "or REFERENCE:QUERY@FIRST:STOP:STEP"),
        (f"{TWO} --part a:b@5:5:1 --tolerance 1 --out new", "takes no image"),
        (f"{TWO} --part a:b@0:99:1 --tolerance 1 --out new", "a holds 30 images, but first=0"),
        (f"{TWO} --part a:nowhere --tolerance 1 --out new", "nowhere does not exist"),
        (
            f"{TWO} --part a:e --tolerance 1 --out new",
            "part 3 of the tour has 30 images in a and 29",
        ),
        (f"{TWO} --tolerance 1 --out a", "a exists and holds other files"),
        (f"{TWO} --tolerance 1 --out new --images a", "a exists and holds other files"),
        (
            f"{TWO} --tolerance 1 --seconds HOG=1 --out new --images images",
            "unknown technique 'HOG'",
        ),
        (f"{TWO},nope --tolerance 1 --out new", "nope"),
        (f"{TWO} --tolerance 1 --out new --parts a:b", "did you mean '--part'?"),
    ],
)
def test_what_cannot_be_done_is_one_line_and_changes_nothing(run, tmp_path, words, sentence):
    words = words.replace(" --cache cache,nope", ",nope --cache cache")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    code, out, err = run(words)
    assert (code, out) == (2, "")
    assert sentence in err, err
    assert len(err.splitlines()) == 1
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
