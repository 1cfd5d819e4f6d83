"""HOG: settings and layout against an independent block, exact directions, and real scores."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from corridor import data_folder
from recordings import read_folder

from amusic_gym.techniques import make_technique

BLOCKS = 63


def blocks_of(descriptor):
    """(35721,) -> (row, column, bin); OpenCV goes down the columns of blocks."""
    return descriptor.reshape(BLOCKS, BLOCKS, 9).transpose(1, 0, 2)


def textured(seed, size=512):
    rng = np.random.default_rng(seed)
    small = rng.integers(0, 256, (size // 8, size // 8, 3)).astype(np.uint8)
    return cv2.resize(small, (size, size), interpolation=cv2.INTER_CUBIC)


def one_block(image, row, column):
    """L2-Hys histogram of one inner block of 16×16 pixels, by the definition."""
    values = image.astype(float)
    top, left = 8 * row, 8 * column
    histogram = np.zeros(9)
    for y in range(16):
        for x in range(16):
            py, px = top + y, left + x
            across = values[py, px + 1] - values[py, px - 1]
            down = values[py + 1, px] - values[py - 1, px]
            channel = np.argmax(across**2 + down**2)
            angle = np.degrees(np.arctan2(down[channel], across[channel])) % 180
            middle_y, middle_x = (y - 7.5) / 16, (x - 7.5) / 16  # in cells, from the cell's middle
            weight = (1 - abs(middle_y)) * (1 - abs(middle_x))
            weight *= np.exp(-((y - 8) ** 2 + (x - 8) ** 2) / (2 * 4.0**2))
            strength = weight * np.hypot(across[channel], down[channel])
            position = angle / 20 - 0.5
            lower = int(np.floor(position))
            histogram[lower % 9] += strength * (1 - (position - lower))
            histogram[(lower + 1) % 9] += strength * (position - lower)
    clipped = np.minimum(histogram / np.linalg.norm(histogram), 0.2)
    return clipped / np.linalg.norm(clipped)


@pytest.mark.parametrize("size", [(512, 512), (130, 100)])
@pytest.mark.parametrize(("row", "column"), [(1, 1), (5, 40), (61, 2), (30, 30)])
def test_a_block_is_what_the_definition_says(row, column, size):
    image = np.ascontiguousarray(textured(1)[: size[0], : size[1]])
    descriptor = make_technique("HOG").describe(image)
    found = blocks_of(descriptor)[row, column]
    expected = one_block(cv2.resize(image, (512, 512)), row, column)
    np.testing.assert_allclose(found / np.linalg.norm(found), expected, atol=4e-3)


@pytest.mark.parametrize(
    ("turned", "bins"),
    [(False, {0: 0.5**0.5, 8: 0.5**0.5}), (True, {4: 1.0})],  # 0° lies between two bins, 90° in one
)
def test_a_ramp_has_one_direction(turned, bins):
    ramp = np.tile(np.arange(0, 256, 0.5).astype(np.uint8), (512, 1))
    image = np.dstack([ramp.T if turned else ramp] * 3)
    blocks = blocks_of(make_technique("HOG").describe(image))
    expected = np.zeros(9)
    for position, value in bins.items():
        expected[position] = value
    np.testing.assert_allclose(blocks, np.broadcast_to(expected / BLOCKS, blocks.shape), atol=1e-6)


def test_a_descriptor_has_length_one_and_the_score_is_the_cosine():
    hog = make_technique("HOG")
    first, second = (hog.describe(textured(seed)) for seed in (1, 2))
    assert first.shape == (35721,)
    assert np.linalg.norm(first) == pytest.approx(1, abs=1e-6)
    scores = hog.match(first, np.stack([first, second]))
    assert scores == pytest.approx([1, float(np.sum(first * second, dtype=float))], abs=1e-6)


def test_an_image_without_gradients_gives_zeros():
    hog = make_technique("HOG")
    assert not hog.describe(np.full((40, 30, 3), 7, np.uint8)).any()


def test_scores_on_corridor_are_those_of_vprbench():
    folder = data_folder() / "corridor"
    hog = make_technique("HOG")
    references = np.stack([hog.describe(image) for image in read_folder(folder / "reference")])
    queries = [hog.describe_query(image) for image in read_folder(folder / "query")]
    scores = np.stack([hog.match(query, references) for query in queries])
    stored = np.load(folder / "scores" / "HOG.npy")
    assert np.corrcoef(scores.ravel(), stored.ravel())[0, 1] >= 0.995
    assert np.abs(scores - stored).max() <= 0.01
