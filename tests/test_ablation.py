"""What a selector makes of the observation's features."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from amusic_gym.envs.observation import observation_names

pytestmark = pytest.mark.slow

SCRIPTS = Path(__file__).parent.parent / "scripts"


@pytest.fixture
def script(monkeypatch):
    """``scripts/ablation.py``, imported."""
    monkeypatch.syspath_prepend(SCRIPTS)
    return importlib.import_module("ablation")


def test_every_feature_is_found_by_its_name_and_nothing_else_changes(script):
    names = observation_names(("A", "B"))
    observation = np.zeros((3, len(names)), np.float32)
    for name in script.NAMES:
        changed = observation.copy()
        script.entries(changed, name)[:] = 1.0
        wanted = [f"{t}.{name[10:]}" for t in "AB"] if "." in name else [f"route.{name}"]
        assert [names[i] for i in np.flatnonzero(changed[0])] == wanted
        assert (changed == changed[0]).all()


def test_means_are_over_the_techniques_that_there_are(script):
    observation = np.random.default_rng(1).random((4, len(observation_names(("A", "B")))))
    read = [observation[:2].astype(np.float32), observation[2:].astype(np.float32)]
    for each in read:
        script.entries(each, "technique.present")[:] = [1.0, 0.0]
    means = script.means_of(read)
    support = np.concatenate([script.entries(each, "technique.support")[:, 0] for each in read])
    assert means["technique.support"] == pytest.approx(float(support.mean()))
    assert means["technique.present"] == 1.0
    assert means["p_correct"] == pytest.approx(
        float(np.concatenate([script.entries(each, "p_correct") for each in read]).mean())
    )
