"""Banks that many tests share."""

from __future__ import annotations

import os
import signal

import golden
import pytest
from env_cases import random_bank

from amusic_gym.banks.bank import ScoreBank

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
