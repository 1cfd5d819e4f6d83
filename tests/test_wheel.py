"""The wheel: what it holds, under names that clash with nobody's."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def names(tmp_path_factory) -> set[str]:
    """Names of the files in the wheel of this checkout."""
    out = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)]
    subprocess.run(build, cwd=ROOT, check=True, capture_output=True, timeout=120)
    (wheel,) = out.glob("*.whl")
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
