"""Input of networks: sizes, colours, and which part of an image is seen."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from weight_cases import image

from amusic_gym.techniques.network_input import NetworkInput

PLAIN = {"mean": (0.0, 0.0, 0.0), "deviation": (1.0, 1.0, 1.0)}


def test_colours_are_red_first_and_standardised():
    flat = np.empty((30, 40, 3), np.uint8)
    flat[:] = (10, 20, 30)  # blue, green, red
    x = NetworkInput(6, 8, mean=(1, 2, 3), deviation=(2, 4, 8)).apply(flat)
    assert x.shape == (3, 6, 8)
    assert x.dtype == torch.float32
    for channel, value in zip(x, (29 / 2, 18 / 4, 7 / 8), strict=True):
        torch.testing.assert_close(channel, torch.full((6, 8), value))


@pytest.mark.parametrize("interpolation", ["bilinear", "bicubic"])
def test_an_image_of_the_right_size_stays_as_it_is(interpolation):
    picture = image(1, 60, 90)
    for resize in ("stretch", "crop", "shorter"):
        made = NetworkInput(60, 90, resize, interpolation=interpolation, **PLAIN).apply(picture)
        expected = picture[:, :, ::-1].transpose(2, 0, 1).astype(np.float32)
        np.testing.assert_allclose(made, expected, atol=1e-4)


@pytest.mark.parametrize(("height", "width"), [(40, 100), (100, 40)])
def test_crop_sees_the_middle_in_proportion(height, width):
    picture = np.zeros((height, width, 3), np.uint8)
    rows, columns = ((n - 40) // 2 for n in (height, width))
    picture[rows : rows + 40, columns : columns + 40] = 200
    made = NetworkInput(20, 20, "crop", **PLAIN).apply(picture)
    assert made.shape == (3, 20, 20)
    np.testing.assert_allclose(made[:, 2:-2, 2:-2], 200, atol=1e-3)


def test_shrinking_is_smooth():
    """Of noise, blocks of 8×8 pixels are averaged, not a few of their pixels."""
    noise = np.random.default_rng(0).integers(0, 256, (96, 96, 3)).astype(np.uint8)
    made = NetworkInput(12, 12, **PLAIN).apply(noise)
    assert made.std() < 0.2 * noise.std()


@pytest.mark.parametrize(
    ("shape", "multiple", "expected"),
    [
        ((60, 90), 1, (28, 42)),
        ((90, 60), 14, (42, 28)),
        ((50, 61), 14, (28, 28)),
        ((1, 2), 7, (28, 56)),
    ],
)
def test_shorter_keeps_proportions_in_multiples(shape, multiple, expected):
    picture = np.zeros((*shape, 3), np.uint8)
    made = NetworkInput(28, 40, "shorter", multiple=multiple).apply(picture)
    assert made.shape[1:] == expected


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"height": 0}, "height is 0"),
        ({"resize": "strech"}, "did you mean 'stretch'"),
        ({"interpolation": "cubic"}, "did you mean 'bicubic'"),
        ({"multiple": 0}, "multiple is 0"),
        ({"deviation": (1, 0, 1)}, "numbers above 0"),
    ],
)
def test_what_makes_no_input_is_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        NetworkInput(**{"height": 8, "width": 8, **wrong})


def test_an_image_too_long_for_its_width_is_refused():
    with pytest.raises(ValueError, match="would become 100000×100, sides here have 8192 at most"):
        NetworkInput(100, 100, "shorter").apply(np.zeros((1, 1000, 3), np.uint8))
