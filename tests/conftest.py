"""Banks that many tests share."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from functools import partial

import golden
import pytest
from env_cases import random_bank

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli import start
from amusic_gym.cli.status import run

# A suite that a shell runs in the background ignores Ctrl-C, and so would the programs it tests.
signal.signal(signal.SIGINT, signal.default_int_handler)

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # windows of render_mode="human" go nowhere


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
