"""Conditions for images of real places."""

from __future__ import annotations

import pickle
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from amusic_gym.routes.conditions import CONDITIONS, PLAIN, STRENGTH, Change, Condition

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent
CHANGING = [name for name in CONDITIONS if name != PLAIN]
parametrized = pytest.mark.parametrize("name", CHANGING)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    """A picture with large and small things in it, (48, 64, 3)."""
    rng = np.random.default_rng(0)
    noise = rng.integers(0, 256, (12, 16, 3), dtype=np.uint8)
    picture = cv2.resize(noise, (64, 48), interpolation=cv2.INTER_CUBIC)
    cv2.rectangle(picture, (20, 10), (40, 30), (250, 240, 230), -1)
    cv2.line(picture, (0, 47), (63, 20), (5, 10, 15), 2)
    return picture


def under(text: str, image: np.ndarray, seed: int = 1, frame: int = 3) -> np.ndarray:
    return Condition.parse(text).apply(image, seed=seed, frame=frame)


def change(text: str, image: np.ndarray, **where: int) -> float:
    """Mean absolute change of a value."""
    return float(abs(under(text, image, **where).astype(int) - image).mean())


names = st.sampled_from(list(CONDITIONS))
strengths = st.floats(0, 1, exclude_min=True)


@settings(max_examples=60)
@given(
    st.lists(names, min_size=1, max_size=3),
    st.integers(1, 40),
    st.integers(1, 40),
    st.integers(0, 2**70),
    st.integers(0, 10**9),
    st.integers(0, 255),
)
def test_any_image_keeps_its_shape_and_kind_and_is_left_alone(
    chosen, height, width, seed, frame, value
):
    image = np.random.default_rng(0).integers(0, value + 1, (height, width, 3), dtype=np.uint8)
    before = image.copy()
    made = under("+".join(chosen), image, seed, frame)
    assert (made.shape, made.dtype) == (image.shape, np.uint8)
    assert np.array_equal(image, before)
    assert np.array_equal(made, under("+".join(chosen), image, seed, frame))


@parametrized
def test_the_same_frame_is_the_same_in_any_order(name, scene):
    frames = [5, 0, 3, 5, 1]
    there = {frame: under(name, scene, frame=frame) for frame in frames}
    for frame in sorted(frames, reverse=True):
        assert np.array_equal(under(name, scene, frame=frame), there[frame])


@pytest.mark.parametrize("name", ["night", "fog", "rain", "glare"])
def test_frames_and_seeds_differ_where_something_is_drawn(name, scene):
    assert not np.array_equal(under(name, scene, frame=0), under(name, scene, frame=1))
    assert not np.array_equal(under(name, scene, seed=0), under(name, scene, seed=1))


def test_a_drive_shifts_to_one_side(scene):
    sides = set()
    for seed in range(8):
        made = {under("shift", scene, seed, frame).tobytes() for frame in range(4)}
        assert len(made) == 1
        sides |= made
    assert len(sides) == 2


@parametrized
def test_a_greater_strength_changes_the_same_image_by_more(name, scene):
    for frame in range(3):
        changes = [change(f"{name}:{s / 10}", scene, frame=frame) for s in range(1, 11)]
        assert changes[0] > 0
        assert (np.diff(changes) > 0).all(), changes
    assert change(f"{name}:0.001", scene) < 0.12 * changes[-1]


def test_each_condition_does_what_it_is_called(scene):
    spread = scene.std()
    assert under("night:1", scene).mean() < 0.35 * scene.mean()
    assert under("night:1", np.zeros_like(scene)).std() > 2  # noise, where there is no light
    across = abs(np.diff(under("blur:1", scene).astype(int), axis=1)).mean()
    down = abs(np.diff(under("blur:1", scene).astype(int), axis=0)).mean()
    assert across < 0.6 * abs(np.diff(scene.astype(int), axis=1)).mean()
    assert across < down
    foggy = under("fog:1", scene)
    assert foggy.std() < 0.5 * spread
    assert foggy[:10].std() < 0.5 * foggy[-10:].std()  # denser above
    rainy = under("rain:1", np.full_like(scene, 60)).max(axis=2)
    assert 0.02 < (rainy > 100).mean() < 0.7
    assert (
        abs(np.diff(rainy.astype(int), axis=0)).mean()
        < 0.7 * abs(np.diff(rainy.astype(int), axis=1)).mean()
    )  # streaks stand upright
    sunny = under("glare:1", np.zeros_like(scene))
    row, column = np.unravel_index(sunny[..., 1].argmax(), scene.shape[:2])
    assert sunny.max() == 255
    assert row < 24
    assert sunny[-1].max() < 150


def test_a_shift_shows_a_part_of_the_image_at_the_same_scale_in_both_directions():
    image = np.zeros((40, 100, 3), np.uint8)
    image[15:25, 45:55] = 255
    made = under("shift:1", image, seed=0)
    rows, columns = np.nonzero(made[..., 0] > 127)
    scale = 1 / 0.7
    assert np.ptp(rows) + 1 == pytest.approx(10 * scale, abs=1.1)
    assert np.ptp(columns) + 1 == pytest.approx(10 * scale, abs=1.1)
    assert rows.mean() == pytest.approx(19.5, abs=0.6)
    assert abs(columns.mean() - 49.5) == pytest.approx(0.15 * 100 * scale, abs=1.5)


def test_plain_is_the_image_itself(scene):
    assert under("plain", scene) is scene
    assert Condition.parse("plain") == Condition() == Condition.parse("plain+plain")
    assert np.array_equal(under("plain+night", scene), under("night", scene))


def test_several_are_applied_one_after_the_other(scene):
    both = under("night:0.4+rain", scene)
    assert np.array_equal(both, under("rain", under("night:0.4", scene)))
    assert not np.array_equal(both, under("rain+night:0.4", scene))


@given(st.lists(st.tuples(st.sampled_from(CHANGING), strengths), max_size=4))
def test_what_is_written_is_read_again(parts):
    condition = Condition(tuple(parts))
    assert Condition.parse(str(condition)) == condition
    shown = Change(condition, 3, 4)
    assert pickle.loads(pickle.dumps(shown)) == shown
    assert str(shown) == f"{condition} seed 3 frame 4"


def test_the_strength_that_is_not_given_is_the_documented_one():
    assert Condition.parse("night") == Condition.parse(f" night : {STRENGTH} ")
    assert str(Condition.parse("night+blur:1")) == f"night:{STRENGTH}+blur:1.0"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("nigt", "unknown condition 'nigt': did you mean 'night'. valid: plain, night"),
        ("night+rian", "did you mean 'rain'"),
        ("", "unknown condition ''"),
        ("night+", "unknown condition ''"),
        ("night:", "strength is ''; give a number above 0 and up to 1"),
        ("night:0", "condition 'night:0': strength is '0'; give a number above 0"),
        ("night:1.01", "strength is '1.01'"),
        ("night:nan", "strength is 'nan'"),
        ("night:dark", "strength is 'dark'"),
        ("plain:0.5", "plain has no strength; drop it"),
        (None, "condition is None; give a text"),
    ],
)
def test_what_is_no_condition_is_refused(text, sentence):
    with pytest.raises(ValueError, match=sentence):
        Condition.parse(text)


@pytest.mark.parametrize(
    ("image", "seed", "frame", "sentence"),
    [
        (np.zeros((4, 4), np.uint8), 0, 0, r"image has shape \(4, 4\)"),
        (np.zeros((4, 4, 3)), 0, 0, "dtype float64"),
        (np.zeros((0, 4, 3), np.uint8), 0, 0, r"give \(H, W, 3\) uint8"),
        (np.zeros((4, 4, 3), np.uint8), -1, 0, "seed is -1"),
        (np.zeros((4, 4, 3), np.uint8), 0, 1.5, "frame is 1.5"),
    ],
)
def test_other_images_seeds_and_frames_are_refused(image, seed, frame, sentence):
    with pytest.raises(ValueError, match=sentence):
        Condition.parse("night").apply(image, seed=seed, frame=frame)


def test_the_sheet_of_the_docs_shows_every_condition(tmp_path):
    command = ["-m", "amusic_gym.worlds", "--on-images", "--out", tmp_path / "sheet.jpg"]
    subprocess.run([sys.executable, *map(str, command)], cwd=ROOT, check=True, timeout=120)
    drawn = cv2.imread(str(tmp_path / "sheet.jpg"))
    assert drawn.shape[0] == 120 * len(CONDITIONS)
    shown = cv2.imread(str(ROOT / "docs" / "images" / "conditions.jpg"))
    assert shown.shape == drawn.shape
    assert abs(shown.astype(int) - drawn).mean() < 3
