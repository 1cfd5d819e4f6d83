"""What the tests of the belief share: planted routes, comparisons with the loops."""

from __future__ import annotations

import math

import numpy as np
import oracle_belief

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation.calibration import coefficients

CLOSE = 1e-5
"""The kernels keep places in single precision, some 1e-7; a frame builds on all before it."""


def planted(
    places, references: int, *, strengths=(6.0, 5.0), noise: float = 1.0, seed: int = 0, **options
) -> ScoreBank:
    """Frames at `places`; each technique's scores rise around the true one, in noise.

    Frames at one place have the same noise: they are the same image.
    """
    rng = np.random.default_rng(seed)
    near = np.exp(-0.5 * ((np.arange(references) - np.arange(references)[:, None]) / 1.5) ** 2)
    shape = (len(strengths), references, references)
    rows = rng.normal(0.0, noise, shape) + np.reshape(strengths, (-1, 1, 1)) * near
    scores = rows[:, np.asarray(places)]
    names = [f"T{t}" for t in range(len(strengths))]
    options = {"tolerance": 2, "ground_truth": np.asarray(places), **options}
    return ScoreBank(scores, names, np.ones(len(names)), **options)


def summary_of(env: TechniqueSelectionEnv):
    """RouteBelief of a single environment."""
    return env.task.episodes.estimator.state.beliefs[0, 0]


def belief_of(env: TechniqueSelectionEnv) -> np.ndarray:
    """(modes, R) belief of a single environment."""
    size = env.task.episodes.routes[0].bank.references
    return env.task.episodes.estimator.state.modes[0, 0, :, :size]


def settings_of(bank: ScoreBank, **options) -> oracle_belief.Settings:
    """What the explicit loops need to know of a route."""
    return oracle_belief.Settings(
        coefficients=coefficients("belief"),
        tolerance=bank.tolerance,
        seconds=bank.seconds,
        **options,
    )


def slack(*logarithms: float) -> float:
    """How far logarithms of shares and odds may differ: the rarer, the rounder the loops' are."""
    return 10 * CLOSE + 1e-14 * math.exp(min(max(abs(x) for x in logarithms), 28.0))


def assert_own(info: dict, known, t: int, own: oracle_belief.Own) -> None:
    """What a technique's row made of the belief."""
    room = slack(own.statistic, own.statistic - own.correction, own.margin)
    assert info["place"][t] == known["place"] == own.place
    assert info["statistic"][t] == known["statistic"]
    assert info["correction"][t] == known["correction"]
    for name in ("statistic", "correction", "margin"):
        assert abs(known[name] - getattr(own, name)) <= room, (t, name)
    for name in ("news", "weight", "log_likelihood"):
        assert abs(known[name] - getattr(own, name)) <= CLOSE, (t, name)


def assert_frame(env: TechniqueSelectionEnv, info: dict, step: oracle_belief.Step) -> None:
    """One frame of a single environment is the loops'."""
    frame, summary = step.frame, summary_of(env)
    np.testing.assert_allclose(belief_of(env).sum(axis=0), frame.places, rtol=0, atol=CLOSE)
    assert summary["place"] == frame.place
    assert summary["rows"] == frame.rows
    for name in ("share", "rival", "p_steady", "log_likelihood"):
        assert abs(summary[name] - getattr(frame, name)) <= CLOSE, name
    assert info["ran"].tolist() == step.ran
    assert info["prediction"] == step.prediction
    room = slack(step.margin, oracle_belief.log_odds(frame.share))
    for name in ("confidence", "margin", "p_correct"):
        assert abs(info[name] - getattr(step, name)) <= 2 * room, name
    techniques = env.task.episodes.estimator.state.techniques[0, 0]
    statistics = {}
    for t, own in enumerate(frame.own):
        if own is None:
            assert [info[key][t] for key in ("place", "statistic", "correction")] == [0, 0, 0]
        else:
            assert_own(info, techniques[t], t, own)
            statistics[t] = own.statistic
    if statistics:
        best = max(statistics.values())
        assert statistics[info["technique"]] >= best - 2 * slack(best)
    else:
        assert info["technique"] == -1
