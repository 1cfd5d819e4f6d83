"""NetVLAD against plain NumPy, for each family of weights and for the compact network."""

from __future__ import annotations

import json
import pickle
from pathlib import Path

import cv2
import network_oracle as oracle
import numpy as np
import pytest
import torch
import weight_cases as cases
from safetensors.numpy import load_file, save_file
from torch import nn

from amusic_gym.techniques import make_technique, netvlad_weights
from amusic_gym.techniques.netvlad import NetVLAD
from amusic_gym.techniques.networks import (
    NetVLADNetwork,
    NetVLADWidths,
    conv_layers,
)
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.saved_weights import save_netvlad
from amusic_gym.techniques.weight_files import read_weights

SMALL = Preparation(width=64, height=48, interpolation="cubic")
COMPACT = NetVLADWidths(stages=((4,), (6, 5)), clusters=3, whitened=7)
IMAGENET = (np.array([0.485, 0.456, 0.406]) * 255, np.array([0.229, 0.224, 0.225]) * 255)
MEAN = (120.0, 110.0, 100.0)


@pytest.fixture(autouse=True)
def small_input(monkeypatch) -> None:
    """Public networks see 64×48 here, so that loops in plain NumPy come to an end."""
    monkeypatch.setattr(netvlad_weights, "PUBLIC_INPUT", SMALL)


def prepared(picture: np.ndarray, mean: np.ndarray, deviation: np.ndarray) -> np.ndarray:
    """Red, green, blue (3, 48, 64), as the weights expect them."""
    red_first = cv2.resize(picture, (64, 48), interpolation=cv2.INTER_CUBIC)[:, :, ::-1]
    return ((red_first - mean) / deviation).transpose(2, 0, 1)


def random_network(widths: NetVLADWidths = COMPACT, batch_norm: bool = False) -> NetVLADNetwork:
    torch.manual_seed(3)
    network = NetVLADNetwork(widths, batch_norm)
    for layer in network.backbone:
        if isinstance(layer, nn.BatchNorm2d):
            layer.running_mean.normal_()
            layer.running_var.uniform_(0.5, 2)
            nn.init.normal_(layer.weight, 1, 0.3)
            nn.init.normal_(layer.bias)
    return network.eval()


@pytest.mark.parametrize("bias", [False, True])
@pytest.mark.parametrize("whitened", [None, cases.WHITENED])
def test_pytorch_weights_give_what_plain_numpy_gives(tmp_path, whitened, bias):
    arrays = cases.netvlad_arrays(1, whitened, bias=bias)
    path = cases.save_torch(tmp_path / "netvlad.pth.tar", arrays, prefix="module.")
    for seed in range(3):
        picture = cases.image(seed)
        expected = oracle.netvlad(prepared(picture, *IMAGENET), arrays, descriptor_major=False)
        got = NetVLAD(path).describe(picture)
        assert got.shape == (whitened or cases.CLUSTERS * cases.CHANNELS,)
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, expected, rtol=0, atol=2e-5)


def test_parts_trained_in_parallel_are_found(tmp_path):
    arrays = cases.netvlad_arrays()
    split = {name.replace(".", ".module.", 1): array for name, array in arrays.items()}
    assert "pool.module.centroids" in split
    plain = NetVLAD(cases.save_torch(tmp_path / "plain.pth", arrays))
    parallel = NetVLAD(cases.save_torch(tmp_path / "parallel.pth", split))
    picture = cases.image()
    np.testing.assert_array_equal(parallel.describe(picture), plain.describe(picture))


@pytest.mark.parametrize("whitened", [None, cases.WHITENED])
def test_matlab_weights_give_what_plain_numpy_gives(tmp_path, whitened):
    arrays = cases.netvlad_arrays(2, whitened, gain=0.9)  # its input reaches ±130, not ±2
    path = cases.save_matlab(tmp_path / "struct.mat", arrays, MEAN)
    for seed in range(3):
        picture = cases.image(seed)
        x = prepared(picture, np.array(MEAN), np.ones(3))
        expected = oracle.netvlad(x, arrays, descriptor_major=True)
        np.testing.assert_allclose(NetVLAD(path).describe(picture), expected, rtol=0, atol=2e-5)


def test_the_orders_of_flattening_differ_and_each_family_has_its_own(tmp_path):
    arrays = cases.netvlad_arrays(2)
    x = prepared(cases.image(), *IMAGENET)
    by_cluster = oracle.netvlad(x, arrays, descriptor_major=False)
    by_descriptor = oracle.netvlad(x, arrays, descriptor_major=True)
    assert abs(by_cluster @ by_descriptor) < 0.9
    matlab = NetVLAD(cases.save_matlab(tmp_path / "struct.mat", arrays))
    pytorch = NetVLAD(cases.save_torch(tmp_path / "checkpoint.pth.tar", arrays))
    assert matlab.parameters()["descriptor_major"] is True
    assert pytorch.parameters()["descriptor_major"] is False


FAMILIES = {  # family -> NetVLAD's layer, VGG16, whitening; mean and deviation; ending
    "OpenIBL": ("net_vlad", "base_model.base", "pca_layer", "pth"),
    "deep-vg-benchmark": ("aggregation.0", "backbone", "aggregation.2", "pth"),
    "OpenVPRLab": ("aggregation", "backbone", "", "ckpt"),
    "OpenVPRLab, new": ("aggregator", "backbone", "", "ckpt"),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_weights_of_other_projects_give_what_plain_numpy_gives(tmp_path, family):
    pool, backbone, whitening, ending = FAMILIES[family]
    openibl = family == "OpenIBL"
    colours = (np.array([123.68, 116.779, 103.939]), np.ones(3)) if openibl else IMAGENET
    arrays = cases.netvlad_arrays(
        4, cases.WHITENED if whitening else None, gain=0.9 if openibl else 1.4
    )
    starts = {"encoder": backbone, "pool": pool, "WPCA.0": whitening}
    renamed = {}
    for name, array in arrays.items():
        start = next(each for each in starts if name.startswith(each))
        renamed[starts[start] + name.removeprefix(start)] = array
    path = cases.save_torch(tmp_path / f"netvlad.{ending}", renamed, prefix="module.")
    picture = cases.image(3)
    expected = oracle.netvlad(prepared(picture, *colours), arrays, descriptor_major=False)
    np.testing.assert_allclose(NetVLAD(path).describe(picture), expected, rtol=0, atol=2e-5)


def test_a_network_on_another_backbone_is_refused_with_what_was_found(tmp_path):
    other = {
        "aggregation.centroids": np.ones((4, 6), np.float32),
        "aggregation.conv.weight": np.ones((4, 6, 1, 1), np.float32),
        "backbone.layer1.0.conv1.weight": np.ones((6, 3, 3, 3), np.float32),
    }
    path = cases.save_torch(tmp_path / "resnet.ckpt", other)
    with pytest.raises(ValueError, match=r"no layer backbone\.0\.weight.* it holds .*backbone\.l"):
        NetVLAD(path)


def test_layer_by_layer(tmp_path):
    arrays = cases.netvlad_arrays(4, bias=True)
    path = cases.save_torch(tmp_path / "netvlad.pth", arrays)
    network, _ = netvlad_weights.load_netvlad(read_weights(path))
    x = prepared(cases.image(), *IMAGENET)
    with torch.inference_mode():
        features = network.backbone(torch.from_numpy(x).float()[None])
        residuals = network.pool(features)[0].numpy()
        flat = network.aggregate(torch.from_numpy(x).float()[None])[0].numpy()
    expected = oracle.vgg16(x, arrays)
    assert features.shape == (1, cases.CHANNELS, 3, 4)
    assert (expected < 0).any()  # no ReLU after conv5_3
    np.testing.assert_allclose(features[0].numpy(), expected, rtol=1e-4, atol=1e-5)
    words = oracle.vlad(expected, arrays)
    assert words.shape == residuals.shape == (cases.CLUSTERS, cases.CHANNELS)
    np.testing.assert_allclose(residuals, words, rtol=0, atol=2e-5)
    np.testing.assert_allclose(flat, words.ravel() / np.sqrt(cases.CLUSTERS), rtol=0, atol=2e-5)


def test_the_backbone_is_numbered_as_vgg16():
    channels = ((64, 64), (128, 128), (256, 256, 256), (512, 512, 512), (512, 512, 512))
    with torch.device("meta"):
        layers = conv_layers(channels)
    convolutions = [i for i, layer in enumerate(layers) if isinstance(layer, nn.Conv2d)]
    stages = netvlad_weights.VGG16_LAYERS
    assert convolutions == [i for stage in stages for i in stage]
    assert [len(stage) for stage in stages] == [len(stage) for stage in channels]
    assert sum(isinstance(layer, nn.MaxPool2d) for layer in layers) == 4
    assert layers[-1].weight.shape == (512, 512, 3, 3)


def test_public_weights_see_640_by_480(tmp_path, monkeypatch):
    monkeypatch.undo()
    path = cases.save_torch(tmp_path / "netvlad.pth", cases.netvlad_arrays())
    technique = NetVLAD(path)
    assert technique.parameters()["width"] == 640
    assert technique.parameters()["height"] == 480
    assert technique.parameters()["interpolation"] == "cubic"
    assert technique.describe(cases.image()).shape == (cases.WHITENED,)


def test_preparation_is_red_first_and_standardised():
    flat = np.empty((30, 40, 3), np.uint8)
    flat[:] = (10, 20, 30)  # blue, green, red
    x = Preparation(8, 6, mean=(1, 2, 3), deviation=(2, 4, 8)).apply(flat)
    assert x.shape == (3, 6, 8)
    assert x.dtype == np.float32
    for channel, value in zip(x, (29 / 2, 18 / 4, 7 / 8), strict=True):
        assert (channel == value).all()
    picture = cases.image()
    kinds = {kind: Preparation(16, 12, interpolation=kind).apply(picture)
             for kind in ("cubic", "linear", "area")}  # fmt: skip
    assert len({kind.tobytes() for kind in kinds.values()}) == 3


@pytest.mark.parametrize(
    ("wrong", "sentence"),
    [
        ({"width": 0}, "width is 0"),
        ({"height": 2.5}, "height is 2.5"),
        ({"deviation": (1, 0, 1)}, "numbers above 0"),
        ({"mean": (1, 2)}, "give red, green and blue"),
        ({"mean": (1, 2, float("nan"))}, "give red, green and blue"),
        ({"interpolation": "cubik"}, "did you mean 'cubic'"),
    ],
)
def test_a_preparation_that_makes_no_image_is_refused(wrong, sentence):
    with pytest.raises(ValueError, match=sentence):
        Preparation(**wrong)


@pytest.mark.parametrize(
    "wrong",
    [{"stages": ()}, {"stages": ((4,), ())}, {"stages": ((0,),)}, {"clusters": 0},
     {"clusters": True}, {"whitened": 0}, {"whitened": 1 << 30}],
)  # fmt: skip
def test_widths_of_no_network_are_refused(wrong):
    with pytest.raises(ValueError, match="give"):
        NetVLADWidths(**wrong)


@pytest.mark.parametrize("half", [False, True])
@pytest.mark.parametrize("widths", [COMPACT, NetVLADWidths(((5,),), 2, None, True, True)])
def test_a_compact_network_comes_back_with_its_widths_and_its_input(tmp_path, widths, half):
    network = random_network(widths)
    preparation = Preparation(80, 60, mean=(100, 101, 102), deviation=(50, 51, 52))
    path = tmp_path / "netvlad.safetensors"
    save_netvlad(path, network, preparation, training="random numbers", half=half)
    loaded, stored = netvlad_weights.load_netvlad(read_weights(path))
    assert loaded.widths == widths
    assert stored == preparation
    technique = NetVLAD(path)
    with torch.inference_mode():
        x = torch.from_numpy(preparation.apply(cases.image()))[None]
        expected = network(x)[0].numpy()
    got = technique.describe(cases.image())
    assert got.shape == (widths.whitened or widths.flat,)
    assert np.linalg.norm(got) == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(got, expected, rtol=0, atol=2e-3 if half else 1e-5)
    kinds = {array.dtype for array in load_file(path).values()}
    assert kinds == {np.dtype(np.float16 if half else np.float32)}


def test_the_default_compact_network_fits_what_may_ship(tmp_path):
    path = tmp_path / "netvlad.safetensors"
    save_netvlad(path, NetVLADNetwork(), Preparation(), training="none")
    assert path.stat().st_size <= 3.3e6
    assert NetVLAD(path).describe(cases.image()).shape == (256,)


def test_batch_normalisation_is_folded_into_the_convolutions(tmp_path):
    network = random_network(batch_norm=True)
    x = torch.randn(2, 3, 24, 32)
    with torch.inference_mode():
        expected, got = network(x), network.folded()(x)
    assert not any(isinstance(layer, nn.BatchNorm2d) for layer in network.folded().modules())
    torch.testing.assert_close(got, expected, rtol=0, atol=1e-5)
    path = save_netvlad(tmp_path / "n.safetensors", network, SMALL, training="")
    with torch.inference_mode():
        expected = network(torch.from_numpy(SMALL.apply(cases.image()))[None])[0].numpy()
    np.testing.assert_allclose(NetVLAD(path).describe(cases.image()), expected, atol=1e-5)


def test_gradients_reach_every_layer_in_training():
    network = NetVLADNetwork(COMPACT, batch_norm=True)
    network(torch.randn(2, 3, 24, 32))[:, 0].sum().backward()
    assert all(parameter.grad is not None for parameter in network.parameters())
    assert network.pool.centroids.grad.abs().sum() > 0


def test_it_is_deterministic_and_pickles_whole(tmp_path):
    path = save_netvlad(tmp_path / "n.safetensors", random_network(), SMALL, training="")
    technique = NetVLAD(path)
    stored = pickle.dumps(technique)
    path.unlink()
    other = pickle.loads(stored)
    pictures = [cases.image(seed) for seed in range(3)]
    first = [technique.describe(picture) for picture in pictures]
    for picture, descriptor in zip(pictures[::-1], first[::-1], strict=True):
        np.testing.assert_array_equal(technique.describe(picture), descriptor)
        np.testing.assert_array_equal(other.describe(picture), descriptor)
    assert other.parameters() == technique.parameters()
    scores = technique.match(first[1], np.stack(first))
    assert scores.argmax() == 1


def test_an_image_of_one_colour_gives_finite_numbers(tmp_path):
    path = save_netvlad(tmp_path / "n.safetensors", random_network(), SMALL, training="")
    for value in (0, 255):
        picture = np.full((20, 30, 3), value, np.uint8)
        assert np.isfinite(NetVLAD(path).describe(picture)).all()


def test_what_is_no_image_is_refused(tmp_path):
    path = save_netvlad(tmp_path / "n.safetensors", random_network(), SMALL, training="")
    with pytest.raises(ValueError, match=r"give \(height, width, 3\) uint8"):
        NetVLAD(path).describe(np.zeros((9, 9), np.uint8))


def test_the_registry_makes_it_with_weights(tmp_path):
    path = save_netvlad(tmp_path / "n.safetensors", random_network(), SMALL, training="")
    assert make_technique("netvlad", path).name == "NetVLAD"


def test_the_docstring_says_that_scores_were_never_compared():
    assert "ever compared with published ones" in " ".join(NetVLAD.__doc__.split())


def rewritten(path: Path, **changes: object) -> Path:
    """A file in our layout with other metadata."""
    network = random_network()
    save_netvlad(path, network, SMALL, training="")
    found = json.loads(read_weights(path).metadata["amusic_gym"]) | changes
    save_file(load_file(path), path, {"amusic_gym": json.dumps(found)})
    return path


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"widths": {"stages": [[4], [6, 5]], "clusters": 3, "depth": 1}}, "metadata .* damaged"),
        ({"widths": None}, "metadata .* damaged"),
        ({"preparation": {}}, "metadata .* damaged"),
        ({"widths": {"stages": [[4], [6, 6]], "clusters": 3, "whitened": 7}},
         r"layer backbone\.5\.weight .* shape \(5, 6, 3, 3\); NetVLAD needs \(6, 6, 3, 3\)"),
        ({"widths": {"stages": [[4], [6, 5]], "clusters": 3, "whitened": 7,
                     "assignment_bias": True}}, r"no layer pool\.assignment\.bias"),
        ({"format_version": 99}, "format version 99, this amusic-gym reads up to 1"),
        ({"format_version": None}, "damaged"),
        ({"technique": "CALC"}, "holds weights of CALC, its first layer is"),
    ],
)  # fmt: skip
def test_metadata_that_does_not_fit_is_refused(tmp_path, changes, sentence):
    path = rewritten(tmp_path / "netvlad.safetensors", **changes)
    with pytest.raises(ValueError, match=sentence):
        NetVLAD(path)


def test_a_matlab_file_without_its_mean_colour_is_refused(tmp_path):
    path = cases.save_matlab(tmp_path / "struct.mat", cases.netvlad_arrays(), np.empty((0, 3)))
    with pytest.raises(ValueError, match="no mean colour .*averageImage"):
        NetVLAD(path)
