"""A localiser that images are pushed into: what `navigate` says, and on after a restart."""

from __future__ import annotations

import subprocess
import sys
import warnings
from collections import deque
from dataclasses import fields, replace

import numpy as np
import pytest
from amusic_baselines import make_policy
from extraction_cases import make_images
from live_cases import NAMES, SECONDS, Columns, live_of, map_of, traverse

from amusic_gym.envs.frames import ImageStream, as_frames
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.extraction.place_map import PlaceMap, build_map
from amusic_gym.extraction.thumbnails import Thumbnails
from amusic_gym.live import drives
from amusic_gym.live.localiser import Localiser
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.routes.positions import GEOGRAPHIC, Positions, from_degrees
from amusic_gym.utils import states

PLACES, FRAMES = 70, 60
POLICIES = (
    *("ppo", "music", "amusic", "amusic:evidence", "cascade", "random:0.4/idle", "periodic:3"),
    *("voi", "amusic:belief", "subset:HOG+CALC", "raw:HOG", "hmm", "borda"),
)


def techniques():
    return [Columns(name, 1 + t, t) for t, name in enumerate(NAMES)]


@pytest.fixture(scope="module")
def town() -> PlaceMap:
    """A map as `PlaceMap.load` gives it, of techniques that are quick."""
    images = traverse(PLACES, seed=1)
    degrees = from_degrees(59 + 1e-5 * np.arange(PLACES), np.full(PLACES, 10.0))
    return PlaceMap(
        path=".",
        name="town",
        maps=tuple(map_of(images, one) for one in techniques()),
        seconds=np.array(SECONDS),
        thumbnails=Thumbnails(".", np.zeros(0, np.uint8), np.zeros(PLACES, np.int64)),
        names=tuple(f"img{at}.png" for at in range(PLACES)),
        parts=(PLACES,),
        positions=Positions(degrees, GEOGRAPHIC, np.arange(PLACES) * 1.0, {}, "t"),
        digest="d",
    )


def drive(seed: int = 2):
    return traverse(FRAMES, seed=seed)


def told(result) -> tuple:
    """All that does not depend on the clock."""
    seen = result.seen
    kept = [getattr(seen, each.name) for each in fields(seen) if "milliseconds" not in each.name]
    kept = [each.tobytes() if isinstance(each, np.ndarray) else each for each in kept[2:]]
    return (result.place, result.p_correct, result.active, *kept)


# ---- the same as navigate --------------------------------------------------------------------


@pytest.mark.parametrize("spec", POLICIES)
def test_it_says_what_navigate_says(town, spec):
    localiser = Localiser(town, spec, seed=3)
    found = [localiser.update(image) for image in drive()]
    route = live_of(town.maps, drive(), tolerance=2)
    policy = make_policy(spec, Context.of(route, statistic="evidence", seed=3))
    wanted = list(navigate(policy, route, compute_weight=0.3))
    assert len(found) == len(wanted) == FRAMES
    for ours, theirs in zip(found, wanted, strict=True):
        assert (ours.place, ours.p_correct) == (theirs.prediction, theirs.p_correct)
        assert ours.seen.confidence == theirs.confidence
        assert ours.active == theirs.active


def test_a_result_says_where_and_how_sure(town):
    localiser = Localiser(town, "music", min_p=0.9)
    results = [localiser.update(image, stamp=float(at)) for at, image in enumerate(drive())]
    last = results[-1]
    assert (last.place, last.name, last.frame, last.stamp) == (59, "img59.png", 59, 59.0)
    assert last.position == pytest.approx((59 + 59e-5, 10.0))
    assert last.heading == 59
    assert last.active == NAMES
    assert last.milliseconds > 0
    assert {each.known for each in results} == {True, False}
    assert all(each.known == (each.p_correct >= 0.9) for each in results)
    raw = Localiser(town, "raw:HOG").update(drive()[0])
    assert (raw.p_correct, raw.known) == (None, None)


@pytest.mark.parametrize(
    ("policy", "statistic", "message"),
    [
        ("ppo", "belief", "statistic is 'belief', but the policy needs 'evidence'"),
        ("amusic", "evidence", "statistic is 'evidence', but the policy needs 'mean'"),
        ("music", "nonsense", "unknown statistic 'nonsense'"),
    ],
)
def test_38_a_statistic_that_the_policy_does_not_take_is_refused(town, policy, statistic, message):
    with pytest.raises(ValueError, match=message):
        Localiser(town, policy, statistic=statistic)
    assert Localiser(town, "music", statistic="belief").update(drive()[0]).p_correct is not None


def test_a_result_is_shown_without_the_image(town):
    result = Localiser(town, "music").update(drive()[0])
    assert "array" not in repr(result)
    assert "p_correct=" in repr(result)


def test_a_closed_one_says_so(town):
    with Localiser(town, "music") as localiser:
        localiser.update(drive()[0])
    with pytest.raises(ValueError, match="the localiser is closed; load it anew"):
        localiser.update(drive()[1])


def test_before_a_place_there_is_none(town):
    class Idle:
        needs = Needs(allow_idle=True)

        def reset(self, mask):
            pass

        def act(self, observation, info):
            return np.zeros((1, len(NAMES)), np.bool_)

    first = Localiser(town, Idle()).update(drive()[0])
    assert (first.place, first.name, first.position, first.known) == (-1, "", None, False)


def test_grey_images_are_taken_and_the_camera_may_use_its_memory_again(town):
    one, other = Localiser(town, "amusic"), Localiser(town, "amusic")
    memory = np.zeros(drive()[0].shape[:2], np.uint8)
    for image in drive()[:25]:
        grey = image[..., 0]
        memory[...] = grey
        assert told(one.update(memory)) == told(other.update(np.stack([grey] * 3, -1)))
        memory[...] = 0


def test_reset_begins_anew_and_relocalise_runs_everything_once(town):
    localiser = Localiser(town, "subset:HOG")
    first = [told(each) for each in localiser.track(drive()[:20])]
    localiser.relocalise()
    found = [localiser.update(image) for image in drive()[40:]]
    assert found[0].active == NAMES
    assert {each.active for each in found[1:]} == {("HOG",)}
    assert [each.frame for each in found] == list(range(20, 40))
    assert found[-1].place == 59
    localiser.reset()
    again = [localiser.update(image) for image in drive()[:20]]
    assert [told(each) for each in again] == first
    assert again[0].frame == 0


# ---- a restart -------------------------------------------------------------------------------


@pytest.mark.parametrize("spec", POLICIES)
@pytest.mark.parametrize("cut", [0, 7, 33])
def test_a_saved_state_continues_bit_for_bit(town, tmp_path, spec, cut):
    images = drive()
    localiser = Localiser(town, spec, seed=3)
    for image in images[:cut]:
        localiser.update(image)
    path = localiser.save_state(tmp_path / "state")
    wanted = [told(localiser.update(image)) for image in images[cut:]]
    other = Localiser(town, spec, seed=3)
    for image in drive(5)[:11]:  # what it did before does not count
        other.update(image)
    other.load_state(path)
    assert [told(other.update(image)) for image in images[cut:]] == wanted
    assert [each.name for each in tmp_path.iterdir()] == ["state"]


@pytest.mark.parametrize("spec", ["music", "amusic"])
def test_a_state_from_far_on_continues_bit_for_bit(town, tmp_path, spec):
    images = drive() * 20
    localiser = Localiser(town, spec)
    for image in images[:1100]:  # more frames than are remembered
        localiser.update(image)
    path = localiser.save_state(tmp_path / "state")
    wanted = [told(localiser.update(image)) for image in images[1100:]]
    other = Localiser(town, spec)
    other.load_state(path)
    assert [told(other.update(image)) for image in images[1100:]] == wanted
    other.reset()
    fresh = Localiser(town, spec)
    assert [told(other.update(each)) for each in images[:30]] == [
        told(fresh.update(each)) for each in images[:30]
    ]


def test_frames_stamps_and_a_relocalisation_are_saved_too(town, tmp_path):
    localiser = Localiser(town, "subset:HOG")
    localiser.update(drive()[0], stamp=4.0)
    localiser.relocalise()
    localiser.save_state(tmp_path / "state")
    other = Localiser(town, "subset:HOG")
    other.load_state(tmp_path / "state")
    with pytest.raises(ValueError, match=r"stamp is 4\.0, not after 4\.0"):
        other.update(drive()[1], stamp=4.0)
    found = other.update(drive()[1], stamp=5.0)
    assert (found.frame, found.active) == (1, NAMES)


CHILD = """
import sys
from amusic_gym.live.localiser import Localiser
from amusic_gym.routes.folders import ImageFolder
localiser = Localiser.load(sys.argv[1], "amusic")
localiser.load_state(sys.argv[2])
for image in list(ImageFolder(sys.argv[3]))[7:]:
    print(localiser.update(image).seen.confidence.hex())
"""


@pytest.mark.slow
def test_another_process_goes_on(tmp_path):
    for seed, name in enumerate(("map", "run")):
        make_images(tmp_path / name, 16, seed)
    how = {"seconds": {"HOG": 1.0}, "cache": tmp_path / "cache"}
    build_map(tmp_path / "map", ["hog"], tmp_path / "town.map", **how)
    from amusic_gym.routes.folders import ImageFolder

    images = list(ImageFolder(tmp_path / "run"))
    with Localiser.load(tmp_path / "town.map", "amusic") as localiser:
        for image in images[:7]:
            localiser.update(image)
        localiser.save_state(tmp_path / "state")
        wanted = [localiser.update(image).seen.confidence.hex() for image in images[7:]]
    paths = [tmp_path / name for name in ("town.map", "state", "run")]
    words = [sys.executable, "-W", "error", "-c", CHILD, *map(str, paths)]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.split() == wanted


def test_a_state_of_another_map_policy_or_setting_is_refused(town, tmp_path):
    localiser = Localiser(town, "music")
    path = localiser.save_state(tmp_path / "state")
    for other, words in (
        (Localiser(town, "subset:HOG", tolerance=1), "was saved with tolerance 2, here it is 1"),
        (Localiser(town, "amusic"), "was saved with policy amusic_baselines"),
    ):
        with pytest.raises(ValueError, match=words):
            other.load_state(path)
    with pytest.raises(FileNotFoundError, match="none does not exist"):
        localiser.load_state(tmp_path / "none")
    path.write_bytes(path.read_bytes()[:-9])
    with pytest.raises(ValueError, match="is no saved state, or damaged"):
        localiser.load_state(path)


def test_a_state_of_another_version_is_refused_and_the_localiser_begins_anew(town, tmp_path):
    localiser = Localiser(town, "music")
    localiser.update(drive()[0])
    path = localiser.save_state(tmp_path / "state")
    tree, arrays = states.read_state(path)
    states.write_state(path, tree, {name: array[..., None] for name, array in arrays.items()})
    with pytest.raises(ValueError, match="was saved by another version .* is of another kind"):
        localiser.load_state(path)
    assert localiser.update(drive()[0]).frame == 0


def test_what_is_no_plain_data_is_not_saved():
    class Own:
        def __init__(self) -> None:
            self.seen = {1}

    with pytest.raises(TypeError, match=r"policy\.seen is a set, which cannot be saved"):
        states.taken(Own(), {}, (), "policy")
    arrays: dict = {}
    value = {"a": deque([np.arange(3), (1, 2.5)], 4), 7: None}
    saved = states.taken(value, arrays)
    found = states.put_back({"a": deque([0, (0, 0)], 4), 7: 1}, saved, arrays)
    assert found["a"].maxlen == 4
    assert found["a"][0].tolist() == [0, 1, 2]
    assert (found["a"][1], found[7]) == ((1, 2.5), None)


# ---- refusals, and what an error leaves --------------------------------------------------------


@pytest.mark.parametrize(
    "image", [np.zeros((2, 12, 4), np.uint8), np.zeros((2, 12, 3)), np.zeros((0, 3), np.uint8), "x"]
)
def test_what_is_no_image_is_refused_and_changes_nothing(town, image):
    one, other = Localiser(town, "amusic"), Localiser(town, "amusic")
    for at, each in enumerate(drive()[:15]):
        if at == 9:
            with pytest.raises(ValueError, match="the image has shape .* give"):
                one.update(image)
        assert told(one.update(each)) == told(other.update(each))


def test_after_an_image_that_all_techniques_refuse_it_begins_anew(town):
    localiser = Localiser(town, "music")
    localiser.update(drive()[0])
    refused = np.zeros((2, 7, 3), np.uint8)
    with (
        pytest.warns(UserWarning, match="is left out"),
        pytest.raises(ValueError, match="technique 'CoHOG'"),
    ):
        localiser.update(refused)
    with pytest.raises(ValueError, match="an error cut the last step short"):
        localiser.update(drive()[1])
    localiser.relocalise()
    assert localiser.update(drive()[1]).frame == 1


class Failing(Columns):
    """Raises on some of its runs."""

    failing: range = range(0)
    runs = 0

    def describe_query(self, image):
        self.runs += 1
        if self.runs - 1 in self.failing:
            raise OSError("the accelerator is gone")
        return self.describe(image)


@pytest.mark.parametrize("spec", ["music", "subset:CALC+CoHOG", "ppo", "voi", "hmm", "amusic"])
def test_a_technique_that_raises_is_left_out_for_a_while_and_told_of_once(town, spec, monkeypatch):
    monkeypatch.setattr(drives, "RETRY", 10)
    failing = Failing(NAMES[1], 2, 1)
    failing.failing = range(20, 22)  # and then is well again
    maps = (town.maps[0], map_of(traverse(PLACES, seed=1), failing), town.maps[2])
    localiser = Localiser(replace(town, maps=maps), spec)
    with warnings.catch_warnings(record=True) as told_of:
        warnings.simplefilter("always")
        found = [localiser.update(image) for image in drive()]
    lines = [str(each.message) for each in told_of]
    if failing.runs > 20:
        assert len(lines) == 1
        assert lines[0].startswith("technique 'CALC' is left out, and tried again every 10 frames")
        assert "the accelerator is gone" in lines[0]
    assert found[-1].place == 59
    if spec == "music":
        with_it = [each.frame for each in found if "CALC" in each.active]
        assert with_it == [*range(20), *range(40, FRAMES)]
        assert failing.runs == 20 + 2 + 20


def test_a_policy_of_one_technique_that_raises_gets_the_cheapest_other(town, monkeypatch):
    monkeypatch.setattr(drives, "RETRY", 10)
    failing = Failing(NAMES[1], 2, 1)
    failing.failing = range(5, 99)
    maps = (town.maps[0], map_of(traverse(PLACES, seed=1), failing), town.maps[2])
    localiser = Localiser(replace(town, maps=maps), "subset:CALC")
    with pytest.warns(UserWarning, match="technique 'CALC' is left out"):
        found = [localiser.update(image) for image in drive()[:30]]
    assert [each.active for each in found[:7]] == [("CALC",)] * 5 + [(), ("HOG",)]
    assert [each.frame for each in found if not each.active] == [5, 15, 25]
    assert found[-1].place == 29


def test_options_out_of_range_are_refused(town):
    for options, words in (
        ({"min_p": 1.5}, r"min_p is 1\.5; give a number in \[0, 1\]"),
        ({"tolerance": -1}, "tolerance is -1"),
        ({"policy": "amusik"}, "did you mean 'amusic'"),
        ({"seconds": {"HOG": -1.0}}, "seconds of technique 'HOG'"),
        ({"seconds": {"HGO": 1.0}}, "unknown technique 'HGO': did you mean 'HOG'"),
    ):
        with pytest.raises(ValueError, match=words):
            Localiser(town, **options)


# ---- iterators as sources ----------------------------------------------------------------------


def test_an_iterator_of_images_is_a_source(town):
    images = drive()[:9]
    for source in (iter(images), (image for image in images)):
        route = LiveRoute(town.maps, source, tolerance=1)  # costs are measured on the first one
        policy = make_policy("music", Context.of(route, statistic="evidence"))
        assert [each.frame for each in navigate(policy, route)] == list(range(9))
        with pytest.raises(ValueError, match="gives each image once; make a new one"):
            next(navigate(policy, route))
    stream = as_frames(image for image in images)
    assert isinstance(stream, ImageStream)
    assert stream.read(3) is images[3]
    with pytest.raises(ValueError, match="frame 2 has gone by"):
        stream.read(2)
    with pytest.raises(ValueError, match="no frame; give at least one image"):
        LiveRoute(town.maps, iter([]), tolerance=1)


# ---- limits ------------------------------------------------------------------------------------


def test_a_budget_and_a_cap_are_kept_and_saved(town, tmp_path):
    how = {"seconds": dict(zip(NAMES, SECONDS, strict=True)), "budget_ms": 2500.0, "cap_ms": 6000}
    images = drive() + drive(3)
    localiser = Localiser(town, "ppo", **how)
    for image in images[:50]:
        localiser.update(image)
    path = localiser.save_state(tmp_path / "state")
    wanted = [localiser.update(image) for image in images[50:]]
    assert {len(each.active) for each in wanted} <= {1, 2}
    assert len({each.seen.compute_weight for each in wanted}) > 5
    other = Localiser(town, "ppo", **how)
    other.load_state(path)
    assert [told(other.update(image)) for image in images[50:]] == [told(each) for each in wanted]
    with pytest.raises(ValueError, match="was saved with "):
        Localiser(town, "ppo", **{**how, "budget_ms": 2400.0}).load_state(path)
    with pytest.raises(TypeError, match="budget_s"):
        Localiser(town, "ppo", budget_s=1)
