"""What the project promises of training: one test per row of the promises, its number in the name.

Row 30 names zips of Stable-Baselines3 from elsewhere: nothing here reads any, with or without
``--trust``.
"""

from __future__ import annotations

import io
import json
import pickle
import shutil
import signal
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import small_training
import torch
from amusic_agents import records as records_module
from amusic_agents import run_folder
from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import HeldOut
from amusic_agents.ppo import PPOLearner
from amusic_agents.run_folder import CHECKPOINT, EVALUATIONS, SELECTOR, read_tensors
from amusic_agents.selector import load_selector
from amusic_agents.training import train
from env_cases import random_bank
from safetensors.torch import load_file, save_file
from small_training import SMALL, train_script

from amusic_gym.envs.observation import ROUTE_FEATURES, TECHNIQUE_FEATURES, VERSION
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.rollout import rollout

pytestmark = pytest.mark.slow

INPUTS = len(TECHNIQUE_FEATURES) + len(ROUTE_FEATURES)  # of the network's first layer
PICKLE_STARTS = (b"\x80\x02", b"\x80\x03", b"\x80\x04", b"\x80\x05", b"PK\x03\x04")


def small(**changes) -> TrainingConfig:
    return TrainingConfig(**{**SMALL, "timesteps": 96, **changes})


@pytest.fixture(scope="module")
def bank_folder(tmp_path_factory) -> Path:
    return random_bank(1, techniques=4).save(tmp_path_factory.mktemp("banks") / "four")


@pytest.fixture(scope="module")
def trained(tmp_path_factory, bank_folder) -> Path:
    run = tmp_path_factory.mktemp("trained") / "run"
    train(run, small(), banks=[bank_folder], progress=False)
    return run


@pytest.fixture
def copy(trained, tmp_path) -> Path:
    """A run to damage."""
    return Path(shutil.copytree(trained, tmp_path / "copy"))


@pytest.fixture
def command(monkeypatch, amusic):
    """Runs the command in this process; its exit status and the lines on stderr."""
    monkeypatch.setattr(
        "amusic_agents.config.TrainingConfig", lambda **v: TrainingConfig(**SMALL | v)
    )

    def call(*arguments: object) -> tuple[int, list[str]]:
        status, _, err = amusic("train", *arguments)
        return status, err.strip().splitlines()

    return call


def interrupt(monkeypatch, owner, name: str, call: int) -> None:
    """Ctrl-C within the given call of ``owner.name``."""
    original = getattr(owner, name)
    count = 0

    def counting(*arguments, **keywords):
        nonlocal count
        count += 1
        if count == call:
            raise KeyboardInterrupt
        return original(*arguments, **keywords)

    monkeypatch.setattr(owner, name, counting)


def timesteps(run: Path) -> int:
    return int(read_tensors(run / CHECKPOINT)[1]["timesteps"])


def evaluated(run: Path) -> list[int]:
    lines = (run / EVALUATIONS).read_text().splitlines()
    return [int(line.split(",")[0]) for line in lines[1:]]


# ---- 30, 31: weights -----------------------------------------------------------------------


def test_30_a_run_folder_holds_no_pickle(trained):
    for file in trained.iterdir():
        content = file.read_bytes()
        assert not content.startswith(PICKLE_STARTS), file.name
        assert not zipfile.is_zipfile(file), file.name
        assert file.suffix in (".json", ".safetensors", ".csv") or "tfevents" in file.name
        with pytest.raises((pickle.UnpicklingError, EOFError, ValueError, KeyError, IndexError)):
            pickle.loads(content)


class Bomb:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def malicious(kind: str, mark: Path) -> bytes:
    if kind == "pickle":
        return pickle.dumps(Bomb(mark))
    stream = io.BytesIO()
    if kind == "pth":
        torch.save({"encoder.0.weight": Bomb(mark)}, stream)
    else:
        with zipfile.ZipFile(stream, "w") as archive:
            archive.writestr("data", pickle.dumps(Bomb(mark)))
            archive.writestr("policy.pth", pickle.dumps(Bomb(mark)))
    return stream.getvalue()


@pytest.mark.parametrize("name", [SELECTOR, CHECKPOINT])
@pytest.mark.parametrize("kind", ["pickle", "pth", "zip"])
def test_30_malicious_weights_are_refused_and_execute_nothing(copy, tmp_path, command, kind, name):
    mark = tmp_path / "executed"
    content = malicious(kind, mark)
    (copy / name).write_bytes(content)
    if name == SELECTOR:
        with pytest.raises(ValueError, match=f"{name} is no whole safetensors file.*; train again"):
            load_selector(copy)
    status, lines = command("--out", copy, "--resume", "--timesteps", 128)
    assert (status, len(lines)) == (2, 1)
    assert f"{name} is no whole safetensors file" in lines[0]
    assert not mark.exists()
    if kind == "pickle":
        pickle.loads(content)
        assert mark.exists()  # it would have


def change(run: Path, name: str, changes: dict[str, torch.Tensor | None]) -> None:
    """Replace or drop tensors of a file."""
    tensors, metadata = read_tensors(run / name)
    kept = {k: v for k, v in {**tensors, **changes}.items() if v is not None}
    save_file(kept, run / name, metadata)


@pytest.mark.parametrize(
    ("tensor", "sentence"),
    [
        (
            torch.zeros(64, INPUTS - 1),
            rf"'encoder.0.weight' is \(64, {INPUTS - 1}\) float32, .* needs \(64, {INPUTS}\)",
        ),
        (torch.zeros(64, INPUTS).double(), "'encoder.0.weight' is .* float64, .* float32"),
        (torch.full((64, INPUTS), np.nan), "'encoder.0.weight' holds NaN"),
        (None, "'encoder.0.weight' is none"),
    ],
)
def test_31_weights_of_the_wrong_shape_are_refused_by_layer(copy, tensor, sentence):
    change(copy, SELECTOR, {"encoder.0.weight": tensor})
    with pytest.raises(ValueError, match=f"{SELECTOR}: layer {sentence}.*train again"):
        load_selector(copy)


def test_31_weights_of_another_network_are_refused_by_layer(copy, command):
    change(copy, SELECTOR, {"conv1.weight": torch.zeros(3)})
    with pytest.raises(ValueError, match="layer 'conv1.weight' .* needs none"):
        load_selector(copy)
    change(copy, SELECTOR, {"conv1.weight": None})
    change(copy, CHECKPOINT, {"policy.value_net.weight": torch.zeros(1, 3)})
    status, lines = command("--out", copy, "--resume", "--timesteps", 128)
    assert status == 2
    assert "layer 'value_net.weight' is (1, 3) float32, the network needs (1, 64)" in lines[0]


@pytest.mark.parametrize(
    "config", ["", "[]", '{"hidden": 1000000000}', '{"hidden": "64"}', '{"depth": 3}']
)
def test_31_sizes_that_no_network_has_are_refused(copy, config):
    tensors, _ = read_tensors(copy / SELECTOR)
    save_file(tensors, copy / SELECTOR, {"network": config})
    with pytest.raises(ValueError, match=f"{SELECTOR} holds no selector"):
        load_selector(copy)


# ---- 34: Ctrl-C ----------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_34_52_a_stop_of_the_command_saves_a_checkpoint(
    tmp_path, bank_folder, command, number, status
):
    run = tmp_path / "run"
    code = small_training.signal_at("amusic_agents.ppo", "PPOLearner._on_step", 13, number)
    options = ("--out", run, "--bank", bank_folder, "--seed", 1)
    ended = train_script(*options, "--timesteps", 320, code=code)
    assert ended.returncode == status, ended.stderr
    assert "Traceback" not in ended.stderr
    assert "interrupted; what was finished is kept" in ended.stderr
    saved = timesteps(run)
    assert saved == 13 * 4  # of 4 routes each
    assert evaluated(run) == []
    first = load_selector(run)  # nothing was evaluated: the last weights
    assert rollout(first, random_bank(2), name="ppo", compute_weight=1.0).ran.any()
    assert command(*options, "--timesteps", 128, "--resume") == (0, [])
    assert timesteps(run) == saved + 96  # whole updates of 32
    assert evaluated(run) == [116, 148]


@pytest.mark.parametrize(
    ("owner", "name", "call"),
    [
        (HeldOut, "evaluate", 1),  # after 64 frames
        (HeldOut, "evaluate", 2),  # the last one, after 96
        (records_module, "write_selector", 1),
        (records_module, "write_tensors", 2),  # 1 is the empty one before the first frame
        (records_module, "write_table", 3),  # 1 and 2 as well
        (PPOLearner, "_on_step", 10),
    ],
)
def test_34_ctrl_c_during_an_evaluation_or_a_write_is_survived(
    tmp_path, bank_folder, command, monkeypatch, owner, name, call
):
    run = tmp_path / "run"
    options = ("--out", run, "--bank", bank_folder)
    with monkeypatch.context() as patch:
        interrupt(patch, owner, name, call)
        status, lines = command(*options, "--timesteps", 96)
    assert (status, lines[-1]) == (130, "interrupted; what was finished is kept")
    assert [file.name for file in run.iterdir() if file.name.startswith(".")] == []
    at = timesteps(run)
    assert at in (40, 64, 96)
    load_selector(run)
    status, _ = command(*options, "--timesteps", 96, "--resume")
    assert status == 0
    assert timesteps(run) == (104 if at == 40 else 96)
    assert evaluated(run)[-1] == timesteps(run)
    assert len(set(evaluated(run))) == len(evaluated(run))
    best = json.loads((run / "config.json").read_text())["best"]
    assert best["timesteps"] in evaluated(run)


def test_34_ctrl_c_within_a_write_leaves_the_old_file(copy, monkeypatch):
    before = {file.name: file.read_bytes() for file in copy.glob("*.safetensors")}
    interrupt(monkeypatch, __import__("os"), "replace", 1)
    tensors, metadata = read_tensors(copy / CHECKPOINT)
    with pytest.raises(KeyboardInterrupt):
        run_folder.write_tensors(copy / CHECKPOINT, tensors, metadata)
    assert {file.name: file.read_bytes() for file in copy.glob("*.safetensors")} == before
    assert not list(copy.glob(".*"))


# ---- 35: resume ----------------------------------------------------------------------------


def test_35_a_killed_training_resumes_from_its_last_whole_checkpoint(
    tmp_path, bank_folder, command
):
    run = tmp_path / "run"
    code = small_training.signal_at("amusic_agents.ppo", "PPOLearner._on_step", 19, signal.SIGKILL)
    ended = train_script("--out", run, "--bank", bank_folder, "--timesteps", 160, code=code)
    assert ended.returncode == -signal.SIGKILL, ended.stderr
    assert timesteps(run) == 64
    assert evaluated(run) == [64]
    before = load_file(run / CHECKPOINT)
    progress = (run / "progress.csv").read_bytes()
    assert command("--out", run, "--resume") == (0, [])  # as many frames as were asked for
    assert timesteps(run) == 160
    assert evaluated(run) == [64, 128, 160]
    after = load_file(run / CHECKPOINT)
    assert not torch.equal(before["policy.value_net.weight"], after["policy.value_net.weight"])
    name = "optimiser.0.step"  # the optimiser went on: an update has one step per epoch
    assert (float(before[name]), float(after[name])) == (2.0, 5.0)
    assert (run / "progress.csv").read_bytes() == progress
    assert (run / "progress-64.csv").exists()
    config = json.loads((run / "config.json").read_text())
    assert config["banks"] == [str(bank_folder)]


def test_35_a_training_that_is_killed_before_its_first_frame_resumes(
    tmp_path, bank_folder, monkeypatch
):
    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        patch.setattr(PPOLearner, "_on_step", lambda self: sys.exit(9))
        with pytest.raises(SystemExit):
            train(run, small(), banks=[bank_folder], progress=False)
    assert timesteps(run) == 0
    train(run, small(), resume=True, progress=False)
    assert timesteps(run) == 96


def test_35_a_finished_training_has_nothing_left_to_do(copy, command):
    before = {file.name: file.read_bytes() for file in copy.iterdir() if file.suffix != ".csv"}
    assert command("--out", copy, "--resume") == (0, [])
    for name, content in before.items():
        if name == CHECKPOINT or "tfevents" in name:
            continue
        assert (copy / name).read_bytes() == content, name
    assert evaluated(copy) == [64, 96]


def test_35_the_same_checkpoint_goes_on_in_the_same_way(copy, tmp_path):
    twin = Path(shutil.copytree(copy, tmp_path / "twin"))
    for run in (copy, twin):
        np.random.seed(int(run == twin))
        train(run, small(timesteps=160), resume=True, progress=False)
    first, second = load_file(copy / CHECKPOINT), load_file(twin / CHECKPOINT)
    assert all(torch.equal(first[name], second[name]) for name in first.keys() | second.keys())


# ---- 36: determinism -----------------------------------------------------------------------


def test_36_the_same_seed_gives_the_same_weights_bit_for_bit(tmp_path, command):
    options = ("--timesteps", 96, "--seed", 5)  # simulated routes
    ended = train_script("--out", tmp_path / "a", *options)
    assert ended.returncode == 0, ended.stderr
    assert command("--out", tmp_path / "b", *options)[0] == 0
    assert command("--out", tmp_path / "c", *options[:3], 6)[0] == 0
    a, b, c = (load_file(tmp_path / name / CHECKPOINT) for name in "abc")
    assert a.keys() == b.keys()
    assert [name for name in a if not torch.equal(a[name], b[name])] == []
    weights = "policy.mlp_extractor.encoder.0.weight"
    assert not torch.equal(a[weights], c[weights])
    files = [(tmp_path / name / SELECTOR).read_bytes() for name in "ab"]
    assert files[0] == files[1]
    tables = [(tmp_path / name / EVALUATIONS).read_bytes() for name in "ab"]
    assert tables[0] == tables[1]


# ---- 38: other techniques, versions --------------------------------------------------------


@pytest.mark.parametrize("names", [["solo"], ["HOG", "CALC"], [f"new{i}" for i in range(7)]])
def test_38_a_selector_drives_techniques_of_other_names_and_number(trained, names):
    other = random_bank(9, techniques=len(names), queries=15, names=names)
    trace = rollout(load_selector(trained), other, name="ppo", compute_weight=0.3)
    assert trace.techniques == tuple(names)
    assert trace.ran.shape == (15, len(names))
    assert trace.statistic == SICSettings.statistic


def edit(run: Path, **changes: object) -> None:
    config = json.loads((run / "config.json").read_text())
    config["versions"] |= changes
    (run / "config.json").write_text(json.dumps(config))


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"observation": 1},
            f"trained with observation version 1, this program has {VERSION}; train",
        ),
        ({"network": 2}, "trained with network version 2, this program has 1; train"),
        ({"format": None}, "trained with format version None, this program has 1; train"),
        (
            {"statistic": "sum"},
            "the statistic 'sum', this program has mean and evidence and belief; train",
        ),
        ({"statistic": None}, "the statistic None, this program has mean and evidence and belief"),
    ],
)
def test_38_another_version_or_statistic_is_refused_naming_both(copy, command, changes, sentence):
    edit(copy, **changes)
    with pytest.raises(ValueError, match=sentence):
        load_selector(copy)
    status, lines = command("--out", copy, "--resume", "--timesteps", 128)
    assert (status, len(lines)) == (2, 1)
    assert timesteps(copy) == 96


def test_38_a_selector_brings_its_own_statistic(tmp_path, bank_folder):
    train(tmp_path / "mean", small(statistic="mean"), banks=[bank_folder], progress=False)
    trace = rollout(load_selector(tmp_path / "mean"), random_bank(1), name="p", statistic="mean")
    assert trace.statistic == "mean"


@pytest.mark.parametrize(
    "content", ["", "{", "[]", "{}", "null", '{"versions": 3}', "[" * 100_000, "\xff\xfe"]
)
def test_38_a_damaged_config_is_refused(copy, command, content):
    (copy / "config.json").write_bytes(content.encode("latin-1"))
    with pytest.raises(ValueError, match=r"config.json is damaged .*; train the selector again"):
        load_selector(copy)
    status, lines = command("--out", copy, "--resume")
    assert (status, len(lines)) == (2, 1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("training", None),
        ("training", {"timesteps": "many"}),
        ("training", {"shoe": 1}),
        ("environment", {"bank": "x"}),
        ("environment", 4),
    ],
)
def test_38_a_config_with_other_contents_is_refused(copy, command, name, value):
    config = json.loads((copy / "config.json").read_text())
    config[name] = {**config[name], **value} if isinstance(value, dict) else value
    (copy / "config.json").write_text(json.dumps(config))
    status, lines = command("--out", copy, "--resume")
    assert (status, len(lines)) == (2, 1), lines
    assert "config.json" in lines[0]


@pytest.mark.parametrize("damage", ["missing", "empty", "garbage", "truncated", "longer", "folder"])
def test_38_damaged_weights_are_refused(copy, damage):
    file = copy / SELECTOR
    content = file.read_bytes()
    file.unlink()
    if damage == "folder":
        file.mkdir()
    elif damage != "missing":
        made = {"empty": b"", "garbage": bytes(range(256)), "truncated": content[:-9]}
        file.write_bytes(made.get(damage, content + b"more"))
    expected = FileNotFoundError if damage in ("missing", "folder") else ValueError
    with pytest.raises(expected, match=rf"{SELECTOR}.*; train"):
        load_selector(copy)


def test_38_bit_flips_in_the_header_are_refused_or_change_nothing_but_numbers(copy):
    file = copy / SELECTOR
    content = file.read_bytes()
    size = 8 + int.from_bytes(content[:8], "little")
    for at in range(0, size, 11):
        flipped = bytearray(content)
        flipped[at] ^= 1 << at % 8
        file.write_bytes(flipped)
        try:
            network = load_selector(copy).network
        except ValueError as error:
            assert SELECTOR in str(error)  # noqa: PT017  (some flips are harmless)
        else:
            assert network.state_dict().keys() == load_file(file).keys()


# ---- bad input -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("--statistic", "evidense"), "statistic 'evidense'"),
        (("--timesteps", 0), "timesteps is 0; give a whole number >= 1"),
        (("--timesteps", "many"), "argument --timesteps: invalid int value: 'many'"),
        (("--n-envs", 0), "n_envs is 0; give a whole number >= 1"),
        (("--seed", -1), "seed is -1; give"),
        (("--bank", "nowhere"), "nowhere does not exist; check the name"),
        (("--timestep", 5), "did you mean '--timesteps'"),
        (("--resume",), "is no run folder: config.json is missing; train one first"),
    ],
)
def test_bad_arguments_exit_with_2_and_leave_nothing(tmp_path, command, arguments, sentence):
    status, lines = command("--out", tmp_path / "new", *arguments)
    assert (status, len(lines)) == (2, 1)
    assert sentence in lines[0]
    assert not (tmp_path / "new").exists()


def test_a_used_folder_is_refused_and_left_alone(copy, command, tmp_path):
    before = {file.name: file.read_bytes() for file in copy.iterdir()}
    status, lines = command("--out", copy, "--timesteps", 96)
    assert (status, len(lines)) == (2, 1)
    assert "holds a training already (checkpoint.safetensors); resume it or give" in lines[0]
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before
    (copy / CHECKPOINT).unlink()
    assert "(selector.safetensors)" in command("--out", copy)[1][0]
    (tmp_path / "file").touch()
    assert command("--out", tmp_path / "file")[1][0].endswith("file is a file; give a folder")


@pytest.mark.parametrize(
    "option",
    [("--seed", 3), ("--n-envs", 8), ("--statistic", "mean"), ("--batch-size", 9), ("--epochs", 9)],
)
def test_resuming_with_other_arguments_is_refused(copy, command, option):
    status, lines = command("--out", copy, "--resume", *option)
    assert (status, len(lines)) == (2, 1)
    assert f"is {option[1]}, but" in lines[0]
    assert "leave it out to resume" in lines[0]


def test_resuming_on_other_routes_is_refused(copy, command):
    status, lines = command("--out", copy, "--resume", "--simulation", "retimed=0.125")
    assert (status, len(lines)) == (2, 1)
    assert "simulation is {'retimed': 0.125}, but" in lines[0]
    assert "leave it out to resume" in lines[0]


def test_resuming_a_run_on_banks_in_memory_asks_for_them(tmp_path, bank):
    train(tmp_path, small(), banks=[bank], progress=False)
    with pytest.raises(ValueError, match="on routes in memory; give them again to resume"):
        train(tmp_path, small(timesteps=128), resume=True, progress=False)
    train(tmp_path, small(timesteps=128), banks=[bank], resume=True, progress=False)
    assert timesteps(tmp_path) == 128


def test_40_the_command_itself_warns_of_nothing(tmp_path, bank_folder):
    """With ``-W error`` and the real defaults of the parser."""
    options = ("--out", tmp_path / "run", "--bank", bank_folder, "--timesteps", 96, "--n-envs", 3)
    ended = train_script(*options)
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == ""
    assert f"compare it with --policy ppo:{tmp_path / 'run'}" in ended.stdout
