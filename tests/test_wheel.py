"""The wheel: what it holds, under names that clash with nobody's."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from amusic_gym.cli import COMMANDS

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """The wheel of this checkout."""
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (wheel,) = out.glob("*.whl")
    return wheel


@pytest.fixture(scope="module")
def names(wheel) -> set[str]:
    """Names of the files in the wheel."""
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


def test_the_wheel_has_no_package_of_another_s_name(names):
    tops = {name.split("/")[0] for name in names}
    packages = {top for top in tops if not top.endswith(".dist-info")}
    assert packages == {"amusic_gym", "amusic_agents", "amusic_baselines"}


def test_the_wheel_has_every_file_of_the_packages(names):
    for folder in ("amusic_gym", "agents/amusic_agents", "baselines/amusic_baselines"):
        root = ROOT / folder
        files = (path for path in root.rglob("*") if path.is_file())
        own = {
            path.relative_to(root.parent).as_posix()
            for path in files
            if "__pycache__" not in path.parts and path.suffix not in (".nbi", ".nbc")
        }
        assert own <= names
    assert "amusic_agents/pretrained/evidence/selector.safetensors" in names
    assert "amusic_gym/py.typed" in names


@pytest.fixture(scope="module")
def run(wheel, tmp_path_factory):
    """Runs a program of the installed wheel from another folder than the checkout."""
    site = tmp_path_factory.mktemp("site")
    offline = ("--no-deps", "--no-index", "--disable-pip-version-check", "--quiet")
    install = [sys.executable, "-m", "pip", "install", *offline, "--target", str(site), str(wheel)]
    subprocess.run(install, check=True, capture_output=True, timeout=120)
    elsewhere = tmp_path_factory.mktemp("elsewhere")

    def run(*words: str) -> str:
        if words[0] == "amusic":
            words = (sys.executable, str(site / "bin" / "amusic"), *words[1:])
        done = subprocess.run(
            [*words],
            cwd=elsewhere,
            env={**os.environ, "PYTHONPATH": str(site)},
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
        )
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    packages = "amusic_gym, amusic_agents, amusic_baselines"
    found = f"import {packages}; print(*(each.__file__ for each in ({packages})))"
    places = run(sys.executable, "-c", found).split()
    assert all(Path(place).is_relative_to(site) for place in places)
    run.folder = elsewhere
    return run


def test_the_command_of_the_wheel_works_without_a_checkout(run):
    said = run("amusic", "--help")
    assert all(re.search(rf"^    {name}\s", said, re.MULTILINE) for name in COMMANDS)
    assert run(sys.executable, "-m", "amusic_gym", "--help") == said
    size = ("--queries", "30", "--references", "40")
    made = run("amusic", "bank", "simulate", "--seed", "1", *size, "--out", "bank")
    assert "30 queries, 40 references" in made
    policies = ("--policy", "ppo", "amusic", "--compute-weight", "0.3")
    assert "ppo" in run("amusic", "compare", "--bank", "bank", *policies, "--out", "out")
    rows = json.loads((run.folder / "out" / "results.json").read_text("utf-8"))["rows"]
    assert [row["policy"] for row in rows] == ["ppo", "amusic"]
