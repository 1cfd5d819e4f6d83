"""CALC against plain NumPy, Caffe's own rules in OpenCV, and the stored scores of a recording."""

from __future__ import annotations

import copy
import pickle
import re
from pathlib import Path

import corridor
import cv2
import network_oracle as oracle
import numpy as np
import pytest
import torch
import weight_cases as cases
from safetensors.numpy import save_file

from amusic_gym.techniques import make_technique
from amusic_gym.techniques.calc import CALC
from amusic_gym.techniques.networks import CALCEncoder
from amusic_gym.techniques.preparation import prepare_calc
from amusic_gym.techniques.saved_weights import save_calc

DEPLOY = """
name: "calc" input: "X1" input_dim: 1 input_dim: 1 input_dim: 120 input_dim: 160
layer { name: "conv1" type: "Convolution" bottom: "X1" top: "conv1"
  convolution_param { num_output: 64 kernel_size: 5 stride: 2 pad: 4 } }
layer { name: "relu1" type: "ReLU" bottom: "conv1" top: "relu1" }
layer { name: "pool1" type: "Pooling" bottom: "relu1" top: "pool1"
  pooling_param { pool: MAX kernel_size: 3 stride: 2 } }
layer { name: "norm1" type: "LRN" bottom: "pool1" top: "norm1"
  lrn_param { local_size: 5 alpha: 0.0001 beta: 0.75 } }
layer { name: "conv2" type: "Convolution" bottom: "norm1" top: "conv2"
  convolution_param { num_output: 128 kernel_size: 4 pad: 2 } }
layer { name: "relu2" type: "ReLU" bottom: "conv2" top: "relu2" }
layer { name: "pool2" type: "Pooling" bottom: "relu2" top: "pool2"
  pooling_param { pool: MAX kernel_size: 3 stride: 2 } }
layer { name: "norm2" type: "LRN" bottom: "pool2" top: "norm2"
  lrn_param { local_size: 5 alpha: 0.0001 beta: 0.75 } }
layer { name: "conv3" type: "Convolution" bottom: "norm2" top: "conv3"
  convolution_param { num_output: 4 kernel_size: 3 } }
layer { name: "relu3" type: "ReLU" bottom: "conv3" top: "relu3" }
layer { name: "descriptor" type: "Flatten" bottom: "relu3" top: "descriptor" }
"""


@pytest.fixture(scope="module")
def arrays() -> cases.Arrays:
    return cases.calc_arrays()


@pytest.fixture(scope="module")
def weights(arrays, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("calc") / "calc.npz"
    np.savez(path, **arrays)
    return path


@pytest.fixture(scope="module")
def calc(weights) -> CALC:
    return CALC(weights)


def encoder_with(arrays: cases.Arrays) -> CALCEncoder:
    encoder = CALCEncoder()
    encoder.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()})
    return encoder.eval()


def test_every_layer_is_as_plain_numpy_computes_it(arrays):
    grey = prepare_calc(cases.image())
    encoder = encoder_with(arrays)
    outputs: list[np.ndarray] = []
    for layer in (encoder.conv1, encoder.norm, encoder.conv2, encoder.conv3):
        layer.register_forward_hook(lambda _module, _in, out: outputs.append(out[0].numpy()))
    with torch.inference_mode():
        descriptor = encoder(torch.from_numpy(grey)[None])[0].numpy()
    expected = oracle.calc_layers(grey[0], arrays)
    outputs[-1] = np.maximum(outputs[-1], 0)  # of conv3, before the last ReLU
    assert len(outputs) == 5
    assert [out.shape for out in outputs] == [
        (64, 62, 82), (64, 31, 41), (128, 32, 42), (128, 16, 21), (4, 14, 19)
    ]  # fmt: skip
    for got, wanted in zip(outputs, expected[:-1], strict=True):
        np.testing.assert_allclose(got, wanted, rtol=1e-4, atol=1e-4 * np.abs(wanted).max())
    np.testing.assert_allclose(oracle.unit(descriptor), expected[-1], rtol=0, atol=1e-5)


def test_the_response_normalisation_matters_in_these_tests(arrays):
    layers = oracle.calc_layers(prepare_calc(cases.image())[0], arrays)
    pooled = oracle.pool_up(np.maximum(layers[0], 0), 3, 2)
    assert (layers[1].max() / pooled.max()) < 0.9


@pytest.mark.parametrize("old", [False, True])
def test_a_caffemodel_gives_what_caffes_rules_in_opencv_give(arrays, tmp_path, old):
    path = tmp_path / "calc.caffemodel"
    path.write_bytes(cases.caffemodel(arrays, old=old))
    net = cv2.dnn.readNetFromCaffe(
        np.frombuffer(DEPLOY.encode(), np.uint8), np.fromfile(path, np.uint8)
    )
    picture = cases.image(3)
    net.setInput(prepare_calc(picture)[None])
    expected = net.forward().ravel()
    got = CALC(path).describe(picture)
    assert expected.shape == got.shape == (1064,)
    np.testing.assert_allclose(got, expected / np.linalg.norm(expected), rtol=0, atol=2e-5)


def test_preparation_equalises_brightness_and_then_shrinks():
    picture = cases.image(5, 150, 210)
    yuv = cv2.cvtColor(picture, cv2.COLOR_BGR2YUV)
    counts = np.bincount(yuv[:, :, 0].ravel(), minlength=256)
    first = np.flatnonzero(counts)[0]
    ranks = np.cumsum(counts) - counts[first]
    table = np.rint(ranks * (255.0 / (yuv[:, :, 0].size - counts[first]))).clip(0)
    yuv[:, :, 0] = table[yuv[:, :, 0]]
    colour = cv2.cvtColor(yuv, cv2.COLOR_YUV2BGR).astype(float)
    grey = colour @ [0.114, 0.587, 0.299]
    expected = cv2.resize(np.rint(grey).astype(np.uint8), (160, 120), interpolation=2) / 255
    got = prepare_calc(picture)
    assert got.shape == (1, 120, 160)
    assert got.dtype == np.float32
    np.testing.assert_allclose(got[0], expected, atol=1.01 / 255)


def test_a_descriptor_has_length_one_and_the_same_bits_each_time(calc):
    pictures = [cases.image(seed) for seed in range(3)]
    first = [calc.describe(picture) for picture in pictures]
    again = [calc.describe(picture) for picture in reversed(pictures)][::-1]
    for one, other in zip(first, again, strict=True):
        assert one.shape == (1064,)
        assert one.dtype == np.float32
        assert np.linalg.norm(one) == pytest.approx(1, abs=1e-6)
        np.testing.assert_array_equal(one, other)
    scores = calc.match(first[0], np.stack(first))
    assert scores.argmax() == 0
    assert scores[0] == pytest.approx(1, abs=1e-5)
    np.testing.assert_array_equal(calc.describe_query(pictures[0]), first[0])


@pytest.mark.parametrize("value", [0, 255])
def test_an_image_of_one_colour_gives_finite_numbers(calc, value):
    assert np.isfinite(calc.describe(np.full((50, 60, 3), value, np.uint8))).all()


def test_a_network_that_gives_nothing_gives_zeros(tmp_path, arrays):
    silent = {**arrays, "conv3.bias": np.full(4, -1e6, np.float32)}
    save_file(silent, tmp_path / "silent.safetensors")
    descriptor = CALC(tmp_path / "silent.safetensors").describe(cases.image())
    np.testing.assert_array_equal(descriptor, np.zeros(1064, np.float32))


@pytest.mark.parametrize(
    "wrong",
    [
        np.zeros((9, 9), np.uint8),
        np.zeros((9, 9, 4), np.uint8),
        np.zeros((9, 9, 3)),
        np.zeros((0, 9, 3), np.uint8),
        None,
    ],
)
def test_what_is_no_image_is_refused(calc, wrong):
    with pytest.raises(ValueError, match=r"give \(height, width, 3\) uint8"):
        calc.describe(wrong)


def test_it_pickles_and_copies_whole(calc, weights, arrays, tmp_path):
    path = tmp_path / "calc.npz"
    np.savez(path, **arrays)
    original = CALC(path)
    stored = pickle.dumps(original)
    path.unlink()
    for other in (pickle.loads(stored), copy.deepcopy(original)):
        assert other.parameters() == original.parameters()
        np.testing.assert_array_equal(
            other.describe(cases.image(1)), original.describe(cases.image(1))
        )


def test_the_digest_of_the_weights_is_among_the_parameters(calc, weights, tmp_path):
    changed = cases.calc_arrays()
    changed["conv2.bias"][0] += 1e-3
    np.savez(tmp_path / "changed.npz", **changed)
    other = CALC(tmp_path / "changed.npz").parameters()
    assert other["weights"] != calc.parameters()["weights"]
    assert CALC(weights).parameters() == calc.parameters()
    assert len(calc.parameters()["weights"]) == 64


def test_loading_draws_no_random_numbers_and_sets_no_threads(weights):
    before = torch.get_rng_state(), torch.get_num_threads()
    CALC(weights)
    assert torch.equal(torch.get_rng_state(), before[0])
    assert torch.get_num_threads() == before[1]


def test_the_registry_makes_it_with_weights(weights):
    assert make_technique("CALC", weights).name == "CALC"


def test_saved_weights_come_back_and_the_same_weights_give_the_same_bytes(arrays, tmp_path, calc):
    encoder = encoder_with(arrays)
    path = save_calc(tmp_path / "calc.safetensors", encoder, training="random numbers")
    again = save_calc(tmp_path / "again.safetensors", encoder, training="random numbers")
    assert path.read_bytes() == again.read_bytes()
    assert b"random numbers" in path.read_bytes()
    picture = cases.image(2)
    np.testing.assert_array_equal(CALC(path).describe(picture), calc.describe(picture))


def test_half_precision_takes_half_the_room_and_is_nearly_the_same(arrays, tmp_path, calc):
    encoder = encoder_with(arrays)
    small = save_calc(tmp_path / "half.safetensors", encoder, training="", half=True)
    assert small.stat().st_size < 140_000 * 2.1
    technique = CALC(small)
    assert technique.describe(cases.image()).dtype == np.float32
    assert calc.describe(cases.image()) @ technique.describe(cases.image()) > 0.9999


def test_weights_that_half_precision_cannot_hold_are_not_saved(arrays, tmp_path):
    encoder = encoder_with({**arrays, "conv1.bias": np.full(64, 1e6, np.float32)})
    with pytest.raises(ValueError, match=r"conv1\.bias .* save without half"):
        save_calc(tmp_path / "calc.safetensors", encoder, training="", half=True)
    with pytest.raises(ValueError, match="should end in .safetensors"):
        save_calc(tmp_path / "calc.pth", encoder, training="")
    assert list(tmp_path.iterdir()) == []


def natural_order(folder: Path) -> list[Path]:
    def key(path: Path) -> list[int]:
        return [int(digits) for digits in re.findall(r"\d+", path.name)]

    return sorted(folder.iterdir(), key=key)


def test_corridors_stored_scores_come_out_with_the_public_weights():
    data = corridor.data_folder()
    calc = CALC(data / "calc" / "calc_weights.npz")

    def described(name: str) -> np.ndarray:
        files = natural_order(data / "corridor" / name)
        return np.stack([calc.describe(cv2.imread(str(file))) for file in files])

    queries, references = described("query"), described("reference")
    scores = np.stack([calc.match(query, references) for query in queries])
    stored = np.load(data / "corridor" / "scores" / "CALC.npy")
    assert np.corrcoef(scores.ravel(), stored.ravel())[0, 1] >= 0.9995
    assert np.abs(scores - stored).max() <= 0.003
    assert (scores.argmax(1) == stored.argmax(1)).mean() >= 0.98
