"""AMOSNet and HybridNet: Caffe's rules in OpenCV, the pyramid's cells, files and the score."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
import torch
from corridor import data_folder
from recordings import ROUTES, accuracy, read_folder
from technique_files import amosnet, amosnet_layers
from weight_cases import image

from amusic_gym.techniques import make_technique
from amusic_gym.techniques.amosnet import MEAN, PlaceNetwork, spatial_pyramid


def convolution(name, below, *settings):
    return (
        f'layer {{ name: "{name}" type: "Convolution" bottom: "{below}" top: "{name}" '
        f"convolution_param {{ {' '.join(settings)} }} }}\n"
        f'layer {{ name: "r{name}" type: "ReLU" bottom: "{name}" top: "{name}" }}\n'
    )


def pooled(number):
    """Max-pooling, then the normalisation across channels."""
    return (
        f'layer {{ name: "p{number}" type: "Pooling" bottom: "conv{number}" top: "p{number}" '
        "pooling_param { pool: MAX kernel_size: 3 stride: 2 } }\n"
        f'layer {{ name: "n{number}" type: "LRN" bottom: "p{number}" top: "n{number}" '
        "lrn_param { local_size: 5 alpha: 0.0001 beta: 0.75 } }\n"
    )


DEPLOY = "".join(
    [
        'input: "data" input_dim: 1 input_dim: 3 input_dim: 227 input_dim: 227\n',
        convolution("conv1", "data", "num_output: 96 kernel_size: 11 stride: 4"),
        pooled(1),
        convolution("conv2", "n1", "num_output: 256 kernel_size: 5 pad: 2 group: 2"),
        pooled(2),
        convolution("conv3", "n2", "num_output: 384 kernel_size: 3 pad: 1"),
        convolution("conv4", "conv3", "num_output: 384 kernel_size: 3 pad: 1 group: 2"),
        convolution("conv5", "conv4", "num_output: 256 kernel_size: 3 pad: 1 group: 2"),
    ]
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return amosnet(tmp_path_factory.mktemp("amosnet"))


def by_hand(features):
    """(C, 13, 13) -> (C, 30), each cell written out."""
    found = [features.max((1, 2))]
    for edges in ([(0, 6), (7, 12)], [(0, 4), (5, 8), (9, 12)], [(0, 3), (4, 6), (7, 9), (10, 12)]):
        for top, bottom in edges:
            for left, right in edges:
                found.append(features[:, top:bottom, left:right].max((1, 2)))
    return np.stack(found, axis=1)


def test_a_caffemodel_gives_what_caffes_rules_in_opencv_give(weights):
    net = cv2.dnn.readNetFromCaffe(
        np.frombuffer(DEPLOY.encode(), np.uint8), np.fromfile(weights, np.uint8)
    )
    picture = image(3)
    prepared = cv2.resize(picture, (227, 227)).astype(np.float32) - np.array(MEAN, np.float32)
    net.setInput(np.ascontiguousarray(prepared.transpose(2, 0, 1)[None]))
    features = net.forward("conv5")[0]
    features = np.maximum(features, 0)
    assert features.shape == (256, 13, 13)
    got = make_technique("amosnet", weights).describe(picture)
    expected = by_hand(features)
    assert expected.std() > 0
    np.testing.assert_allclose(got.reshape(256, 30), expected, atol=1e-4 * expected.max())


def test_layers_come_back_as_they_were_written(weights):
    network = make_technique("amosnet", weights)._network
    for name, arrays in amosnet_layers().items():
        if name.startswith("conv"):
            layer = getattr(network, name)
            np.testing.assert_array_equal(layer.weight, arrays[0])
            np.testing.assert_array_equal(layer.bias, arrays[1])


@pytest.mark.parametrize("row", range(13))
@pytest.mark.parametrize("column", [0, 3, 5, 6, 9, 12])
def test_one_value_hits_exactly_its_cells(row, column):
    features = torch.zeros(2, 13, 13)
    features[1, row, column] = 1
    found = spatial_pyramid(features).numpy()
    assert not found[0].any()
    np.testing.assert_array_equal(found, by_hand(features.numpy()))


def test_the_last_row_belongs_to_the_whole_only():
    features = torch.zeros(3, 13, 13)
    features[:, 12] = 1
    found = spatial_pyramid(features)
    assert found.shape == (3, 30)
    assert found[:, 0].all()
    assert not found[:, 1:].any()


def test_the_network_has_the_published_number_of_weights():
    with torch.device("meta"):
        network = PlaceNetwork()
    assert sum(tensor.numel() for tensor in network.parameters()) == 2_334_080
    assert network(torch.zeros(1, 3, 227, 227, device="meta")).shape == (1, 256, 13, 13)


def test_the_score_is_one_for_the_same_image_and_falls_with_the_distance(weights):
    technique = make_technique("hybridnet", weights)
    assert technique.name == "HybridNet"
    one, other = technique.describe(image(1)), technique.describe(image(2))
    scores = technique.match(one, np.stack([one, other]))
    assert scores[0] == 1
    expected = 1 - np.abs(one.astype(float) - other).sum() / (256 * 256)
    assert scores[1] == pytest.approx(expected, abs=1e-6)


def test_a_mean_image_stands_in_for_the_mean_colour(weights, tmp_path):
    flat = np.broadcast_to(np.array(MEAN)[:, None, None], (3, 256, 256)).copy()
    np.save(tmp_path / "mean.npy", flat)
    plain, by_file = (
        make_technique(name, weights) for name in ("amosnet", f"amosnet:mean={tmp_path}/mean.npy")
    )
    picture = image(1)
    np.testing.assert_allclose(by_file.describe(picture), plain.describe(picture), atol=1e-3)
    assert by_file.parameters() != plain.parameters()
    np.save(tmp_path / "mean.npy", flat + np.arange(256))
    sloped = make_technique(f"amosnet:{tmp_path}/mean.npy", weights)
    assert np.abs(sloped.describe(picture) - plain.describe(picture)).max() > 0.1
    np.save(tmp_path / "mean.npy", np.zeros((256, 256)))
    with pytest.raises(ValueError, match=r"mean image .* shape \(256, 256\); give \(3, H, W\)"):
        make_technique(f"amosnet:{tmp_path}/mean.npy", weights)


def test_without_weights_or_with_others_it_is_refused(tmp_path):
    with pytest.raises(ValueError, match="needs its authors' weights.*--weights hybridnet="):
        make_technique("hybridnet")
    np.savez(tmp_path / "w.npz", **{"conv1.weight": np.ones((64, 1, 5, 5), np.float32)})
    with pytest.raises(ValueError, match=r"layer conv1\.weight .* AMOSNet needs \(96, 3, 11, 11\)"):
        make_technique("amosnet", tmp_path / "w.npz")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "expected"), [("AMOSNet", 0.847), ("HybridNet", 0.901)])
def test_corridors_stored_scores_come_out_with_the_authors_weights(name, expected):
    data = data_folder("corridor")
    file = {"AMOSNet": "AmosNet", "HybridNet": "HybridNet"}[name]
    weights, mean = (data / "amosnet" / each for each in (f"{file}.caffemodel", "amosnet_mean.npy"))
    if not (weights.is_file() and mean.is_file()):
        pytest.skip(f"AMUSIC_DATA holds no amosnet/{weights.name} with {mean.name}")
    technique = make_technique(f"{name}:mean={mean}", weights)
    assert accuracy(technique, "corridor") == pytest.approx(expected, abs=0.02)
    places, run = (read_folder(data / each) for each in ROUTES["corridor"])
    references = np.stack([technique.describe(each) for each in places])
    scores = np.stack([technique.match(technique.describe(each), references) for each in run])
    stored = np.load(data / "corridor" / "scores" / f"{name}.npy")
    assert np.corrcoef(scores.ravel(), stored.ravel())[0, 1] >= 0.99
