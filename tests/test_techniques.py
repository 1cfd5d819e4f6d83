"""What every technique must do, those that ship and one of your own; and how they are named.

The contract reads only the protocol: adding a technique to the registry adds it here.
"""

from __future__ import annotations

import hashlib
import json
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import technique_files
from weight_cases import image

from amusic_gym import techniques
from amusic_gym.techniques import Technique, make_technique, register

pytestmark = pytest.mark.slow

FOLDER = Path(__file__).resolve().parent
SHIPPED = ("hog", "cohog", "calc", "netvlad", "gist", "gist-lear", "effnet", "effnet-rmac")
OWN = "test_techniques:ColourGrid"
SIZES = [(60, 80), (200, 90), (1, 1), (2, 300), (480, 640)]


class ColourGrid(Technique):
    """As simple as a technique of one's own can be: mean colours of a 4×4 grid, cosine."""

    name = "ColourGrid"

    def describe(self, image):
        rows = np.array_split(np.arange(image.shape[0]), 4)
        columns = np.array_split(np.arange(image.shape[1]), 4)
        found = np.zeros((4, 4, 3), np.float32)
        for i, j in np.ndindex(4, 4):
            part = image[np.ix_(rows[i], columns[j])].reshape(-1, 3)
            found[i, j] = part.mean(axis=0) if len(part) else 0
        return found / max(float(np.linalg.norm(found)), 1e-9)


class Weighed(Technique):
    """Takes weights."""

    def __init__(self, weights="none"):
        self.name = f"weighed by {weights}"


class Nameless(Technique):
    """Forgot its name."""


@pytest.fixture(scope="module", params=[*SHIPPED, *technique_files.MADE, OWN])
def technique(request, tmp_path_factory):
    if request.param not in technique_files.MADE:
        return make_technique(request.param)
    return make_technique(*technique_files.MADE[request.param](tmp_path_factory.mktemp("files")))


@pytest.fixture(scope="module")
def pictures():
    return [image(seed) for seed in range(4)]


@pytest.fixture
def registry(monkeypatch):
    """A copy of the registry that may be written to."""
    monkeypatch.setattr(techniques, "TECHNIQUES", dict(techniques.TECHNIQUES))
    return techniques.TECHNIQUES


def digest(array):
    return hashlib.sha256(repr((array.shape, array.dtype)).encode() + array.tobytes()).hexdigest()


def fingerprint(technique, picture):
    """Digests of all that a technique gives for one image."""
    place, query = technique.describe(picture), technique.describe_query(picture)
    scores = technique.match(query, np.stack([place, place]))
    return [digest(np.asarray(each)) for each in (place, query, scores)]


# --- the contract --------------------------------------------------------------------------------


def test_the_contract_covers_all_that_are_registered():
    """All but ``hub``, which is held to it by tests of its own, as its code needs trust."""
    assert set(techniques.TECHNIQUES) == {*SHIPPED, *technique_files.MADE, "hub"}


def test_it_has_a_name_for_tables(technique):
    assert technique.name
    assert technique.name.strip() == technique.name


@pytest.mark.parametrize("side", ["describe", "describe_query"])
def test_descriptors_of_images_of_any_size_are_alike(technique, side):
    describe = getattr(technique, side)
    found = [describe(image(i, 480, 640)[:h, :w]) for i, (h, w) in enumerate(SIZES)]
    assert {each.dtype for each in found} == {np.dtype(np.float32)}
    assert len({each.shape for each in found}) == 1
    assert all(np.isfinite(each).all() for each in found)


def test_match_gives_one_finite_score_per_reference(technique, pictures):
    query = technique.describe_query(pictures[0])
    references = np.stack([technique.describe(each) for each in pictures])
    for count in (1, 2, len(pictures)):
        scores = technique.match(query, references[:count])
        assert scores.dtype == np.float32
        assert scores.shape == (count,)
        assert np.isfinite(scores).all()


def test_an_image_is_most_similar_to_itself(technique, pictures):
    references = np.stack([technique.describe(each) for each in pictures])
    scores = [technique.match(technique.describe_query(each), references) for each in pictures]
    np.testing.assert_array_equal(np.argmax(scores, axis=1), range(len(pictures)))


def test_a_score_hardly_depends_on_the_other_references(technique, pictures):
    query = technique.describe_query(pictures[0])
    references = np.stack([technique.describe(each) for each in pictures])
    together = technique.match(query, references)
    alone = [technique.match(query, references[i : i + 1])[0] for i in range(len(references))]
    np.testing.assert_allclose(together, alone, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("grey", [0, 1, 128, 255])
def test_an_image_of_one_grey_value_works(technique, pictures, grey):
    flat = np.full((50, 70, 3), grey, np.uint8)
    references = np.stack([technique.describe(each) for each in (flat, pictures[0])])
    for each in (flat, pictures[1]):
        query = technique.describe_query(each)
        assert np.isfinite(query).all()
        assert np.isfinite(technique.match(query, references)).all()
    assert np.isfinite(references).all()


def test_the_same_image_gives_the_same_bits_in_any_order(technique, pictures):
    first = [fingerprint(technique, each) for each in pictures]
    again = [fingerprint(technique, each) for each in reversed(pictures)]
    assert first == again[::-1]


def test_it_pickles(technique, pictures):
    copy = pickle.loads(pickle.dumps(technique))
    assert copy.name == technique.name
    assert copy.parameters() == technique.parameters()
    assert fingerprint(copy, pictures[0]) == fingerprint(technique, pictures[0])


def test_parameters_are_plain_values(technique):
    parameters = dict(technique.parameters())
    assert json.loads(json.dumps(parameters)) == parameters
    assert all(isinstance(value, str | int | float | bool) for value in parameters.values())


def test_an_image_is_only_read(technique):
    picture = image(5)
    before = picture.copy()
    picture.flags.writeable = False
    expected = fingerprint(technique, picture)
    np.testing.assert_array_equal(picture, before)
    cut = np.pad(picture, ((3, 3), (4, 4), (0, 0)))[3:-3, 4:-4]  # not contiguous
    assert fingerprint(technique, cut) == expected


def test_descriptors_are_the_callers(technique, pictures):
    place, query = technique.describe(pictures[0]), technique.describe_query(pictures[0])
    before = digest(place), digest(query)
    scores = technique.match(query, place[np.newaxis])
    assert (digest(place), digest(query)) == before
    for each in (place, query, scores):
        each[...] = 7
    assert digest(technique.describe(pictures[0])) == before[0]
    assert digest(technique.describe_query(pictures[0])) == before[1]


def test_all_give_the_same_bits_in_another_process():
    code = (
        "import json, sys\n"
        "from test_techniques import OWN, SHIPPED, fingerprint, image, make_technique\n"
        "prints = {n: fingerprint(make_technique(n), image(0)) for n in (*SHIPPED, OWN)}\n"
        "print(json.dumps(prints))\n"
    )
    paths = [str(folder) for folder in (FOLDER.parent, FOLDER, FOLDER / "support")]
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
        capture_output=True,
        text=True,
        timeout=300,
        check=True,
    )
    expected = {name: fingerprint(make_technique(name), image(0)) for name in (*SHIPPED, OWN)}
    assert json.loads(done.stdout) == expected


@pytest.mark.parametrize("name", SHIPPED)
@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros((20, 20), np.uint8),
        np.zeros((20, 20, 4), np.uint8),
        np.zeros((20, 20, 3), np.float32),
        np.zeros((0, 20, 3), np.uint8),
    ],
    ids=["grey", "alpha", "float", "empty"],
)
def test_what_is_no_image_is_refused(name, wrong):
    made = make_technique(name)
    for describe in (made.describe, made.describe_query):
        with pytest.raises(ValueError, match=r"the image has shape .* give \(height, width, 3\)"):
            describe(wrong)


# --- names ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("name", "expected"), [("HOG", "HOG"), ("hog", "HOG"), ("cOhOg", "CoHOG")])
def test_a_technique_is_found_by_name_in_any_case(name, expected):
    assert make_technique(name).name == expected


def test_a_technique_is_found_by_its_class():
    assert type(make_technique("amusic_gym.techniques.hog:HOG")) is type(make_technique("hog"))
    assert type(make_technique(OWN)).__name__ == "ColourGrid"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("HGO", "unknown technique 'HGO': did you mean 'hog'[?] valid: hog, cohog, calc, netvlad"),
        ("", "unknown technique ''"),
        ("no_such_package:Mine", "'no_such_package:Mine' cannot be imported: No module named"),
        ("test_techniques:Mine", "'test_techniques:Mine' cannot be imported: .*no attribute"),
        ("test_techniques:", "'test_techniques:' is not of the form package.module:Class"),
        (":x", "':x' is not of the form package.module:Class"),
        (".:x", "'.:x' is not of the form package.module:Class"),
        (".a:x", "'.a:x' cannot be imported: TypeError: the 'package' argument"),
        ("os:getcwd", "'os:getcwd' is a builtin_function_or_method; name a class"),
        ("test_techniques:OWN", "'test_techniques:OWN' is a str; name a class"),
        ("pathlib:Path", "'pathlib:Path' is a class that is no technique; derive it from"),
        ("test_techniques:Nameless", "is a Nameless; derive its class .* give it a name"),
    ],
)
def test_an_unknown_name_is_refused(name, message):
    with pytest.raises(ValueError, match=message):
        make_technique(name)


def test_a_registered_technique_is_used_like_those_that_ship(registry, pictures):
    register("Grid", ColourGrid)
    register("lazy", OWN)
    assert {"grid", "lazy"} <= set(registry)
    assert type(make_technique("GRID")) is ColourGrid
    assert make_technique("lazy").name == "ColourGrid"
    with pytest.raises(ValueError, match="did you mean 'grid'[?]"):
        make_technique("gird")
    register("grid", ColourGrid)  # once more is no harm


@pytest.mark.parametrize("name", ["hog", "HOG", "CoHOG"])
def test_a_taken_name_is_refused(registry, name):
    with pytest.raises(ValueError, match=f"technique '{name}' is registered already"):
        register(name, ColourGrid)
    assert registry[name.casefold()] != ColourGrid


@pytest.mark.parametrize("name", ["", " ", "a,b", "a=b", "a:b", "a+b", "a/b", "a\\b"])
def test_a_name_that_a_command_could_not_tell_apart_is_refused(registry, name):
    with pytest.raises(ValueError, match="give letters, digits, '-' or '_'"):
        register(name, ColourGrid)


def test_weights_go_to_techniques_that_take_some(tmp_path):
    assert make_technique("test_techniques:Weighed").name == "weighed by none"
    assert make_technique("test_techniques:Weighed", tmp_path).name == f"weighed by {tmp_path}"
    for name in ("hog", "cohog", OWN):
        with pytest.raises(ValueError, match=f"technique '{name}' takes no weights; leave out"):
            make_technique(name, tmp_path / "weights.npz")


def test_a_technique_without_describe_says_so():
    with pytest.raises(NotImplementedError, match=r"Nameless must define describe\(image\)"):
        Nameless().describe(image(0))
    assert Nameless().parameters() == {}


# --- code that is not ours ------------------------------------------------------------------------


class Demanding(Technique):
    name = "Demanding"

    def __init__(self, size):
        self.size = size


class Failing(Technique):
    name = "Failing"

    def __init__(self, weights="boom"):
        if weights == "boom":
            raise RuntimeError(weights)
        open(weights).close()


@pytest.mark.parametrize(
    ("name", "message", "cause"),
    [
        ("Demanding", "cannot be made: TypeError: .* missing 1 required .* 'size'", TypeError),
        (
            "Failing",
            r"cannot be made: RuntimeError: boom \(test_techniques.py:\d+\)$",
            RuntimeError,
        ),
    ],
)
def test_what_a_class_raises_as_it_is_made_is_one_sentence(name, message, cause):
    with pytest.raises(ValueError, match=f"technique 'test_techniques:{name}' {message}") as caught:
        make_technique(f"test_techniques:{name}")
    assert isinstance(caught.value.__cause__, cause)


def test_weights_that_a_class_of_ones_own_does_not_find_are_missing_files(tmp_path):
    with pytest.raises(FileNotFoundError):
        make_technique("test_techniques:Failing", str(tmp_path / "none"))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n1 +\n", r"SyntaxError: invalid syntax \(broken_one.py:2\)"),
        ("raise SystemExit('no')", r"SystemExit: no \(broken_one.py:1\)"),
        ("{}['key']", r"KeyError: 'key' \(broken_one.py:1\)"),
        ("import nowhere_at_all", "No module named 'nowhere_at_all'"),
    ],
)
def test_what_a_module_raises_as_it_is_imported_is_one_sentence(
    tmp_path, monkeypatch, text, message
):
    (tmp_path / "broken_one.py").write_text(text)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ValueError, match=f"'broken_one:X' cannot be imported: {message}$"):
        make_technique("broken_one:X")


def test_a_module_of_the_current_directory_is_found_after_all_others(tmp_path, monkeypatch):
    (tmp_path / "module_from_here.py").write_text(
        "from test_techniques import ColourGrid\nclass Mine(ColourGrid): pass\n"
    )
    (tmp_path / "random.py").write_text("raise AssertionError")
    monkeypatch.setattr(sys, "path", [each for each in sys.path if each])
    with pytest.raises(ValueError, match="cannot be imported: No module named 'module_from_here'"):
        make_technique("module_from_here:Mine")
    monkeypatch.chdir(tmp_path)
    before = list(sys.path)
    with pytest.raises(ValueError, match="No module named 'nothing_here'"):
        make_technique("nothing_here:Mine")
    assert sys.path == before
    assert make_technique("module_from_here:Mine").name == "ColourGrid"
    assert sys.path == [*before, str(tmp_path)]
    del sys.modules["module_from_here"]


def test_nothing_is_called_that_is_no_technique(monkeypatch):
    called = []
    monkeypatch.setattr(os, "getcwd", lambda: called.append(1) or "/")
    monkeypatch.setattr(sys.modules[__name__], "Recorder", lambda: called.append(2), raising=False)
    with pytest.raises(ValueError, match="is a function; name a class"):
        make_technique("test_techniques:Recorder")
    assert 2 not in called


def test_a_factory_of_ones_own_may_be_registered(registry):
    register("made", lambda: Weighed("a factory"))
    assert make_technique("made").name == "weighed by a factory"
