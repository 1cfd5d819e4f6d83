"""EfficientNet-Lite0 against the network of its authors' package; the optional part."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest
import torch
from recordings import accuracy
from weight_cases import image

from amusic_gym.techniques import effnet, make_technique
from amusic_gym.techniques.rmac import RMAC

needs_weights = pytest.mark.skipif(
    importlib.util.find_spec(effnet.PACKAGE) is None,
    reason=f"needs the weights of EfficientNet-Lite0: {effnet.INSTALL}",
)


def random_state(block=3):
    """A state dictionary of the first blocks, as the published file names its tensors."""
    torch.manual_seed(0)
    network = effnet.EfficientNetLite0(block)
    return {
        name: torch.rand_like(tensor) if tensor.is_floating_point() else tensor
        for name, tensor in network.state_dict().items()
    }


@needs_weights
@pytest.mark.parametrize("size", [(224, 224), (97, 130)])
def test_feature_maps_are_the_packages_to_the_last_bit(size):
    theirs = pytest.importorskip("efficientnet_lite_pytorch").EfficientNet
    theirs = theirs.from_name("efficientnet-lite0", image_size=None).eval()
    path = effnet._installed().path
    theirs.load_state_dict(torch.load(path, weights_only=True))
    theirs.to(memory_format=torch.channels_last)
    x = torch.randn(1, 3, *size)
    with torch.inference_mode():
        expected = theirs._swish(theirs._bn0(theirs._conv_stem(x)))
        for number, block in enumerate(theirs._blocks):
            expected = block(expected)
            if number in (0, 4, 10, 15):
                ours = make_technique(f"effnet:{number}")._network
                assert torch.equal(ours(x), expected)


@needs_weights
def test_the_descriptor_is_the_prepared_images_feature_map():
    technique, picture = make_technique("effnet"), image(1)
    x = effnet.INPUT.apply(picture)[None]
    assert x.shape == (1, 3, 224, 224)
    assert x.abs().max() <= 1
    with torch.inference_mode():
        features = technique._network(x)
    assert features.shape == (1, 320, 7, 7)
    flat = features.flatten().numpy()
    expected = flat / np.linalg.norm(flat)
    np.testing.assert_allclose(technique.describe(picture), expected, atol=1e-6)
    pooled = RMAC()(features)[0].numpy()
    np.testing.assert_allclose(make_technique("effnet-rmac").describe(picture), pooled, atol=1e-6)


@needs_weights
def test_nothing_of_the_package_is_run(monkeypatch):
    monkeypatch.setattr("builtins.__import__", refusing(effnet.PACKAGE, __import__))
    assert make_technique("effnet:0").name == "EffNet-0"


def refusing(package, importer):
    def imported(name, *rest, **more):
        assert name.partition(".")[0] != package
        return importer(name, *rest, **more)

    return imported


def test_a_missing_part_is_named_with_the_command(monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    for name in ("effnet", "effnet-rmac"):
        with pytest.raises(ValueError, match=r'install them: pip install "amusic-gym\[cnn\]"'):
            make_technique(name)


def test_a_changed_file_of_the_part_is_refused(monkeypatch, tmp_path):
    path = tmp_path / effnet.FILE
    path.parent.mkdir()
    torch.save(random_state(), path)
    spec = importlib.util.spec_from_loader(effnet.PACKAGE, None, is_package=True)
    spec.submodule_search_locations = [str(tmp_path)]
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: spec)
    with pytest.raises(ValueError, match="is another file than was published .*force-reinstall"):
        make_technique("effnet")


def test_a_file_of_ones_own_settings_and_cache_key(tmp_path):
    path = tmp_path / "weights.pth"
    torch.save(random_state(), path)
    one, other = make_technique("effnet:1", path), make_technique("effnet:block=3", path)
    assert (one.name, other.name) == ("EffNet-1", "EffNet-3")
    assert one.parameters() != other.parameters()
    assert len(one.parameters()["weights"]) == 64
    pooled = make_technique("effnet-rmac:2:whole=yes:levels=2", path)
    assert pooled.describe(image()).shape == (24,)
    assert dict(pooled.parameters())["levels"] == 2
    with pytest.raises(ValueError, match=r"no layer _blocks\.4\._expand_conv\.weight"):
        make_technique("effnet:4", path)
    torch.save({"other": torch.zeros(3)}, path)
    with pytest.raises(ValueError, match=r"no layer _conv_stem\.weight, which EffNet needs"):
        make_technique("effnet:1", path)


@needs_weights
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "recording", "expected"),
    [
        ("effnet", "corridor", 0.83),
        ("effnet", "gardens_night", 0.53),
        ("effnet-rmac", "corridor", 0.62),
    ],
)
def test_accuracy_on_recordings(name, recording, expected):
    assert accuracy(make_technique(name), recording) == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("effnet:16", "the block of EffNet is 16; give a whole number from 0 to 15"),
        ("effnet:x", "setting block is 'x'; give a whole number"),
        ("effnet:blok=3", "unknown setting of the technique 'blok': did you mean 'block'"),
        ("effnet:3:block=4", "setting block is given twice"),
        ("effnet-rmac:whole=maybe", "setting whole is 'maybe'; give yes or no"),
        ("effnet-rmac:1:2", "unknown setting of the technique '2'"),
    ],
)
def test_a_wrong_setting_is_refused(name, message):
    with pytest.raises(ValueError, match=message):
        make_technique(name)
