"""The examples run, those of libraries that are installed, and say what they reach."""

from __future__ import annotations

import re
import runpy
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import pytest
from amusic_agents.evaluation import held_out_routes, mean_reward

from amusic_gym.cli.rewards import reference_rewards
from amusic_gym.envs.sources import ordinary
from amusic_gym.envs.wrappers import VectorDiscreteSubsets

ROOT = Path(__file__).resolve().parent.parent
EXAMPLES = sorted(path for path in (ROOT / "examples").iterdir() if path.is_dir())
NAMES = [path.name for path in EXAMPLES]
INSTALLED = ("cleanrl_ppo", "sb3_dqn", "sb3_maskable_ppo", "sb3_recurrent_ppo")
"""Examples whose packages `make setup` installs."""


def requirements(name: str) -> list[tuple[str, str]]:
    text = (ROOT / "examples" / name / "requirements.txt").read_text("utf-8")
    return re.findall(r"^([\w-]+)==(\S+)$", text, re.MULTILINE)


def missing(name: str) -> bool:
    try:
        return any(not version(package) for package, _ in requirements(name))
    except PackageNotFoundError:
        return True


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_an_example_runs_and_says_what_it_reaches(name, monkeypatch, capsys):
    if missing(name):
        assert name not in INSTALLED
        pytest.skip(f"pip install -r examples/{name}/requirements.txt")
    path = ROOT / "examples" / name / f"{name}.py"
    monkeypatch.setattr(sys, "argv", [str(path), "--timesteps", "4096", "--routes", "2"])
    runpy.run_path(str(path), run_name="__main__")
    last = capsys.readouterr().out.splitlines()[-1]
    found = re.fullmatch(r"mean reward per frame (-?\d\.\d{3})", last)
    assert found
    assert -0.3 <= float(found[1]) <= 1.0  # p̂ - 0.3 · compute


@pytest.mark.parametrize("name", NAMES)
def test_an_example_is_one_file_that_says_how_to_run_it(name):
    folder = ROOT / "examples" / name
    files = {path.name for path in folder.iterdir() if path.name != "__pycache__"}
    assert files == {f"{name}.py", "requirements.txt"}
    text = (folder / f"{name}.py").read_text("utf-8")
    assert f"\n    pip install -r examples/{name}/requirements.txt\n" in text
    assert f"\n    python examples/{name}/{name}.py\n" in text
    assert text.count("\n") <= 150
    lock = (ROOT / "requirements.lock").read_text("utf-8")
    pins = dict(requirements(name))
    assert "torch" in pins
    for package, number in pins.items():  # else the example is of other versions than the tests
        assert f"\n{package}==" not in lock or f"\n{package}=={number}\n" in lock


def test_the_page_tells_what_each_example_reaches():
    page = (ROOT / "docs" / "training.md").read_text("utf-8")
    for name in NAMES:
        text = (ROOT / "examples" / name / f"{name}.py").read_text("utf-8")
        said = re.search(r"Reaches (\d\.\d{3})", text)
        assert said, f"{name} does not say what it reaches"
        row = re.search(rf"^\| \[{name}\]\(\.\./examples/{name}/{name}\.py\) \|.*$", page, re.M)
        assert row
        assert f"| {said[1]} |" in row[0]


def test_the_mean_reward_is_that_of_the_table():
    banks = held_out_routes(ordinary("evidence"), 2)
    options = {"statistic": "evidence", "progress": False}
    found = reference_rewards(["random:0", "music"], banks, [0.3], **options)

    def bits(bit):
        return lambda observation, info: np.full(info["present"].shape, bit)

    for policy, bit in (("random:0", 0), ("music", 1)):
        reached = mean_reward(bits(bit), compute_weight=0.3, routes=2)
        assert reached == pytest.approx(found[policy][0].mean(), abs=1e-9)
    reached = mean_reward(
        lambda observation, info: np.full(2, 14),
        compute_weight=0.3,
        routes=2,
        wrap=VectorDiscreteSubsets,
    )
    assert reached == pytest.approx(found["music"][0].mean(), abs=1e-9)
