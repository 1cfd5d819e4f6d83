"""The weights that ship: whole, small, as their card says, and good enough; how they are made."""

from __future__ import annotations

import hashlib
import importlib
import json
import os
import re
import signal
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from corridor import data_folder
from safetensors import safe_open
from torch import get_num_threads, set_num_threads

from amusic_gym.pretraining import calc, job, netvlad, pools
from amusic_gym.pretraining.job import TrainingJob
from amusic_gym.pretraining.loop import Training
from amusic_gym.pretraining.pools import DRIVES, SIGHTS, Pool, PoolSize, collage, make_pool
from amusic_gym.routes.images import read_image
from amusic_gym.techniques import make_technique
from amusic_gym.techniques.networks import NetVLADWidths
from amusic_gym.techniques.preparation import Preparation
from amusic_gym.techniques.weight_files import PRETRAINED, shipped

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"
MODULES = {"calc": calc, "netvlad": netvlad}
NAMES = tuple(MODULES)
CARD = (PRETRAINED / "CARD.md").read_text("utf-8")


# ---- the files -----------------------------------------------------------------------------


@pytest.mark.parametrize("name", NAMES)
def test_shipped_weights_describe_images_by_descriptors_of_length_1(name):
    technique = make_technique(name)
    image = np.random.default_rng(0).integers(0, 256, (240, 320, 3), dtype=np.uint8)
    descriptor = technique.describe(image)
    assert descriptor.shape == {"calc": (1064,), "netvlad": (256,)}[name]
    np.testing.assert_allclose(np.linalg.norm(descriptor), 1, rtol=1e-5)


def test_shipped_weights_have_4_megabytes_at_most_together():
    assert sum(shipped(name).stat().st_size for name in NAMES) <= 4_000_000


@pytest.mark.parametrize("name", NAMES)
def test_the_card_names_the_checksum_of_the_weights(name):
    digest = hashlib.sha256(shipped(name).read_bytes()).hexdigest()
    assert re.search(rf"{name}\.safetensors.*{digest}", CARD)


@pytest.mark.parametrize(
    ("name", "rendered", "cameras"), [("calc", 0.35, 0.15), ("netvlad", 0.7, 0.4)]
)
def test_the_weights_say_how_they_were_made(name, rendered, cameras):
    told = about(shipped(name))
    assert told["settings"]["seed"] == 0
    assert len(told["renderer"]) == 64
    assert told["held_out"]["as_rendered"] > rendered
    assert told["held_out"]["random_cameras"] > cameras
    for value in told["held_out"].values():
        assert f"{value:.3f}" in CARD


def about(path: Path) -> dict:
    """The JSON part of what a weights file says of its training."""
    with safe_open(path, framework="np") as file:
        training = json.loads(file.metadata()["amusic_gym"])["training"]
    return json.loads(training[training.index("{") :])


@pytest.mark.parametrize(("name", "least"), [("calc", 0.25), ("netvlad", 0.30)])
def test_shipped_weights_recognise_places_of_a_real_recording(name, least):
    folder = data_folder() / "corridor"
    truth = np.load(folder / "ground_truth.npy")
    technique = make_technique(name)
    queries, references = (
        np.stack([technique.describe(read_image(path)) for path in sorted(part.iterdir())])
        for part in (folder / "query", folder / "reference")
    )
    found = (queries @ references.T).argmax(axis=1)
    accuracy = truth[np.arange(len(found)), found].mean()
    assert accuracy >= least
    assert f"{accuracy:.3f}" in CARD  # the card tells what is measured


# ---- how they are made ---------------------------------------------------------------------


TINY = PoolSize(worlds=2, places=4)
CALC = calc.Settings(steps=4, pictures=3, rate=2e-3, pool=TINY, held_out=TINY)
NETVLAD = netvlad.Settings(
    point_steps=5,
    place_steps=3,
    pictures=4,
    points=24,
    places=3,
    samples=96,
    pool=TINY,
    held_out=TINY,
    widths=NetVLADWidths(stages=((8,), (16,), (16,)), clusters=4, whitened=8),
    preparation=Preparation(width=64, height=48),
)


@pytest.fixture
def without_rendering(monkeypatch) -> None:
    """Collages in place of rendered worlds: a place looks the same on both drives."""

    def pool(size: PoolSize, seed: int, *_, **__) -> Pool:
        rng = np.random.default_rng(seed)
        scenes = [[collage(rng) for _ in range(size.places)] for _ in range(size.worlds)]
        views = np.stack([np.stack([scenes] * SIGHTS, axis=2)] * DRIVES, axis=2)
        return Pool(views)

    monkeypatch.setattr(job, "make_pool", pool)


def train_tiny(name: str, folder: Path, **changes) -> tuple[list[float], bytes]:
    """Losses of a tiny training (of its first stage) and the file that it wrote."""
    given = TrainingJob(folder / f"{name}.safetensors", progress=False)
    if name == "calc":
        losses = calc.train(given, replace(CALC, **changes))
    else:
        losses, _ = netvlad.train(given, replace(NETVLAD, **changes))
    return losses, given.out.read_bytes()


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("without_rendering")
def test_a_tiny_training_gives_usable_weights_and_the_same_bits_again(name, tmp_path):
    _, first = train_tiny(name, tmp_path / "first")
    _, second = train_tiny(name, tmp_path / "second")
    _, other = train_tiny(name, tmp_path / "other", seed=1)
    assert first == second
    assert first != other
    files = [path.name for path in (tmp_path / "first").iterdir()]
    assert files == [f"{name}.safetensors"]  # no checkpoint is left
    image = np.full((60, 80, 3), 99, np.uint8)
    image[:, 40:] = 200
    values = make_technique(name, tmp_path / "first" / files[0]).describe(image)
    np.testing.assert_allclose(np.linalg.norm(values), 1, rtol=1e-5)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.usefixtures("without_rendering")
def test_the_loss_falls(name, tmp_path):
    more = {"calc": {"steps": 40, "warp": 0.0}, "netvlad": {"point_steps": 40}}[name]
    losses, _ = train_tiny(name, tmp_path, collages=0.0, **more)
    assert np.mean(losses[-8:]) < 0.9 * np.mean(losses[:8])


@pytest.mark.parametrize(
    ("name", "stage", "step"), [("calc", 0, 2), ("netvlad", 0, 2), ("netvlad", 1, 1)]
)
@pytest.mark.usefixtures("without_rendering")
def test_a_training_that_is_interrupted_goes_on_with_the_same_bits(
    name, stage, step, tmp_path, monkeypatch
):
    _, whole = train_tiny(name, tmp_path / "whole")
    module, settings = (calc, CALC) if name == "calc" else (netvlad, NETVLAD)
    given = TrainingJob(tmp_path / "cut" / f"{name}.safetensors", progress=False)
    made = []

    class Interrupted(Training):
        def __init__(self, *arguments, **options):
            super().__init__(*arguments, **options)
            made.append(self)

        def _step(self, loss_of, number):
            if (len(made) - 1, number) == (stage, step):
                os.kill(os.getpid(), signal.SIGINT)  # in the middle of the step
            return super()._step(loss_of, number)

    with monkeypatch.context() as patch:
        patch.setattr(module, "Training", Interrupted)
        with pytest.raises(KeyboardInterrupt):
            module.train(given, settings)
    assert not given.out.exists()
    module.train(replace(given, resume=True), settings)
    assert given.out.read_bytes() == whole


@pytest.mark.usefixtures("without_rendering")
def test_other_settings_and_damaged_checkpoints_are_refused(tmp_path):
    given = TrainingJob(tmp_path / "calc.safetensors", resume=True, progress=False)
    with pytest.raises(FileNotFoundError, match="nothing to resume; leave out --resume"):
        calc.train(given, CALC)
    interrupt_at_once = pytest.MonkeyPatch()
    with interrupt_at_once.context() as patch:
        patch.setattr(Training, "_step", interrupting(Training._step))
        with pytest.raises(KeyboardInterrupt):
            calc.train(replace(given, resume=False), CALC)
    with pytest.raises(ValueError, match=r"rate is 0\.5, but .* was made with 0\.002"):
        calc.train(given, replace(CALC, rate=0.5))
    checkpoint = given.checkpoint("training")
    checkpoint.write_bytes(checkpoint.read_bytes()[:1000])
    with pytest.raises(ValueError, match="is damaged"):
        calc.train(given, CALC)


def interrupting(step):
    def interrupted(self, *arguments):
        os.kill(os.getpid(), signal.SIGINT)
        return step(self, *arguments)

    return interrupted


@pytest.fixture
def script(monkeypatch):
    """Imports the script of a technique's training, as its folder's scripts find each other."""
    monkeypatch.setattr("warnings.formatwarning", warnings.formatwarning)  # run() replaces it
    monkeypatch.syspath_prepend(SCRIPTS)
    return lambda name: importlib.import_module(f"train_{name}")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("wrong", [["--out", "x.pth"], ["--out", "x.safetensors", "--seed", "-1"]])
def test_a_wrong_name_or_seed_is_one_line_and_status_2(name, wrong, script, capsys):
    module = script(name)
    with pytest.raises(SystemExit) as end:
        module.run(lambda: module.main(wrong))
    told = capsys.readouterr()
    assert (end.value.code, told.out) == (2, "")
    assert told.err.count("\n") == 1
    assert wrong[-1] in told.err


@pytest.mark.parametrize("name", NAMES)
def test_a_command_trains_from_its_arguments_on_one_thread_and_says_where_the_weights_are(
    name, script, tmp_path, capsys, monkeypatch
):
    seen = []
    before = get_num_threads()
    set_num_threads(2)
    module = MODULES[name]
    monkeypatch.setattr(module, "train", lambda *given: seen.append((given, get_num_threads())))
    out, images = tmp_path / "mine.safetensors", tmp_path / "images"
    words = ("--out", out, "--seed", 3, "--resume", "--images", images)
    script(name).main([str(word) for word in words])
    set_num_threads(before)
    ((given, threads), *more) = seen
    assert given == (TrainingJob(out, resume=True, images=images), module.Settings(seed=3))
    assert (threads, more) == (1, [])
    told = capsys.readouterr().out
    assert told == f"The weights are in {out}; use them with --weights {name}={out}\n"


# ---- what they learn from -------------------------------------------------------------------


def test_a_pool_is_rendered_kept_and_taken_only_by_the_same_renderer(tmp_path, monkeypatch):
    size, keep = PoolSize(worlds=1, places=2), tmp_path / "pool.safetensors"
    drawn = []

    def render(world, along, condition, *, size, run, frame):
        drawn.append(condition)
        return np.full((size[1], size[0], 3), len(drawn), np.uint8)

    monkeypatch.setattr(pools, "render", render)
    first = make_pool(size, 0, keep, progress=False)
    assert first.images.shape == (1, 2, DRIVES, SIGHTS, 120, 160, 3)
    assert len(drawn) == 2 * DRIVES * SIGHTS
    again = make_pool(size, 0, keep, progress=False)
    assert len(drawn) == 2 * DRIVES * SIGHTS  # nothing more
    assert np.array_equal(again.images, first.images)
    monkeypatch.setattr(pools, "renderer_digest", lambda: "another")
    make_pool(size, 0, keep, progress=False)
    assert len(drawn) == 4 * DRIVES * SIGHTS


def test_two_pictures_of_one_pose_are_related_by_the_map_between_them():
    image = np.zeros((120, 160, 3), np.uint8)
    spot = np.array([104, 44])  # column, row
    image[spot[1] - 2 : spot[1] + 3, spot[0] - 2 : spot[0] + 3] = 255
    found = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        (left, right), move = netvlad.two_pictures(image, image, rng)
        here, there = (brightest(picture) for picture in (left, right))
        if here is None or there is None:
            continue  # the spot is outside, covered, or too dark
        there_by_map = np.append(here, 1) @ move.T
        np.testing.assert_allclose(there_by_map[:2] / there_by_map[2], there, atol=0.08)
        found += 1
    assert found >= 10


def brightest(picture: np.ndarray) -> np.ndarray | None:
    """Middle of the one bright spot on a dark picture, -1 to 1; None where there is none."""
    grey = picture.mean(axis=2)
    rows, columns = np.nonzero(grey > 0.7 * grey.max())
    if grey.max() < 2 * np.median(grey) + 60 or np.ptp(rows) > 10 or np.ptp(columns) > 10:
        return None
    return np.array([columns.mean() / 79.5 - 1, rows.mean() / 59.5 - 1])
