"""R-MAC: the authors' regions, symmetry, whitening and degenerate maps."""

from __future__ import annotations

import network_oracle as oracle
import numpy as np
import pytest
import technique_files
import torch
import weight_cases
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

from amusic_gym.techniques import make_technique
from amusic_gym.techniques.rmac import RMAC, SETTINGS, regions

TABLE = {  # height, width -> side, rows, columns of each level
    (7, 7): [(7, [0], [0]), (4, [0, 3], [0, 3]), (3, [0, 2, 4], [0, 2, 4])],
    (13, 13): [(13, [0], [0]), (8, [0, 5], [0, 5]), (6, [0, 3, 7], [0, 3, 7])],
    (15, 20): [
        (15, [0], [0, 5]),
        (10, [0, 5], [0, 5, 10]),
        (7, [0, 4, 8], [0, 4, 8, 13]),
    ],
}


@pytest.mark.parametrize("shape", TABLE)
@pytest.mark.parametrize("turned", [False, True])
def test_regions_are_those_of_the_authors_program(shape, turned):
    expected = {
        (column, row, side) if turned else (row, column, side)
        for side, rows, columns in TABLE[shape]
        for row in rows
        for column in columns
    }
    found = list(regions(*(shape[::-1] if turned else shape)))
    assert set(found) == expected
    assert len(found) == len(expected)


@pytest.mark.parametrize(
    ("shape", "count"), [((7, 7), 14), ((13, 13), 14), ((8, 10), 20), ((15, 20), 20)]
)
def test_number_of_regions(shape, count):
    assert len(list(regions(*shape))) == count


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 5))
def test_regions_lie_inside_the_map_and_the_first_touch_its_edges(height, width, levels):
    found = list(regions(height, width, levels))
    assert all(r >= 0 and c >= 0 and s >= 1 for r, c, s in found)
    assert max(r + s for r, _, s in found) == height
    assert max(c + s for _, c, s in found) == width
    assert max(s for *_, s in found) == min(height, width)


def features(height, width, channels=5, seed=0):
    return torch.rand((1, channels, height, width), generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("whole", [False, True])
def test_the_descriptor_is_the_sum_over_regions(whole):
    x = features(8, 10)
    expected = np.zeros(5)
    places = [*regions(8, 10), *([(0, 0, 99)] if whole else [])]
    for row, column, side in places:
        part = x[0, :, row : row + side, column : column + side].numpy()
        maximum = np.array([channel.max() for channel in part])
        expected += maximum / np.linalg.norm(maximum)
    got = RMAC(whole=whole)(x)[0].numpy()
    np.testing.assert_allclose(got, expected / np.linalg.norm(expected), atol=1e-6)


def test_a_constant_map_gives_equal_values_and_zeros_give_zeros():
    np.testing.assert_allclose(RMAC()(torch.ones(1, 4, 9, 12)), np.full((1, 4), 0.5), atol=1e-6)
    assert not RMAC()(torch.zeros(1, 4, 9, 12)).any()
    half = torch.zeros(1, 4, 13, 13)
    half[:, :, 0, 0] = 1  # most regions are all zero
    assert RMAC()(half).isfinite().all()


@pytest.mark.parametrize(("size", "same"), [(7, True), (13, False)])
def test_mirrored_images_are_alike_where_the_regions_are_symmetric(size, same):
    x = features(size, size, channels=64)
    x = x * (x > 0.97)
    near = torch.allclose(RMAC()(x), RMAC()(x.flip(3)), atol=1e-6)
    assert near == same


def test_each_map_of_a_batch_is_pooled_by_itself():
    one, other = features(6, 9, seed=1), features(6, 9, seed=2)
    both = RMAC()(torch.cat([one, other]))
    torch.testing.assert_close(both, torch.cat([RMAC()(one), RMAC()(other)]))
    assert not torch.allclose(both[0], both[1])


def test_whitening_goes_between_two_normalisations(tmp_path):
    rng = np.random.default_rng(0)
    mean, projection = rng.normal(size=5).astype("f4"), rng.normal(size=(5, 3)).astype("f4")
    np.savez(tmp_path / "w.npz", mean=mean, projection=projection)
    made = RMAC.of(5, **{**SETTINGS, "whitening": str(tmp_path / "w.npz"), "levels": 2})
    x = features(6, 6)
    expected = np.zeros(3)
    for row, column, side in regions(6, 6, 2):
        part = x[0, :, row : row + side, column : column + side].flatten(1).amax(1).numpy()
        turned = (part / np.linalg.norm(part) - mean) @ projection
        expected += turned / np.linalg.norm(turned)
    np.testing.assert_allclose(made(x)[0], expected / np.linalg.norm(expected), atol=1e-5)
    assert len(made.parameters()["whitening"]) == 64
    with pytest.raises(ValueError, match=r"layer mean of .* has shape \(5,\); R-MAC needs \(7\)"):
        RMAC.of(7, levels=3, whole=False, whitening=str(tmp_path / "w.npz"))
    with pytest.raises(ValueError, match="the levels of R-MAC is 0; give a whole number"):
        RMAC.of(5, levels=0, whole=False, whitening="")


# ---- on VGG16 and AlexNet ------------------------------------------------------------------

MEAN = (120.0, 110.0, 100.0)


def pooled(features):
    """Of a map by hand, (C, H, W)."""
    return RMAC()(torch.from_numpy(features).float()[None])[0].numpy()


def matlab_layers(path, convolutions, count):
    """A network as MatConvNet stores it: number -> weights (out, in, h, w) and bias."""
    layers = np.empty((1, count), dtype=object)
    for number in range(count):
        layers[0, number] = {"type": "other"}
        if number in convolutions:
            weights = np.empty((1, 2), dtype=object)
            kernel, bias = convolutions[number]
            weights[0, 0], weights[0, 1] = kernel.transpose(2, 3, 1, 0), bias[:, None]
            layers[0, number] = {"type": "conv", "weights": weights}
    colour = np.tile(np.array(MEAN, np.float32), (7, 7, 1))
    meta = {"normalization": {"averageImage": colour}}
    savemat(path, {"layers": layers, "meta": meta})
    return path


@pytest.mark.parametrize("prefix", ["", "features."])
def test_vgg16_of_pytorch_ends_after_the_last_relu(tmp_path, prefix):
    technique = make_technique("rmac", technique_files.vgg16(tmp_path, prefix))
    picture = weight_cases.image(1, 105, 120)
    x = picture[:, :, ::-1].astype(float) - np.array([0.485, 0.456, 0.406]) * 255
    x /= np.array([0.229, 0.224, 0.225]) * 255
    features = oracle.vgg16(x.transpose(2, 0, 1), weight_cases.netvlad_arrays(0))
    assert features.shape == (6, 6, 7)
    got = technique.describe(picture)
    np.testing.assert_allclose(got, pooled(np.maximum(features, 0)), atol=1e-5)


def test_vgg16_of_matconvnet_ends_after_the_last_pooling(tmp_path):
    arrays = weight_cases.netvlad_arrays(0, gain=0.9)
    layers = {
        number: (arrays[f"encoder.{number}.weight"], arrays[f"encoder.{number}.bias"])
        for number in weight_cases.VGG16_NUMBERS
    }
    technique = make_technique("rmac", matlab_layers(tmp_path / "vgg.mat", layers, 31))
    picture = weight_cases.image(1, 105, 120)
    x = picture[:, :, ::-1].astype(float) - np.array(MEAN)
    features = np.maximum(oracle.vgg16(x.transpose(2, 0, 1), arrays), 0)
    halved = features[:, :6, :6].reshape(6, 3, 2, 3, 2).max((2, 4))
    np.testing.assert_allclose(technique.describe(picture), pooled(halved), atol=1e-5)


def test_alexnet_of_matconvnet_normalises_before_it_pools(tmp_path):
    rng = np.random.default_rng(0)
    shapes = {0: (4, 3, 11, 11), 4: (6, 2, 5, 5), 8: (8, 6, 3, 3)}
    shapes |= {10: (8, 4, 3, 3), 12: (6, 4, 3, 3)}
    layers = {
        number: [(rng.normal(size=s) / np.prod(s[1:]) ** 0.5).astype("f4"), rng.normal(size=s[0])]
        for number, s in shapes.items()
    }
    technique = make_technique("rmac", matlab_layers(tmp_path / "alex.mat", layers, 15))
    picture = weight_cases.image(1, 120, 105)
    x = (picture[:, :, ::-1].astype(float) - np.array(MEAN)).transpose(2, 0, 1)

    def conv(x, number, pad, step=1, groups=1):
        kernel, bias = layers[number]
        parts = zip(*(np.split(each, groups) for each in (x, kernel, bias)), strict=True)
        return np.maximum(
            np.concatenate([oracle.convolve(a, b, c, pad, step) for a, b, c in parts]), 0
        )

    def pool(x):
        rows, columns = ((n - 3) // 2 * 2 + 3 for n in x.shape[1:])
        return oracle.pool_up(x[:, :rows, :columns], 3, 2)

    x = pool(oracle.normalise_response(conv(x, 0, 0, 4)))
    x = pool(oracle.normalise_response(conv(x, 4, 2, groups=2)))
    x = conv(conv(conv(x, 8, 1), 10, 1, groups=2), 12, 1, groups=2)
    np.testing.assert_allclose(technique.describe(picture), pooled(pool(x)), atol=1e-5)


def test_settings_weights_and_cache_key(tmp_path):
    path = technique_files.vgg16(tmp_path)
    plain, other = make_technique("rmac", path), make_technique("rmac:levels=2:whole=yes", path)
    assert plain.parameters() != other.parameters()
    picture = weight_cases.image()
    assert not np.allclose(plain.describe(picture), other.describe(picture))
    with pytest.raises(ValueError, match="needs weights of VGG16 or AlexNet.*--weights rmac="):
        make_technique("rmac")
    np.savez(tmp_path / "w.npz", other=np.ones(3))
    with pytest.raises(ValueError, match=r"no layer 28\.weight, which R-MAC needs"):
        make_technique("rmac", tmp_path / "w.npz")
