"""Weights files of every kind: what comes out, and what is refused with which sentence."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
import weight_cases as cases
from safetensors.numpy import save, save_file
from scipy.io import loadmat, savemat

from amusic_gym.techniques import matfile, weight_files, weight_readers
from amusic_gym.techniques.caffemodel import read_caffemodel
from amusic_gym.techniques.calc import CALC, load_calc
from amusic_gym.techniques.matfile import read_matfile
from amusic_gym.techniques.netvlad import NetVLAD
from amusic_gym.techniques.weight_files import read_weights

ROOT = Path(__file__).resolve().parent.parent
ARRAYS = cases.calc_arrays()


def torch_bytes(content: object, **options: object) -> bytes:
    stream = io.BytesIO()
    torch.save(content, stream, **options)
    return stream.getvalue()


def npz_bytes(arrays: cases.Arrays) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def mat_bytes(arrays: dict[str, object]) -> bytes:
    stream = io.BytesIO()
    savemat(stream, arrays)
    return stream.getvalue()


def tensors(prefix: str = "") -> dict[str, torch.Tensor]:
    return {prefix + name: torch.from_numpy(array.copy()) for name, array in ARRAYS.items()}


def nested() -> dict[str, object]:
    """A structure per layer, as MATLAB users would write it."""
    return {
        layer: {part: ARRAYS[f"{layer}.{part}"] for part in ("weight", "bias")}
        for layer in cases.CALC_SHAPES
    }


def decoder() -> dict[str, torch.Tensor]:
    return {"decoder.fc4.weight": torch.zeros(3, 4), "steps": torch.tensor(7)}


KINDS: dict[str, tuple[str, Callable[[], bytes]]] = {
    "safetensors": (".safetensors", lambda: save(ARRAYS)),
    "npz": (".npz", lambda: npz_bytes(ARRAYS)),
    "npz with underscores": (
        ".npz", lambda: npz_bytes({n.replace(".", "_"): a for n, a in ARRAYS.items()})),
    "state dictionary": (".pth", lambda: torch_bytes(tensors())),
    "below a prefix": (".pt", lambda: torch_bytes({**tensors("encoder."), **decoder()})),
    "trained in parallel": (".pt", lambda: torch_bytes(tensors("module."))),
    "a checkpoint": (".pth.tar", lambda: torch_bytes(
        {"epoch": 3, "state_dict": tensors("module.net."), "loss": np.float64(0.5)})),
    "Lightning": (".ckpt", lambda: torch_bytes(
        {"epoch": 3, "state_dict": tensors("model."), "hparams_name": "kwargs"})),
    "before PyTorch 1.6": (
        ".pth", lambda: torch_bytes(tensors(), _use_new_zipfile_serialization=False)),
    "parameters": (".pth", lambda: torch_bytes(
        {name: torch.nn.Parameter(tensor) for name, tensor in tensors().items()})),
    "caffemodel": (".caffemodel", lambda: cases.caffemodel(ARRAYS)),
    "old caffemodel": (".caffemodel", lambda: cases.caffemodel(ARRAYS, old=True)),
    "onnx": (".onnx", lambda: cases.onnx_bytes(ARRAYS)),
    "onnx with numbers": (".onnx", lambda: cases.onnx_bytes(ARRAYS, names="{}")),
    "mat": (".mat", lambda: mat_bytes({"net": nested()})),
    "upper case": (".NPZ", lambda: npz_bytes(ARRAYS)),
}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_file_gives_the_same_network(tmp_path, kind):
    ending, content = KINDS[kind]
    path = tmp_path / f"calc{ending}"
    path.write_bytes(content())
    state = load_calc(read_weights(path)).state_dict()
    assert list(state) == list(ARRAYS)
    for name, tensor in state.items():
        np.testing.assert_array_equal(tensor.numpy(), ARRAYS[name])


@pytest.mark.parametrize("kind", ["f2", "f8", "bf16"])
def test_other_precisions_become_float32(tmp_path, kind):
    path = tmp_path / "calc.pth"
    dtype = {"f2": torch.float16, "f8": torch.float64, "bf16": torch.bfloat16}[kind]
    torch.save({name: tensor.to(dtype) for name, tensor in tensors().items()}, path)
    got = load_calc(read_weights(path)).conv2.weight
    assert got.dtype == torch.float32
    np.testing.assert_array_equal(got.numpy(), tensors()["conv2.weight"].to(dtype).float())


def test_an_export_that_pools_in_floor_mode_is_used_with_a_warning(tmp_path):
    path = tmp_path / "floor.onnx"
    path.write_bytes(cases.onnx_bytes(ARRAYS, ceil=False))
    with pytest.warns(UserWarning, match="floor mode, which gives 936 values; .* 1064 values"):
        floor = CALC(path)
    assert floor.describe(cases.image()).shape == (1064,)


def test_onnx_weights_kept_in_other_files_are_refused(tmp_path):
    import onnx

    model = onnx.load_model_from_string(cases.onnx_bytes(ARRAYS))
    onnx.save_model(model, tmp_path / "calc.onnx", save_as_external_data=True, size_threshold=0)
    with pytest.raises(ValueError, match="keeps its weights in other files; export it as one"):
        CALC(tmp_path / "calc.onnx")


def test_two_networks_in_one_file_are_refused(tmp_path):
    path = tmp_path / "two.pth"
    torch.save({**tensors("student."), **tensors("teacher.")}, path)
    with pytest.raises(
        ValueError, match=r"two\.pth holds several networks, student\.conv1\.weight"
    ):
        CALC(path)


@pytest.mark.parametrize("ending", [ending for ending in weight_readers.READERS])
def test_damaged_files_are_refused_by_name(tmp_path, ending):
    """Cut anywhere, a file is refused; with bytes changed, it may still give arrays."""
    whole = next(content() for kind, content in KINDS.values() if kind.endswith(ending))
    path = tmp_path / f"weights{ending}"
    rng = np.random.default_rng(1)
    cuts = [whole[:size] for size in (1, 2, 7, 9, 100, len(whole) // 2, len(whole) - 1)]
    garbage = [rng.bytes(300), b"PK\x03\x04" + rng.bytes(300), b"\x80\x02" + rng.bytes(50)]
    for content in [*cuts, *garbage, b"<html>404</html>", b"\0" * 64]:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"weights\.") as refusal:
            CALC(path)
        assert "\n" not in str(refusal.value)
    for _ in range(10):
        changed = bytearray(whole)
        for at in rng.integers(0, min(len(whole), 3000), 4):
            changed[at] ^= int(rng.integers(1, 256))
        path.write_bytes(changed)
        with contextlib.suppress(ValueError):
            read_weights(path)


def test_a_damaged_pickle_is_refused_without_the_librarys_text(tmp_path):
    path = tmp_path / "weights.pt"
    path.write_bytes(b"\x80\x02garbage")
    with pytest.raises(ValueError, match=r"\(its contents are no tensors that PyTorch can read\)"):
        read_weights(path)


def test_empty_missing_and_unknown_files_and_folders_are_refused(tmp_path):
    for ending in weight_readers.READERS:
        empty = tmp_path / f"empty{ending}"
        empty.touch()
        with pytest.raises(ValueError, match=r"empty\..* is empty; copy or download it again"):
            read_weights(empty)
        with pytest.raises(FileNotFoundError, match=r"missing.* does not exist; check the name"):
            read_weights(tmp_path / f"missing{ending}")
        (tmp_path / f"folder{ending}").mkdir()
        with pytest.raises(ValueError, match=r"folder.* is a folder; give a file"):
            read_weights(tmp_path / f"folder{ending}")
    (tmp_path / "weights.h5").write_bytes(b"x")
    with pytest.raises(
        ValueError, match=r"weights\.h5 is no .*known endings: \.safetensors, \.npz"
    ):
        read_weights(tmp_path / "weights.h5")


def test_files_above_the_limit_are_refused_before_they_are_read(tmp_path, monkeypatch):
    path = tmp_path / "big.npz"
    np.savez_compressed(path, zeros=np.zeros((512, 512)))
    monkeypatch.setattr(weight_readers, "MOST_BYTES", 100_000)
    with pytest.raises(ValueError, match=r"big\.npz unpacks to \d+ bytes, .* 100000 at most"):
        read_weights(path)
    with path.open("r+b") as file:
        file.truncate(weight_files.MOST_BYTES + 1)  # sparse: takes no room
    with pytest.raises(ValueError, match=r"big\.npz has \d+ bytes, weights files here have"):
        read_weights(path)


def test_a_tensor_that_only_claims_its_size_is_refused(tmp_path):
    torch.save({"conv1.weight": torch.zeros(1).expand(1 << 40)}, tmp_path / "claim.pth")
    with pytest.raises(ValueError, match="claims 1099511627776 numbers for conv1.weight"):
        read_weights(tmp_path / "claim.pth")


def test_what_is_nested_without_end_is_refused(tmp_path):
    deep: object = torch.zeros(1)
    for _ in range(50):
        deep = [deep]
    torch.save(deep, tmp_path / "deep.pth")
    with pytest.raises(ValueError, match=r"deep\.pth is nested too deeply"):
        read_weights(tmp_path / "deep.pth")


def test_whole_numbers_are_no_weights(tmp_path):
    save_file({"conv1.weight": np.ones((64, 1, 5, 5), np.int64)}, tmp_path / "w.safetensors")
    assert read_weights(tmp_path / "w.safetensors").arrays == {}


def test_numbers_too_large_for_float32_are_refused(tmp_path):
    np.savez(tmp_path / "w.npz", **{**ARRAYS, "conv2.bias": np.full(128, 1e300)})
    with pytest.raises(ValueError, match=r"conv2\.bias .* NaN or infinite"):
        CALC(tmp_path / "w.npz")


class TestCaffemodel:
    """The protocol buffer's wire format."""

    def layer(self, blob: bytes) -> bytes:
        return cases.field(100, cases.field(1, "conv1") + cases.field(7, blob))

    def test_values_one_by_one_and_in_double_precision(self):
        shape = cases.field(7, cases.field(1, 3))
        values = np.array([1, 2, 3], "<f4")
        single = b"".join(cases.varint(5 << 3 | 5) + value.tobytes() for value in values)
        double = cases.field(8, values.astype("<f8").tobytes())
        for content in (single, double):
            arrays = read_caffemodel(self.layer(content + shape))
            np.testing.assert_array_equal(arrays["conv1.weight"], values)

    def test_other_fields_are_passed_over(self):
        blob = cases.blob(np.ones((2, 2), np.float32))
        noise = cases.varint(9 << 3 | 1) + b"12345678" + cases.field(200, "x") + cases.field(12, 5)
        arrays = read_caffemodel(noise + self.layer(noise + blob) + noise)
        assert list(arrays) == ["conv1.weight"]

    @pytest.mark.parametrize(
        "wrong",
        [
            b"\xff" * 11,
            b"\xff",
            cases.varint(100 << 3 | 2) + b"\x05abc",
            cases.varint(1 << 3 | 3),
            cases.field(0, "x"),
        ],
    )
    def test_what_is_no_protocol_buffer_is_refused(self, wrong, tmp_path):
        (tmp_path / "w.caffemodel").write_bytes(wrong)
        with pytest.raises(ValueError, match=r"no whole .caffemodel file \(Error parsing"):
            read_weights(tmp_path / "w.caffemodel")

    def test_a_shape_that_does_not_fit_the_values_is_refused(self, tmp_path):
        blob = cases.field(5, b"\0" * 8) + cases.field(7, cases.field(1, 3))
        (tmp_path / "w.caffemodel").write_bytes(self.layer(blob))
        with pytest.raises(ValueError, match="no whole .caffemodel file .*cannot reshape"):
            read_weights(tmp_path / "w.caffemodel")


@pytest.mark.parametrize("technique", [CALC, NetVLAD])
def test_weights_that_do_not_ship_are_missed_with_a_sentence(monkeypatch, tmp_path, technique):
    monkeypatch.setattr(weight_files, "PRETRAINED", tmp_path)
    with pytest.raises(FileNotFoundError, match="install amusic-gym again, or give a weights file"):
        technique()


def test_the_registry_loads_neither_torch_nor_opencv():
    code = (
        "import sys, amusic_gym.techniques, amusic_gym.techniques.weight_files\n"
        "assert not {'torch', 'cv2', 'scipy', 'onnx', 'safetensors'} & set(sys.modules)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment, timeout=60)


def test_a_zip_that_is_no_archive_of_arrays_is_refused(tmp_path):
    for ending in (".npz", ".pth"):
        path = tmp_path / f"other{ending}"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("readme.txt", "hello")
        with pytest.raises(ValueError, match=r"other\."):
            CALC(path)


# ---- MATLAB's own format -------------------------------------------------------------------


def test_matlab_files_are_read_as_scipy_reads_them():
    rng = np.random.default_rng(0)
    cell = np.empty((2, 3), object)
    for number in range(6):
        cell.ravel()[number] = rng.random((number, 2))
    given = {
        "single": rng.random((3, 4)).astype(np.float32),
        "four": rng.random((2, 3, 4, 5)),
        "text": "abc",
        "whole": np.arange(5),
        "complex": rng.random(3) + 1j,
        "logical": np.array([True]),
        "number": 3.25,
        "cell": cell,
        "structure": {"x": 1.5, "y": {"z": rng.random(7)}},
    }
    for packed in (False, True):
        stream = io.BytesIO()
        savemat(stream, given, do_compression=packed)
        found = read_matfile(stream.getvalue(), 1 << 20)
        expected = loadmat(stream, struct_as_record=False)
        for name in ("single", "four", "number"):
            assert found[name].dtype == expected[name].dtype
            assert np.array_equal(found[name], expected[name])
        for ours, theirs in zip(found["cell"], expected["cell"].ravel(), strict=True):
            assert ours is None or np.array_equal(ours, theirs)
            assert ours is not None or theirs.size == 0
        assert found["structure"]["x"] == 1.5
        assert np.array_equal(found["structure"]["y"]["z"].ravel(), given["structure"]["y"]["z"])
        assert [found[name] for name in ("text", "whole", "complex", "logical")] == [None] * 4


def test_matlab_numbers_that_are_stored_in_fewer_bytes_are_floats():
    """MATLAB writes doubles that are small whole numbers as bytes."""
    stream = io.BytesIO()
    savemat(stream, {"a": np.array([[1, 2, 3, 4]], np.uint8)})
    data = bytearray(stream.getvalue())
    at = 128 + 8 + 8  # the class of the matrix
    assert data[at] == 9
    data[at] = 6
    found = read_matfile(bytes(data), 1 << 20)["a"]
    assert found.dtype == np.float64
    assert found.tolist() == [[1.0, 2.0, 3.0, 4.0]]


@pytest.mark.parametrize("packed", [False, True])
def test_30_changed_matlab_files_are_read_or_refused_in_a_sentence(tmp_path, packed):
    """Where one byte is changed SciPy's reader may end the process."""
    stream = io.BytesIO()
    savemat(stream, {"net": {"w": np.ones((3, 2)), "c": "x"}, "b": 2.0}, do_compression=packed)
    data, rng = stream.getvalue(), np.random.default_rng(0)
    path = tmp_path / "weights.mat"
    for _ in range(300):
        made = bytearray(data)
        made[rng.integers(126, len(made))] = rng.integers(256)
        path.write_bytes(made)
        try:
            read_weights(path)
        except ValueError as error:
            words = str(error)  # some changes do no harm
            assert words.startswith(str(path))
            assert len(words.splitlines()) == 1


def test_30_contents_beyond_the_limit_are_refused_before_they_are_unpacked(tmp_path, monkeypatch):
    limit = 1 << 20
    monkeypatch.setattr(weight_readers, "MOST_BYTES", limit)
    stream = io.BytesIO()
    savemat(stream, {"a": np.zeros(limit // 8)}, do_compression=True)
    bomb = tmp_path / "bomb.mat"
    bomb.write_bytes(stream.getvalue())
    unpacked = []
    monkeypatch.setattr(matfile.zlib, "decompress", lambda *_, **__: unpacked.append(1))
    with pytest.raises(ValueError, match=f"bomb.mat unpacks to more than {limit} bytes; save"):
        read_weights(bomb)
    assert not unpacked
    one = torch.ones(1).expand(limit // 4 // 3)  # as often as it is named, in four bytes
    torch.save({str(i): one for i in range(4)}, tmp_path / "claims.pth")
    with pytest.raises(ValueError, match=r"claims\.pth claims \d+ numbers for 3; save the weights"):
        read_weights(tmp_path / "claims.pth")
