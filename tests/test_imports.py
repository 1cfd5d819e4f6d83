"""Imports point one way, and importing the package loads nothing heavy."""

from __future__ import annotations

import ast
import graphlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PATHS = (ROOT, ROOT / "agents", ROOT / "baselines")
HEAVY = ("torch", "cv2", "pygame", "stable_baselines3", "matplotlib", "numba", "scipy.stats")
OURS = {"amusic_gym", "amusic_baselines", "amusic_agents", "scripts", "tests"}

# What each package may use of the others; the room of the commands uses them all.
ALLOWED = {
    "amusic_gym": set(),
    "amusic_baselines": {"amusic_gym"},
    "amusic_agents": {"amusic_gym"},
    "scripts": {"amusic_gym", "amusic_baselines", "amusic_agents"},
}
FOLDERS = {"amusic_baselines": "baselines", "amusic_agents": "agents"}

# Inside amusic_gym: the rooms, each built on those before it only.
ROOMS = (
    *("utils", "kernels", "techniques", "banks", "routes", "worlds", "pretraining"),
    *("extraction", "estimation", "policies", "envs", "live", "evaluation", "cli"),
)

WINGS = ("worlds", "pretraining")
"""Rooms that only their ``__init__`` opens."""


def loaded_after(code: str) -> set[str]:
    """Names of the modules that a new process holds after ``code``."""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", f"{code}\nimport sys; print(*sys.modules)"],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(map(str, PATHS))},
        timeout=120,
        check=True,
    )
    return set(done.stdout.split())


def imports(source: str) -> set[str]:
    """Dotted names that a source file imports anywhere but for type checking."""
    found = set()
    pending: list[ast.AST] = [ast.parse(source)]
    while pending:
        node = pending.pop()
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            pending.extend(node.orelse)
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "imports are absolute"
            found |= {f"{node.module}.{alias.name}" for alias in node.names}
        pending.extend(ast.iter_child_nodes(node))
    return found


def files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.py"))


def test_importing_the_package_loads_nothing_heavy():
    loaded = loaded_after("import amusic_gym")
    assert {"amusic_gym", "numpy", "gymnasium"} <= loaded
    assert not loaded.intersection(HEAVY)
    known = {"numpy", "gymnasium", "amusic_gym"}
    plain = loaded_after("import numpy, gymnasium")
    added = {name.split(".")[0] for name in loaded - plain}
    assert added - set(sys.stdlib_module_names) - {"__main__"} <= known


def test_an_episode_needs_numba_but_nothing_else_heavy():
    loaded = loaded_after(
        "import gymnasium as gym\n"
        "env = gym.make('amusic_gym:amusic_gym/TechniqueSelection-v0')\n"
        "env.reset(seed=0)\n"
        "env.step(env.action_space.sample())\n"
    )
    assert loaded.intersection(HEAVY) == {"numba"}


def test_policies_that_are_not_learned_need_no_network():
    loaded = loaded_after(
        "import amusic_baselines, amusic_gym.evaluation.rollout, amusic_gym.evaluation.metrics"
    )
    assert not loaded.intersection(set(HEAVY) - {"numba"})


@pytest.mark.parametrize("words", [[], ["bank"], ["bank", "images"]])
def test_help_is_quick(words):
    """What it shows is read from modules that load nothing heavy."""
    loaded = loaded_after(
        "import contextlib, sys\n"
        f"sys.argv = ['amusic', *{words}, '--help']\n"
        "from amusic_gym.cli import main\n"
        "with contextlib.suppress(SystemExit): main()"
    )
    assert not loaded.intersection(HEAVY)


@pytest.mark.parametrize("package", ALLOWED)
def test_packages_import_one_way(package):
    wrong = []
    for file in files(ROOT / FOLDERS.get(package, ".") / package):
        if file.is_relative_to(ROOT / "amusic_gym/cli"):
            continue
        for name in imports(file.read_text(encoding="utf-8")):
            top = name.split(".")[0]
            if top in OURS - {package} - ALLOWED[package]:
                wrong.append(f"{file.relative_to(ROOT)} imports {name}")
    assert not wrong


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_import_one_way(room):
    later = ROOMS[ROOMS.index(room) + 1 :]
    wrong = []
    for file in files(ROOT / "amusic_gym" / room):
        for name in imports(file.read_text(encoding="utf-8")):
            pieces = name.split(".")
            if pieces[0] == "amusic_gym" and pieces[1] in later:
                wrong.append(f"{file.relative_to(ROOT)} imports {name}")
    assert not wrong


@pytest.mark.parametrize("wing", WINGS)
def test_a_closed_wing_is_entered_by_its_door_only(wing):
    inside, door = ROOT / "amusic_gym" / wing, f"amusic_gym.{wing}"
    modules = {f"{door}.{file.stem}" for file in files(inside)}
    wrong = []
    for package in ALLOWED:
        for file in files(ROOT / FOLDERS.get(package, ".") / package):
            for name in imports(file.read_text(encoding="utf-8")):
                behind = any(f"{name}.".startswith(f"{module}.") for module in modules)
                if behind and inside not in file.parents:
                    wrong.append(f"{file.relative_to(ROOT)} imports {name}")
    assert not wrong


def test_every_module_stands_in_a_room():
    inside = (ROOT / "amusic_gym").rglob("*.py")
    rooms = {file.relative_to(ROOT / "amusic_gym").parts[0] for file in inside}
    assert rooms == {"__init__.py", "__main__.py", *ROOMS}


def test_no_module_imports_what_imports_it():
    """Whether at the top or when used: a circle has no first module to read."""
    modules = {}
    for package in ALLOWED:
        folder = ROOT / FOLDERS.get(package, ".")
        for file in files(folder / package):
            parts = file.relative_to(folder).with_suffix("").parts
            modules[".".join(parts).removesuffix(".__init__")] = file
    graph = {}
    for name, file in modules.items():
        used = imports(file.read_text(encoding="utf-8"))
        found = {each if each in modules else each.rpartition(".")[0] for each in used}
        graph[name] = {each for each in found if each in modules} - {name}
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the circle


def test_what_tests_share_stands_in_their_support_folder():
    """No test module is imported, neither by another nor by a helper."""
    folder = ROOT / "tests"
    wrong = []
    for file in files(folder):
        for name in imports(file.read_text(encoding="utf-8")):
            if name.removeprefix("tests.").startswith("test_"):
                wrong.append(f"{file.relative_to(ROOT)} imports {name}")
    assert not wrong
    tests = {file.name for file in folder.glob("test_*.py")}
    assert {file.name for file in folder.glob("*.py")} == tests | {"conftest.py"}


def test_the_walk_sees_every_kind_of_import():
    source = """
from __future__ import annotations
import torch.nn as nn
if TYPE_CHECKING:
    from amusic_agents import hidden
else:
    import scipy
def later():
    from amusic_gym.envs import env
    class Inner:
        import amusic_baselines.amusic
"""
    assert imports(source) == {
        "__future__.annotations",
        "torch.nn",
        "scipy",
        "amusic_gym.envs.env",
        "amusic_baselines.amusic",
    }
