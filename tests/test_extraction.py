"""Image folders and techniques to a score bank, and to a map for live navigation."""

from __future__ import annotations

import copy
import importlib
import io
import os
import pickle
import re
import sys
import tracemalloc
import warnings

import numpy as np
import pytest
from extraction_cases import Raising, Tiny, TwoSided, make_images

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.extraction import BLOCK, Cache, DescribedMap, describe_map, extract
from amusic_gym.extraction import seconds as seconds_module
from amusic_gym.extraction.describe import ExtractionPlan, images_of
from amusic_gym.extraction.executors import make_executor
from amusic_gym.extraction.seconds import Cost, cost_of, measure_cost
from amusic_gym.extraction.shards import DescribeShard, MatchShard
from amusic_gym.routes.folders import ImageFolder
from amusic_gym.techniques import Technique

extract_module = importlib.import_module("amusic_gym.extraction.extract")
REFERENCES, QUERIES = BLOCK + 6, BLOCK + 1
FRAMES = np.arange(QUERIES)
SECONDS = {"Tiny": 0.5, "TwoSided": 0.25, "KnowsItsBlock": 0.125}
SECONDS_OF_ONE = {"Tiny": 0.5}


class KnowsItsBlock(Tiny):
    """Shows in its last bits how many references it matched at once, as a product may."""

    name = "KnowsItsBlock"

    def match(self, query, references):
        return super().match(query, references) * np.float32(1 + 1e-6 * len(references))


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    root = tmp_path_factory.mktemp("images")
    return make_images(root / "map", REFERENCES), make_images(root / "run", QUERIES, seed=1)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def extracted(folders, cache):
    techniques = [Tiny(), TwoSided(), KnowsItsBlock()]
    return extract(
        *folders,
        techniques,
        tolerance=1,
        ground_truth=FRAMES,
        seconds=SECONDS,
        cache=cache,
        name="both",
    )


def test_the_bank_holds_each_querys_scores(folders, extracted):
    places, frames = map(ImageFolder, folders)
    assert extracted.shape == (3, QUERIES, REFERENCES)
    assert extracted.techniques == ("Tiny", "TwoSided", "KnowsItsBlock")
    assert extracted.seconds.tolist() == [0.5, 0.25, 0.125]
    assert (extracted.name, extracted.source) == ("both", "images: run on map")
    for t, technique in enumerate((Tiny(), TwoSided(), KnowsItsBlock())):
        block = np.stack([technique.describe(image) for image in places])
        for q in (0, BLOCK - 1, BLOCK):
            expected = technique.match(technique.describe_query(frames[q]), block)
            np.testing.assert_allclose(extracted.row(t, q), expected, rtol=1e-4)


def test_without_ground_truth_a_query_is_at_the_place_of_its_number(extracted):
    assert np.array_equal(
        extracted.truth.matrix(),
        GroundTruth.from_places(np.arange(QUERIES), 1, REFERENCES).matrix(),
    )


def test_joined_folders_match_part_by_part(tmp_path):
    parts = [
        [ImageFolder(make_images(tmp_path / f"{side}{n}", 3 + n * (side == "map"), seed=n))]
        for side in ("map", "run")
        for n in (0, 1)
    ]
    places, frames = ImageFolder.join(parts[0] + parts[1]), ImageFolder.join(parts[2] + parts[3])
    options = {"tolerance": 1, "cache": tmp_path / "cache"}
    with pytest.raises(ValueError, match=r"3 \+ 3 images, .* 3 \+ 4: frame q cannot be at place q"):
        extract(places, frames, [Tiny()], **options)
    bank = extract(frames, frames, [Tiny()], **{**options, "tolerance": 0})
    assert bank.truth.places.tolist() == [0, 1, 2, 3, 4, 5]
    bank = extract(frames, frames, [Tiny()], **options)
    assert 3 not in bank.truth.places[bank.truth.indptr[2] : bank.truth.indptr[3]]


def test_ground_truth_of_ones_own(folders, cache):
    given = np.zeros((QUERIES, REFERENCES), np.bool_)
    given[:, 5] = True
    bank = extract(*folders, [Tiny()], ground_truth=given, seconds=SECONDS_OF_ONE, cache=cache)
    assert np.array_equal(bank.truth.matrix(), given)


def test_on_disk_it_is_the_same_bank(folders, extracted, cache, tmp_path):
    bank = extract(
        *folders,
        [Tiny(), TwoSided(), KnowsItsBlock()],
        tolerance=1,
        ground_truth=FRAMES,
        seconds=SECONDS,
        cache=cache,
        out=tmp_path / "bank",
        name="both",
    )
    assert bank.path == tmp_path / "bank"
    extracted.save(tmp_path / "memory")
    for name in ("scores.npy", "ground_truth.npz", "bank.json"):
        assert (tmp_path / "bank" / name).read_bytes() == (tmp_path / "memory" / name).read_bytes()
    assert ScoreBank.load(tmp_path / "bank", verify=True).name == "both"


def test_a_technique_may_be_given_by_name(folders, cache):
    bank = extract(
        *folders, ["extraction_cases:Tiny"], tolerance=1, ground_truth=FRAMES, cache=cache
    )
    assert bank.techniques == ("Tiny",)


def test_an_image_that_is_both_query_and_place_is_described_once(folders, tmp_path):
    log = tmp_path / "log"
    extract(
        folders[0], folders[0], [Tiny(log=log)], tolerance=0, seconds=SECONDS_OF_ONE, cache=tmp_path
    )
    assert len(log.read_text().split()) == REFERENCES


def test_descriptors_are_not_needed_where_scores_are_known(folders, tmp_path):
    log = tmp_path / "log"
    arguments = {"tolerance": 1, "seconds": SECONDS_OF_ONE, "cache": tmp_path / "cache"}
    arguments["ground_truth"] = FRAMES
    first = extract(*folders, [Tiny(log=log)], **arguments)
    sides = [images_of(ImageFolder(folder)) for folder in folders]
    plan = ExtractionPlan(Tiny(), *sides)
    for images in (*plan.references, *plan.queries):
        key = plan.descriptor_key(images, query=False)
        (tmp_path / "cache" / key[:2] / f"{key}.entry").unlink()
    log.unlink()
    again = extract(*folders, [Tiny(log=log)], **arguments)
    assert np.array_equal(first.scores, again.scores)
    assert not log.exists()


# ---- seconds ---------------------------------------------------------------------------------


class Clock:
    """Time that passes only by what is done."""

    now = 0.0

    def perf_counter(self):
        return self.now


class Timed(Tiny):
    """Takes 3 s to describe a query, more for dark images, and 0.5 s per reference."""

    def __init__(self, clock):
        super().__init__()
        self.clock = clock

    def describe_query(self, image):
        self.clock.now += 3 if image.any() else 300
        return np.ones(4, np.float32)

    def match(self, query, references):
        self.clock.now += 0.5 * len(references)
        return super().match(query, references)


def test_seconds_are_the_median_scaled_to_the_whole_map(monkeypatch):
    clock = Clock()
    monkeypatch.setattr(seconds_module, "time", clock)
    images = [np.full((2, 2, 3), value, np.uint8) for value in (0, 1, 2)]
    blocks = [np.ones((6, 4), np.float32), np.ones((2, 4), np.float32)]
    assert measure_cost(Timed(clock), images, blocks, references=100) == (3 + 0.5 * 100, 0.0)
    runs = 3 * len(images) + 1  # one to warm up
    assert clock.now == 300 * 4 + 3 * (runs - 4) + 0.5 * 8 * runs


@pytest.mark.parametrize(
    ("slower", "spread"),
    [
        ([], 0.0),
        ([(0, 1)], 0.0),  # one hiccup of 15 runs
        ([(1, image) for image in range(5)], 1.0),  # a round while something else runs
    ],
)
def test_a_measurement_tells_how_far_it_spreads(slower, spread):
    runs = np.tile([0.1, 0.1, 0.1, 0.1, 0.4], (3, 1))  # one image takes long: no spread
    for at in slower:
        runs[at] *= 2
    assert cost_of(runs) == (pytest.approx(0.1), pytest.approx(spread))


def test_an_unsteady_measurement_is_warned_of_each_time_and_told(monkeypatch, folders, tmp_path):
    unsteady = Cost(0.139, 0.8)
    monkeypatch.setattr(seconds_module, "measure_cost", lambda *_: unsteady)
    for _ in range(2):
        with pytest.warns(UserWarning, match=r"'Tiny' took 0.139 s per run \(±80%\); measure ag"):
            extracted = extract(
                *folders, [Tiny()], tolerance=1, ground_truth=FRAMES, cache=tmp_path / "cache"
            )
    assert extracted.seconds.tolist() == [0.139]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        Cost(0.139, 0.25).warn("Tiny")
        Cost(0.000139, 0.8).warn("Tiny")  # no cost turns on it
    assert str(Cost(0.139, 0.04)) == "0.139 s per run (±4%)"


def test_seconds_are_measured_once_per_machine(folders, tmp_path):
    log = tmp_path / "log"
    arguments = {"tolerance": 1, "ground_truth": FRAMES, "cache": tmp_path / "cache"}

    def measured(**options):
        log.unlink(missing_ok=True)
        bank = extract(*folders, [Tiny(log=log)], **arguments, **options)
        return bank.seconds[0], log.exists()

    first, _ = measured()
    assert 0 < first < 1
    assert measured() == (first, False)
    assert measured(measure_again=True)[1]
    assert measured(seconds={"Tiny": 2.0}) == (2.0, False)


# ---- bounds ----------------------------------------------------------------------------------


class Large(Tiny):
    """Descriptors of 64 KiB: 4 MiB a block, far more than its images."""

    name = "Large"
    size = 16 * 1024

    def describe(self, image):
        return np.resize(super().describe(image), self.size)


def test_memory_holds_some_blocks_and_never_the_map(tmp_path):
    blocks = 5
    folder = make_images(tmp_path / "map", BLOCK * blocks)
    block = Large.size * 4 * BLOCK
    extract(folder, folder, [Tiny()], tolerance=0, cache=tmp_path / "other")  # imports are done
    tracemalloc.start()
    try:
        extract(
            folder,
            folder,
            [Large()],
            tolerance=0,
            cache=tmp_path / "cache",
            out=tmp_path / "bank",
        )
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2.5 * block < blocks * block


# ---- the map for live navigation ---------------------------------------------------------------


@pytest.mark.parametrize("in_memory", [False, True])
@pytest.mark.parametrize("threads", [1, 3])
def test_live_scores_have_the_bits_of_the_bank(folders, cache, extracted, in_memory, threads):
    places, frames = map(ImageFolder, folders)
    for t, technique in enumerate((Tiny(), TwoSided(), KnowsItsBlock())):
        described = describe_map(
            places, technique, cache=cache, in_memory=in_memory, threads=threads
        )
        assert [len(block) for block in described] == [BLOCK, REFERENCES - BLOCK]
        assert described.references == REFERENCES
        for q, image in enumerate(frames):
            scores = described.scores(described.describe_query(image))
            assert scores.tobytes() == extracted.row(t, q).tobytes()
        described.close()


def test_a_map_copies_and_pickles_by_its_files(folders, cache, extracted):
    described = describe_map(ImageFolder(folders[0]), Tiny(), cache=cache)
    query = described.describe_query(ImageFolder(folders[1])[3])
    described.scores(query)
    assert copy.deepcopy(described) is described
    assert copy.copy(described) is described
    data = pickle.dumps(described)
    assert len(data) < 4000
    assert np.array_equal(pickle.loads(data).scores(query), extracted.row(0, 3))


def test_blocks_of_a_map_are_read_only(folders, cache):
    for described in (
        describe_map(ImageFolder(folders[0]), Tiny(), cache=cache),
        DescribedMap(Tiny(), [np.ones((2, 3), np.float32)]),
    ):
        with pytest.raises(ValueError, match="read-only"):
            described[0][0] = 0


def test_a_map_is_described_once(folders, tmp_path):
    log = tmp_path / "log"
    with Cache(tmp_path / "cache") as cache:
        for _ in range(2):
            describe_map(ImageFolder(folders[0]), Tiny(log=log), cache=cache)
    assert len(log.read_text().split()) == REFERENCES


# ---- refusals --------------------------------------------------------------------------------


class Wrong(Technique):
    """Gives what it is told."""

    name = "Wrong"

    def __init__(self, descriptor=None, scores=None):
        self.descriptor = np.ones(3, np.float32) if descriptor is None else descriptor
        self.scores = scores

    def describe(self, image):
        return self.descriptor(image) if callable(self.descriptor) else self.descriptor

    def match(self, query, references):
        return super().match(query, references) if self.scores is None else self.scores


@pytest.mark.parametrize(
    ("technique", "message"),
    [
        (Wrong(np.array([1, np.nan])), "0000.png: technique 'Wrong' gives a descriptor with NaN"),
        (Wrong(np.array(["text"])), "a descriptor of dtype <U4"),
        (Wrong(np.zeros(0)), r"a descriptor of dtype float64 and shape \(0,\)"),
        (Wrong(scores=np.ones(3)), r"scores of shape \(3,\) for 64 references"),
        (Wrong(scores=np.full(BLOCK, 1e300)), "gives scores with NaN or infinity"),
        (Wrong(lambda image: np.ones(int(image[0, 0, 0]))), "all must have one shape"),
    ],
)
def test_what_a_technique_must_not_give(folders, tmp_path, technique, message):
    with pytest.raises(ValueError, match=message):
        extract(*folders, [technique], tolerance=1, ground_truth=FRAMES, cache=tmp_path)


def test_blocks_of_different_shape_are_refused(folders, tmp_path):
    shapes = iter([2] * BLOCK + [3] * 1000)
    technique = Wrong(lambda image: np.ones(next(shapes)))
    with pytest.raises(ValueError, match=r"describes .*0064.png by shape \(3,\).* \(2,\)"):
        describe_map(ImageFolder(folders[0]), technique, cache=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"techniques": []}, "no technique; give at least one"),
        ({"techniques": ["hogg"]}, "unknown technique 'hogg': did you mean 'hog'"),
        ({"techniques": [Tiny(), Tiny()]}, "'Tiny' is named twice"),
        ({"tolerance": None}, "tolerance is missing"),
        ({"tolerance": -1}, "tolerance is -1"),
        ({"ground_truth": np.zeros(3, int)}, r"ground truth has shape \(3,\)"),
        ({"seconds": {"Tyni": 1}}, "seconds: unknown technique 'Tyni': did you mean 'Tiny'"),
        ({"seconds": {"Tiny": 0}}, "seconds of technique 'Tiny' are 0"),
        ({"executor": "threads"}, "unknown executor 'threads'"),
        ({"query": "nowhere"}, "nowhere does not exist"),
        ({"out": os.curdir}, "holds other files"),
    ],
)
def test_bad_arguments_are_refused_before_any_work(folders, tmp_path, arguments, message):
    given = {"reference": folders[0], "query": folders[1], "techniques": [Tiny()], "tolerance": 1}
    given["ground_truth"] = FRAMES
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        extract(**{**given, **arguments}, cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


@pytest.mark.parametrize("damage", [b"", b"garbage", None], ids=["empty", "garbage", "cut"])
def test_a_broken_image_is_refused_before_any_work(tmp_path, damage):
    folder = make_images(tmp_path / "map", 3)
    last = folder / "0002.png"
    last.write_bytes(last.read_bytes()[:-20] if damage is None else damage)
    with pytest.raises(ValueError, match=r"0002\.png"):
        extract(folder, folder, [Tiny()], tolerance=1, cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()


def test_an_image_that_changes_in_between_is_noticed(tmp_path):
    folder = make_images(tmp_path / "map", 2)
    other = make_images(tmp_path / "other", 1, seed=5)

    class Changes(Tiny):
        def describe(self, image):
            (folder / "0001.png").write_bytes((other / "0000.png").read_bytes())
            return super().describe(image)

    with pytest.raises(ValueError, match=r"0001\.png was changed since this run began"):
        extract(folder, folder, [Changes()], tolerance=1, cache=tmp_path / "cache")


def test_progress_is_a_line_per_technique_where_there_is_no_terminal(folders, cache, capsys):
    extract(
        *folders,
        [Tiny()],
        tolerance=1,
        ground_truth=FRAMES,
        seconds=SECONDS_OF_ONE,
        cache=cache,
        progress=True,
    )
    out, err = capsys.readouterr()
    assert out.startswith(f"Tiny: {QUERIES} queries × {REFERENCES} places in ")
    assert out.count("\n") == 1
    assert not err


def test_progress_is_a_bar_with_rate_and_time_left_on_a_terminal(folders, tmp_path, monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    extract(
        *folders,
        [Tiny()],
        tolerance=1,
        ground_truth=FRAMES,
        seconds=SECONDS_OF_ONE,
        cache=tmp_path,
        progress=True,
    )
    shown = terminal.getvalue()
    for title, total, unit in (
        ("map", REFERENCES, "images"),
        ("queries", QUERIES, "images"),
        ("matching", REFERENCES * QUERIES, "pairs"),
    ):
        assert re.search(rf"Tiny: {title}: .*0/{total} \[00:00<\?, \? {unit}/s\]", shown)
    assert shown.split("\r")[-1].strip() == ""  # the last bar is gone


# ---- what a technique of one's own raises --------------------------------------------------------


@pytest.fixture(scope="module")
def two_images(tmp_path_factory):
    return make_images(tmp_path_factory.mktemp("two") / "images", 2)


def raised(two_images, cache, error, at, executor="serial"):
    with pytest.raises(ValueError, match="technique 'Raising'") as caught:
        extract(
            two_images, two_images, Raising(error, at), tolerance=0, cache=cache, executor=executor
        )
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("error", "told"),
    [
        (RuntimeError("boom"), "RuntimeError: boom"),
        (KeyError("depth"), "KeyError: 'depth'"),
        (NotImplementedError(), "NotImplementedError"),
        (ValueError("two\nlines"), "ValueError: two lines"),
        (FileNotFoundError(2, "nothing"), "FileNotFoundError: [Errno 2] nothing"),
        (SystemExit(3), "SystemExit: 3"),
    ],
)
@pytest.mark.parametrize("at", ["describe", "describe_query", "match"])
def test_what_a_technique_raises_is_one_sentence_with_its_cause(
    two_images, tmp_path, error, told, at
):
    refusal = raised(two_images, tmp_path, error, at)
    assert str(two_images / "0000.png") in str(refusal)
    assert re.search(rf": {re.escape(told)} \(extraction_cases\.py:\d+\)$", str(refusal))
    assert refusal.__cause__ is error


def test_in_another_process_it_is_the_same_sentence(two_images, tmp_path):
    given = RuntimeError("boom"), "match"
    here = raised(two_images, tmp_path / "a", *given)
    there = raised(two_images, tmp_path / "b", *given, executor="process:1")
    assert str(here) == str(there)


def test_what_parameters_raises_is_one_sentence(two_images, tmp_path):
    refusal = raised(two_images, tmp_path, KeyError("size"), "parameters")
    assert "'Raising', parameters(): KeyError: 'size' (extraction_cases.py:" in str(refusal)


def test_ctrl_c_in_a_technique_passes(two_images, tmp_path):
    with pytest.raises(KeyboardInterrupt):
        describe_map(two_images, Raising(KeyboardInterrupt(), "describe"), cache=tmp_path)


@pytest.mark.parametrize(
    ("wrong", "at", "told"),
    [
        (lambda found: 0.5, "describe", "gives a single number as a descriptor"),
        (lambda found: np.float32(3), "describe", "gives a single number as a descriptor"),
        (
            lambda found: [[1, 2], [3]],
            "describe",
            "gives something else than a descriptor: ValueError",
        ),
        (lambda found: "text", "describe", "gives a descriptor of dtype"),
        (lambda found: found * np.nan, "match", "gives scores with NaN"),
        (lambda found: found * np.nan, "describe_query", "gives a descriptor with NaN"),
        (lambda found: found[:0], "match", "gives scores of dtype float32 and shape (0,)"),
        (lambda found: found[:5], "describe_query", "query of shape (5,) with references of shape"),
    ],
)
def test_what_is_no_descriptor_or_score_is_refused_with_the_image(
    two_images, tmp_path, wrong, at, told
):
    refusal = str(raised(two_images, tmp_path, wrong, at))
    assert told in refusal
    assert str(two_images / "0000.png") in refusal


def test_one_technique_may_be_given_without_a_list(two_images, tmp_path):
    for one in ("extraction_cases:Tiny", Tiny()):
        bank = extract(str(two_images), two_images, one, tolerance=0, cache=tmp_path)
        assert bank.techniques == ("Tiny",)


def test_a_map_may_be_described_by_names(two_images, tmp_path):
    described = describe_map(str(two_images), "extraction_cases:Tiny", cache=tmp_path)
    assert (described.references, described.technique.name) == (2, "Tiny")


def test_in_this_process_work_is_told_image_by_image(two_images, tmp_path):
    images = images_of(ImageFolder(two_images))
    plan, told = ExtractionPlan(Tiny(), images, images), []
    workers = make_executor("serial").workers(plan.technique)
    ((_, found),) = workers.run([DescribeShard("key", images, query=False)], told.append)
    assert told == [1, 1]
    list(workers.run([MatchShard("key", found, found, images.paths)], told.append))
    assert told == [1, 1, 2, 2]


def test_an_unwritable_out_is_refused_before_any_work(two_images, tmp_path, monkeypatch):
    def refuse(dir):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(extract_module.tempfile, "TemporaryFile", refuse)
    technique = Tiny(log=tmp_path / "log")
    with pytest.raises(PermissionError, match="bank cannot be written, nothing can be in .*denied"):
        extract(
            two_images, two_images, technique, tolerance=0, cache=tmp_path, out=tmp_path / "bank"
        )
    assert not technique.log.exists()
