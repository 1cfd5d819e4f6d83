"""Fixtures that many tests share: banks, commands and a selector."""

from __future__ import annotations

import os
import runpy
import signal
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import golden
import pytest
from env_cases import random_bank
from script_cases import SCRIPTS, Done

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli import start
from amusic_gym.cli.status import run

# A suite that a shell runs in the background ignores Ctrl-C, and so would the programs it tests.
signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of render_mode="human" go nowhere


LONGEST = ("test_bench.py", "test_demo.py", "test_wheel.py")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with what takes long by itself: at the end, other processes would wait for it."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


@pytest.fixture(scope="session")
def tiny_bank() -> ScoreBank:
    """The bank that is worked out by hand in `golden`: 3 techniques, 5 queries, 6 places."""
    return ScoreBank(
        golden.SCORES,
        golden.TECHNIQUES,
        golden.SECONDS,
        tolerance=golden.TOLERANCE,
        ground_truth=golden.GROUND_TRUTH,
        name="tiny",
    )


@pytest.fixture(scope="session")
def bank() -> ScoreBank:
    """A small smooth bank with ties: 3 techniques, 40 queries, 60 places."""
    return random_bank(1)


@pytest.fixture
def amusic(monkeypatch, capsys) -> Callable[..., tuple[int, str, str]]:
    """Runs a command in this process, as its script does: exit status, stdout and stderr."""

    def run_command(name: str, *words: object) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", [f"{name}.py"])
        with pytest.raises(SystemExit) as ended:
            run(partial(start, name, [*map(str, words)]))
        return ended.value.code or 0, *capsys.readouterr()

    return run_command


@pytest.fixture
def run_script(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., Done]:
    """Runs a script here, as `python SCRIPT ARGUMENTS` would."""

    def here(script: str, *arguments: object) -> Done:
        path = SCRIPTS / script
        monkeypatch.syspath_prepend(str(path.parent))
        monkeypatch.setattr(sys, "argv", [str(path), *map(str, arguments)])
        with pytest.raises(SystemExit) as end:
            runpy.run_path(str(path), run_name="__main__")
        assert isinstance(end.value.code, int)
        return Done(end.value.code, *capsys.readouterr())

    return here


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run folder whose selector was never trained."""
    import torch
    from amusic_agents import run_folder
    from amusic_agents.network import NetworkConfig, SelectorNetwork

    folder = tmp_path_factory.mktemp("run")
    torch.manual_seed(0)
    config = NetworkConfig()
    run_folder.write_selector(folder, SelectorNetwork(config), config)
    run_folder.write_config(
        folder, {"versions": run_folder.versions("evidence"), "environment": {}}
    )
    return folder


@pytest.fixture
def two_ray_workers() -> Iterator[None]:
    """A Ray cluster of two workers on this machine, which executors find."""
    ray = pytest.importorskip("ray", reason='pip install "amusic-gym[ray]"')
    ray.init(
        address="local",
        num_cpus=2,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
        object_store_memory=80_000_000,
    )
    yield
    ray.shutdown()
