"""What the project promises of weights files: one test or more per row."""

from __future__ import annotations

import io
import os
import pickle
import socket
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
import weight_cases as cases
from safetensors.numpy import save_file

from amusic_gym.techniques import make_technique
from amusic_gym.techniques.calc import CALC
from amusic_gym.techniques.netvlad import NetVLAD
from amusic_gym.techniques.networks import NetVLADNetwork, NetVLADWidths
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.saved_weights import save_netvlad

ARRAYS = cases.calc_arrays()


class Evil:
    """Makes a folder when it is unpickled."""

    def __init__(self, target: Path) -> None:
        self.target = target

    def __reduce__(self) -> tuple[object, ...]:
        return os.mkdir, (str(self.target),)


def small_netvlad(path: Path) -> Path:
    network = NetVLADNetwork(NetVLADWidths(stages=((4,), (6,)), clusters=3, whitened=7))
    return save_netvlad(path, network, Preparation(32, 24), training="none")


@pytest.mark.parametrize("technique", ["calc", "netvlad"])
def test_24_a_pickled_object_where_an_array_is_expected_is_refused(tmp_path, technique):
    target = tmp_path / "ran"
    objects = np.empty(1, dtype=object)
    objects[0] = Evil(target)
    np.savez(tmp_path / "weights.npz", **{"conv1.weight": objects})
    (tmp_path / "bare.npz").write_bytes(pickle.dumps(Evil(target)))
    for name in ("weights.npz", "bare.npz"):
        with pytest.raises(ValueError, match=r"\.npz holds pickled Python objects, .* save plain"):
            make_technique(technique, tmp_path / name)
    assert not target.exists()


def test_25_a_changed_weights_file_changes_the_parameters(tmp_path):
    path = tmp_path / "calc.npz"
    np.savez(path, **ARRAYS)
    before = CALC(path).parameters()
    np.savez(path, **{**ARRAYS, "conv3.bias": ARRAYS["conv3.bias"] + np.float32(1e-6)})
    assert CALC(path).parameters() != before
    netvlad = small_netvlad(tmp_path / "a.safetensors")
    before = NetVLAD(netvlad).parameters()
    torch.manual_seed(8)
    assert NetVLAD(small_netvlad(netvlad)).parameters() != before


@pytest.mark.parametrize("technique", ["calc", "netvlad"])
@pytest.mark.parametrize("ending", [".pt", ".pth", ".pth.tar"])
def test_30_a_malicious_pytorch_file_is_refused_and_nothing_runs(tmp_path, technique, ending):
    target = tmp_path / "ran"
    path = tmp_path / f"weights{ending}"
    state = {name: torch.from_numpy(array) for name, array in ARRAYS.items()}
    for legacy in (False, True):
        torch.save({**state, "extra": Evil(target)}, path, _use_new_zipfile_serialization=legacy)
        with pytest.raises(
            ValueError, match=r"pickled object \(\w+\.mkdir\).* save the state_dict"
        ):
            make_technique(technique, path)
    path.write_bytes(pickle.dumps(Evil(target)))
    with pytest.raises(ValueError, match=r"weights\.pt"):
        make_technique(technique, path)
    assert not target.exists()
    pickle.loads(pickle.dumps(Evil(target)))
    assert target.exists()  # the trap does work


def test_30_a_zip_with_a_pickle_of_its_own_is_refused_and_nothing_runs(tmp_path):
    target = tmp_path / "ran"
    for name in ("archive/data.pkl", "data.pkl", "conv1.weight.npy"):
        for ending in (".pth", ".npz"):
            path = tmp_path / f"weights{ending}"
            content = pickle.dumps(Evil(target))
            if name.endswith(".npy"):
                content = cases.npy_header("|O", (1,)) + content
            with zipfile.ZipFile(path, "w") as archive:
                archive.writestr(name, content)
                archive.writestr("archive/version", "3\n")
                archive.writestr("archive/byteorder", "little")
            with pytest.raises(ValueError, match=r"weights\."):
                CALC(path)
    assert not target.exists()


def test_30_a_whole_module_and_torchscript_are_refused(tmp_path):
    torch.save(torch.nn.Linear(2, 2), tmp_path / "module.pth")
    with pytest.raises(ValueError, match=r"module\.pth holds a pickled object \(torch\.nn"):
        CALC(tmp_path / "module.pth")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("script/constants.pkl", pickle.dumps(()))
        archive.writestr("script/data.pkl", pickle.dumps(()))
        archive.writestr("script/version", "3\n")
        archive.writestr("script/code/__torch__.py", "import os")
    (tmp_path / "script.pt").write_bytes(stream.getvalue())
    with pytest.raises(ValueError, match=r"script\.pt"):
        CALC(tmp_path / "script.pt")


@pytest.mark.parametrize("layer", list(ARRAYS))
def test_31_a_layer_of_another_shape_is_named(tmp_path, layer):
    wrong = {**ARRAYS, layer: ARRAYS[layer][1:]}
    np.savez(tmp_path / "calc.npz", **wrong)
    pattern = rf"layer {layer} of .*calc\.npz has shape \(.*; CALC needs \(.*give weights of CALC"
    with pytest.raises(ValueError, match=pattern):
        CALC(tmp_path / "calc.npz")


@pytest.mark.parametrize("layer", list(ARRAYS))
def test_31_a_missing_layer_is_named(tmp_path, layer):
    np.savez(tmp_path / "calc.npz", **{name: ARRAYS[name] for name in ARRAYS if name != layer})
    with pytest.raises(ValueError, match=rf"calc\.npz has no layer {layer}, which CALC needs"):
        CALC(tmp_path / "calc.npz")


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_31_a_layer_with_nan_is_named(tmp_path, value):
    wrong = {name: array.copy() for name, array in ARRAYS.items()}
    wrong["conv2.weight"][5, 4, 3, 2] = value
    np.savez(tmp_path / "calc.npz", **wrong)
    with pytest.raises(ValueError, match=r"layer conv2\.weight of .* holds NaN or infinite"):
        CALC(tmp_path / "calc.npz")


def test_31_weights_of_another_technique_are_refused(tmp_path):
    np.savez(tmp_path / "calc.npz", **ARRAYS)
    with pytest.raises(
        ValueError, match=r"no layer pool\.centroids, which NetVLAD needs; it holds"
    ):
        NetVLAD(tmp_path / "calc.npz")
    path = cases.save_torch(tmp_path / "netvlad.pth.tar", cases.netvlad_arrays())
    with pytest.raises(ValueError, match=r"no layer conv1\.weight, which CALC needs; it holds"):
        CALC(path)
    with pytest.raises(ValueError, match=r"of NetVLAD, its first layer is \S+; give .* CALC"):
        CALC(small_netvlad(tmp_path / "own.safetensors"))
    save_file({}, tmp_path / "none.safetensors")
    with pytest.raises(ValueError, match="it holds no weights"):
        CALC(tmp_path / "none.safetensors")


NETVLAD_LAYERS = {
    "encoder.14.weight": "layers.14.weights.0",
    "encoder.28.bias": "layers.28.weights.1",
    "pool.conv.weight": "layers.30.weights.0",
    "pool.centroids": "layers.30.weights.1",
    "WPCA.0.weight": "layers.33.weights.0",
    "WPCA.0.bias": "layers.33.weights.1",
}


@pytest.mark.parametrize("layer", NETVLAD_LAYERS)
@pytest.mark.parametrize("family", ["pytorch", "matlab"])
def test_31_a_wrong_layer_of_netvlad_is_named_as_the_file_names_it(tmp_path, family, layer):
    arrays = cases.netvlad_arrays()
    array = arrays[layer]
    arrays[layer] = array[:, 1:] if array.ndim > 1 else array[1:]
    if family == "pytorch":
        path, name = cases.save_torch(tmp_path / "netvlad.pth", arrays), layer
    else:
        path, name = cases.save_matlab(tmp_path / "netvlad.mat", arrays), NETVLAD_LAYERS[layer]
    with pytest.raises(ValueError, match=r"of .*netvlad\.\w+ has shape \(.* NetVLAD needs") as seen:
        NetVLAD(path)
    also = {"pool.conv.weight", "pool.centroids", "layers.30.weights.0", "layers.30.weights.1"}
    named = str(seen.value).split(" ")[1]
    assert named == name or {named, name} <= also  # two layers that contradict each other


@pytest.mark.parametrize("layer", NETVLAD_LAYERS)
def test_31_a_missing_layer_of_netvlad_is_named(tmp_path, layer):
    arrays = cases.netvlad_arrays()
    del arrays[layer]
    path = cases.save_torch(tmp_path / "netvlad.pth", arrays)
    if layer == "WPCA.0.weight":  # then there is no whitening, and the bias is ignored
        assert NetVLAD(path).parameters()["descriptor_major"] is False
        return
    with pytest.raises(ValueError, match=rf"no layer {layer}, which NetVLAD needs"):
        NetVLAD(path)


def test_32_onnx_that_is_not_installed_is_named_with_the_command(tmp_path, monkeypatch):
    path = tmp_path / "calc.onnx"
    path.write_bytes(cases.onnx_bytes(ARRAYS))
    monkeypatch.setitem(sys.modules, "onnx", None)
    with pytest.raises(ValueError, match=r'install it: pip install "amusic-gym\[onnx\]"'):
        CALC(path)


def test_33_weights_load_and_describe_offline(tmp_path, monkeypatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("asked for the network")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    np.savez(tmp_path / "calc.npz", **ARRAYS)
    assert CALC(tmp_path / "calc.npz").describe(cases.image()).shape == (1064,)
    netvlad = NetVLAD(small_netvlad(tmp_path / "own.safetensors"))
    assert netvlad.describe(cases.image()).shape == (7,)
    assert CALC().describe(cases.image()).shape == (1064,)  # the weights that ship
    assert NetVLAD().describe(cases.image()).shape == (256,)
