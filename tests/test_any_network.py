"""TorchScript, ONNX and torch.hub: small networks, their recipes, and what is refused."""

from __future__ import annotations

import pickle
import sys
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file
from technique_files import PLAIN, Small, onnx_file, torchscript
from weight_cases import image

from amusic_gym.extraction import extract
from amusic_gym.extraction.blocks import describe_some
from amusic_gym.techniques import Technique, any_network, make_technique
from amusic_gym.techniques.recipe import Recipe

MEAN, STD = np.array([0.485, 0.456, 0.406]) * 255, np.array([0.229, 0.224, 0.225]) * 255

HUB = """
import torch
from pieces import scale

def entry(width=6, double=False):
    torch.manual_seed(5)
    network = torch.nn.Sequential(
        torch.nn.Conv2d(3, width, 5, stride=4), torch.nn.ReLU(),
        torch.nn.AdaptiveAvgPool2d(1), torch.nn.Flatten())
    network[0].weight.data *= scale * (2 if double else 1)
    return network

def downloading():
    import urllib.request
    urllib.request.urlopen("http://example.invalid/weights.pth")
"""


@pytest.fixture
def hub(tmp_path, monkeypatch):
    """A clone in the hub's cache."""
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    folder = tmp_path / "someone_small_main"
    folder.mkdir()
    (folder / "hubconf.py").write_text(HUB)
    (folder / "pieces.py").write_text("scale = 1.0\n")
    (tmp_path / "someone_small_main.toml").write_text(PLAIN + 'name = "SmallHub"\n')
    yield folder
    for name in ("hubconf", "pieces"):
        sys.modules.pop(name, None)


def expected(picture):
    """By hand: red first, standardised, convolved, cut at 0, averaged, of length 1."""
    x = (picture[:, :, ::-1] - MEAN) / STD
    with torch.inference_mode():
        values = Small()(torch.from_numpy(x.transpose(2, 0, 1).copy()).float()[None])[1][0].numpy()
    return values / np.linalg.norm(values)


def made(kind, folder):
    path = torchscript(folder) if kind == "torchscript" else onnx_file(folder)
    return make_technique(f"{kind}:{path}")


@pytest.mark.parametrize("kind", ["torchscript", "onnx"])
def test_a_file_describes_as_its_network_does(tmp_path, kind):
    technique, picture = made(kind, tmp_path), image(2, 30, 45)[:24, :32]
    got = technique.describe(picture)
    assert (technique.name, got.dtype, got.shape) == ("small", np.float32, (6,))
    np.testing.assert_allclose(got, expected(picture), atol=1e-5)
    np.testing.assert_array_equal(technique.describe(picture), got)
    assert technique.match(got, np.stack([got, -got])) == pytest.approx([1, -1], abs=1e-6)


def test_a_hubs_entry_describes_as_its_network_does(hub):
    technique = make_technique("hub:someone/small:entry", trust=True)
    picture = image(2, 30, 45)[:24, :32]
    assert technique.name == "SmallHub"
    np.testing.assert_allclose(technique.describe(picture), expected(picture), atol=1e-5)
    wide = make_technique("hub:someone/small:entry:width=9:double=True", trust=True)
    assert wide.describe(picture).shape == (9,)
    by_path = make_technique(f"hub:{hub}:entry", trust=True)
    assert by_path.parameters() == technique.parameters()
    assert wide.parameters() != technique.parameters()


@pytest.mark.parametrize("kind", ["torchscript", "onnx"])
def test_25_file_and_recipe_are_part_of_the_cache_key(tmp_path, kind):
    before = made(kind, tmp_path).parameters()
    assert made(kind, tmp_path).parameters() == before
    recipe = tmp_path / "small.toml"
    text = recipe.read_text()
    recipe.write_text(text + 'metric = "l2"\n')
    file = next(path for path in tmp_path.iterdir() if path.suffix != ".toml")
    assert make_technique(f"{kind}:{file}").parameters() != before
    recipe.write_text(text)
    if kind == "onnx":
        onnx_file(tmp_path, operator="Sigmoid")
        assert make_technique(f"{kind}:{file}").parameters() != before


def test_25_code_of_a_hubs_repository_is_part_of_the_cache_key(hub):
    before = make_technique("hub:someone/small:entry", trust=True).parameters()
    (hub / "pieces.py").write_text("scale = 1.0  # changed\n")
    assert make_technique("hub:someone/small:entry", trust=True).parameters() != before


@pytest.mark.parametrize("kind", ["torchscript", "onnx"])
def test_it_pickles_by_its_file_and_a_changed_file_is_refused(tmp_path, kind):
    technique = made(kind, tmp_path)
    stored = pickle.dumps(technique)
    again = pickle.loads(stored)
    assert again.parameters() == technique.parameters()
    np.testing.assert_array_equal(again.describe(image()), technique.describe(image()))
    (tmp_path / "small.toml").write_text("size = [48, 64]\noutput = 0\n")
    with pytest.raises(ValueError, match="files of technique 'small' changed; start again"):
        pickle.loads(stored)


def test_metrics(tmp_path):
    picture, other = image(1), image(2)
    found = {}
    for metric in ("cosine", "dot", "l2"):
        path = torchscript(tmp_path, f'{PLAIN}output = 1\nmetric = "{metric}"\n')
        technique = make_technique(f"torchscript:{path}")
        one, two = technique.describe(picture), technique.describe(other)
        found[metric] = one, two, technique.match(one, np.stack([one, two]))
    (a, b, dot), (c, d, l2), (e, f, cosine) = found["dot"], found["l2"], found["cosine"]
    np.testing.assert_array_equal(a, c)
    np.testing.assert_allclose(dot, [a @ a, a @ b], rtol=1e-5)
    np.testing.assert_allclose(l2, [0, -np.linalg.norm(c - d)], atol=1e-5)
    np.testing.assert_allclose(
        cosine, [1, a @ b / np.linalg.norm(a) / np.linalg.norm(b)], atol=1e-5
    )
    assert np.linalg.norm(e) == pytest.approx(1, abs=1e-6)
    assert f.shape == e.shape


@pytest.mark.parametrize("kind", ["torchscript", "onnx"])
def test_several_images_at_once_are_as_one_by_one(tmp_path, kind):
    technique = made(kind, tmp_path)
    pictures = [image(seed) for seed in range(5)]
    together = describe_some(technique, pictures)
    for picture, got in zip(pictures, together, strict=True):
        np.testing.assert_allclose(got, technique.describe(picture), atol=1e-6)


class Batched(Technique):
    name = "Batched"
    batch = 3
    sizes: list[int] = []

    def describe(self, image):
        return image.mean(axis=(0, 1)).astype(np.float32)

    def describe_batch(self, images):
        self.sizes.append(len(images))
        return super().describe_batch(images)


def test_extraction_gives_a_technique_the_batches_it_wants(tmp_path):
    import cv2

    for name in ("map", "run"):
        (tmp_path / name).mkdir()
        for number in range(7):
            picture = image(number + 10 * (name == "run"))
            cv2.imwrite(str(tmp_path / name / f"{number}.png"), picture)
    options = {"tolerance": 1, "seconds": {"Batched": 1.0}}
    folders = tmp_path / "map", tmp_path / "run"
    Batched.sizes.clear()
    batched = extract(*folders, Batched(), cache=tmp_path / "a", **options)
    assert Batched.sizes == [3, 3, 3, 3]  # the last of seven goes alone
    single = Batched()
    single.batch = 1
    alone = extract(*folders, single, cache=tmp_path / "b", **options)
    np.testing.assert_array_equal(batched.scores, alone.scores)


def test_images_of_several_sizes_go_one_by_one(tmp_path):
    path = torchscript(tmp_path, 'size = [24, 24]\nresize = "shorter"\noutput = 1\n')
    technique = make_technique(f"torchscript:{path}")
    pictures = [image(1, 60, 90), image(2, 90, 60)]
    for picture, got in zip(pictures, technique.describe_batch(pictures), strict=True):
        np.testing.assert_array_equal(got, technique.describe(picture))


# ---- refusals ------------------------------------------------------------------------------


def test_an_unknown_operator_is_refused_in_a_sentence(tmp_path):
    path = onnx_file(tmp_path, operator="Frobnicate")
    with pytest.raises(ValueError, match=r"small\.onnx is no ONNX .*Frobnicate.*export") as caught:
        make_technique(f"onnx:{path}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["torchscript", "onnx"])
def test_damaged_missing_and_foreign_files_are_refused(tmp_path, kind):
    path = torchscript(tmp_path) if kind == "torchscript" else onnx_file(tmp_path)
    whole = path.read_bytes()
    for content in (b"", b"garbage", whole[: len(whole) // 2]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="can be run .* export it again") as caught:
            make_technique(f"{kind}:{path}")
        assert "\n" not in str(caught.value)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        make_technique(f"{kind}:{tmp_path / 'none.pt'}")


def test_30_a_pickle_is_no_torchscript_and_does_not_run(tmp_path):
    class Evil:
        def __reduce__(self):
            return Path.mkdir, (tmp_path / "ran",)

    path = torchscript(tmp_path)
    for save in (torch.save, lambda x, file: Path(file).write_bytes(pickle.dumps(x))):
        save(Evil(), path)
        with pytest.raises(ValueError, match="no TorchScript file"):
            make_technique(f"torchscript:{path}")
    assert not (tmp_path / "ran").exists()


def test_a_missing_recipe_says_what_to_write(tmp_path):
    path = torchscript(tmp_path)
    path.with_suffix(".toml").unlink()
    with pytest.raises(FileNotFoundError, match=r"small\.toml does not exist; write .* size = \["):
        make_technique(f"torchscript:{path}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"size is None; give size = \[HEIGHT, WIDTH\]"),
        ("size = 224", "size is 224"),
        ("size = [224, 0]", "width is 0"),
        ("siez = [2, 2]", "unknown key 'siez': did you mean 'size'"),
        (PLAIN + 'metric = "cos"', "unknown metric 'cos'"),
        (PLAIN + "mean = [1, 2]", "give red, green and blue"),
        (PLAIN + "std = 3", "not iterable"),
        (PLAIN + "output = 1.5", "output is 1.5; give a number or a name"),
        (PLAIN + 'resize = "pad"', "unknown resize 'pad'"),
        ("size = [", "Invalid value"),
    ],
)
def test_a_wrong_recipe_is_refused(tmp_path, text, message):
    path = torchscript(tmp_path, text)
    with pytest.raises(ValueError, match=rf"the recipe .*small\.toml: .*{message}"):
        make_technique(f"torchscript:{path}")


def test_a_network_that_does_not_fit_its_recipe_is_refused(tmp_path):
    tiny = make_technique(f"torchscript:{torchscript(tmp_path, 'size = [2, 2]')}")
    with pytest.raises(ValueError, match="cannot describe images of shape .*is the recipe's size"):
        tiny.describe(image())
    no_such = make_technique(f"torchscript:{torchscript(tmp_path, PLAIN + 'output = 7')}")
    with pytest.raises(ValueError, match=r"has no output 7, which the recipe names; there are \["):
        no_such.describe(image())


@pytest.mark.parametrize("output", ['"descriptor"', "0"])
def test_outputs_of_onnx_by_name_or_number(tmp_path, output):
    technique = make_technique(f"onnx:{onnx_file(tmp_path, PLAIN + f'output = {output}')}")
    assert technique.describe(image()).shape == (6,)


def test_32_onnx_runtime_that_is_not_installed_is_named(tmp_path, monkeypatch):
    path = onnx_file(tmp_path)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(ValueError, match=r'install it: pip install "amusic-gym\[onnx\]"'):
        make_technique(f"onnx:{path}")


def test_a_hubs_code_runs_only_with_trust(hub):
    with pytest.raises(ValueError, match="runs Python code of someone/small.*--trust"):
        make_technique("hub:someone/small:entry")
    assert "hubconf" not in sys.modules


def test_33_nothing_is_downloaded(hub, monkeypatch):
    reached = []
    monkeypatch.setattr("socket.socket.connect", lambda *_: reached.append(1))
    with pytest.raises(ValueError, match=r"asks example\.invalid for a download.*download once"):
        make_technique("hub:someone/small:downloading", trust=True)
    with pytest.raises(FileNotFoundError, match="neither a folder nor in the hub's cache"):
        make_technique("hub:nobody/nothing:entry", trust=True)
    assert not reached
    assert urllib.request  # the entry above used it


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("hub:someone/small", "not of the form hub:OWNER/REPO:ENTRY"),
        ("hub:someone/small:entry:9", "not of the form hub:OWNER/REPO:ENTRY"),
        ("hub:someone/small:nothing", "cannot be made: .*nothing"),
        ("hub:someone/small:entry:depth=3", "cannot be made: TypeError.*depth"),
        ("hub", "technique 'hub' needs more behind its name"),
    ],
)
def test_a_wrong_hub_name_is_refused(hub, name, message):
    with pytest.raises(ValueError, match=message):
        make_technique(name, trust=True)


def test_a_gpu_that_is_not_there_is_refused(tmp_path, monkeypatch):
    path = torchscript(tmp_path)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(ValueError, match="PyTorch finds no GPU; leave out --device cuda"):
        make_technique(f"torchscript:{path}", device="cuda")
    with pytest.raises(ValueError, match="unknown device 'gpu'"):
        make_technique(f"torchscript:{path}", device="gpu")


def test_recipes_that_ship_can_be_read():
    files = sorted(any_network.RECIPES.glob("*.toml"))
    assert {file.stem for file in files} == {"gmberton_cosplace", "gmberton_megaloc"}
    for file in files:
        Recipe.read(file, "")


def test_weights_are_no_network(tmp_path):
    save_file({"w": np.ones(3, np.float32)}, tmp_path / "w.safetensors")
    (tmp_path / "w.toml").write_text(PLAIN)
    with pytest.raises(ValueError, match="no TorchScript file"):
        make_technique(f"torchscript:{tmp_path / 'w.safetensors'}")
