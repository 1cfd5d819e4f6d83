"""GIST against stored descriptors of lear_gist, its definition, and real recordings."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from corridor import data_folder
from recordings import accuracy
from weight_cases import image

from amusic_gym.techniques import gist, make_technique


@pytest.mark.parametrize(
    ("name", "orientations", "blocks"),
    [
        ("no_arg", (8, 8, 4), 4),
        ("nblocks4", (8, 8, 4), 4),
        ("nblocks2", (8, 8, 4), 2),
        ("ops_4_4_4", (4, 4, 4), 4),
        ("ops_8_8_8", (8, 8, 8), 4),
    ],
)
def test_descriptors_are_those_of_lear_gist(name, orientations, blocks):
    folder = data_folder("gist_golden") / "gist_golden"
    if not folder.is_dir():
        pytest.skip("AMUSIC_DATA holds no gist_golden/")
    scene = np.load(folder / "scene.npy")  # red, green, blue
    expected = np.loadtxt(folder / f"scene.{name}.result").ravel()
    channels = gist.prefiltered(scene.transpose(2, 0, 1).astype(float))
    got = gist.energies(channels, orientations, blocks=blocks)
    np.testing.assert_allclose(got, expected, rtol=0, atol=5e-5)  # written with four decimals
    if name == "no_arg":
        whole = make_technique("gist-lear").describe(np.ascontiguousarray(scene[:, :, ::-1]))
        np.testing.assert_array_equal(whole, got)


def grating(cycles, degrees, size=128):
    """A wave of so many cycles across the image, its crests perpendicular to the direction."""
    y, x = np.mgrid[:size, :size] / size
    along = x * np.cos(np.radians(degrees)) + y * np.sin(np.radians(degrees))
    grey = np.rint(127 + 100 * np.sin(2 * np.pi * cycles * along)).astype(np.uint8)
    return np.dstack([grey] * 3)


@pytest.mark.parametrize("scale", range(3))
@pytest.mark.parametrize("step", [0, 1, 4, 6])
def test_a_grating_answers_in_the_filter_of_its_scale_and_direction(scale, step):
    picture = grating(128 * 0.3 / 1.85**scale, -180 * step / 8)
    found = make_technique("gist").describe(picture).reshape(4, 8, 16).mean(axis=2)
    assert np.unravel_index(found.argmax(), found.shape) == (scale, step)


def test_blocks_go_down_the_columns():
    picture = np.full((128, 128, 3), 128, np.uint8)
    picture[96:, 32:64] = grating(32, 0)[96:, 32:64]  # row 3, column 1
    found = make_technique("gist").describe(picture).reshape(32, 16).sum(axis=0)
    assert found.argmax() == 1 * 4 + 3


def test_the_middle_of_an_image_counts_and_its_colours_do_not():
    technique, picture = make_technique("gist"), grating(20, 30)
    wide = np.full((128, 200, 3), 128, np.uint8)
    wide[:, 36:164] = picture
    np.testing.assert_allclose(technique.describe(wide), technique.describe(picture), atol=1e-6)
    coloured = image(3, 128, 128)[:120, :120]
    grey = np.repeat(coloured.mean(axis=2, keepdims=True).round(), 3, axis=2).astype(np.uint8)
    near = technique.describe(grey), technique.describe(coloured)
    np.testing.assert_allclose(*near, atol=0.01)


@pytest.mark.parametrize(("name", "size"), [("gist", 512), ("gist-lear", 960)])
def test_length_score_and_brightness(name, size):
    technique = make_technique(name)
    picture = cv2.resize(image(1), (128, 128)) // 2
    one, bright, other = (technique.describe(x) for x in (picture, picture * 2, image(2)))
    assert one.shape == bright.shape == (size,)
    scores = technique.match(one, np.stack([one, bright, other]))
    assert scores.dtype == np.float32
    expected = [-np.sqrt(((one - each).astype(float) ** 2).sum()) for each in (one, bright, other)]
    np.testing.assert_allclose(scores, expected, atol=1e-6)
    assert scores[1] > 0.2 * scores[2]  # twice as bright is nearly the same


@pytest.mark.slow
@pytest.mark.parametrize(("recording", "expected"), [("corridor", 0.41), ("gardens_night", 0.285)])
def test_accuracy_on_recordings(recording, expected):
    assert accuracy(make_technique("gist"), recording) == pytest.approx(expected, abs=0.02)
