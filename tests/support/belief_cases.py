"""What the tests of the belief share: rates, planted routes, comparisons with the loops."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator
from unittest import mock

import numpy as np
import oracle_belief

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation.belief import Rates, estimator
from amusic_gym.estimation.calibration import coefficients

CLOSE = 1e-6

RANGES = {  # of rates, far beyond what any fit would give
    "sharpness": (0.05, 5.0),
    "convexity": (0.0, 2.0),
    "most": (1.0, 12.0),
    "trust": (0.02, 0.98),
    "sharper": (0.0, 1.0),
    "sharpest": (0.0, 1.0),
    "learn": (0.0, 2.0),
    "relearn": (0.0, 0.5),
    "hub": (0.0, 1.0),
    "hub_spread": (0.0, 1.0),
    "hub_count": (0.5, 100.0),
    "hub_memory": (2.0, 2000.0),
    "novel": (0.01, 1.9),
    "repeat": (0.0, 1.0),
    "contrast": (0.0, 2.0),
    "stand": (1.0, 300.0),
    "jump": (0.0005, 0.5),
    "jump_novel": (0.0, 3.0),
    "jump_usual": (0.2, 5.0),
    "change": (0.0, 0.9),
    "slack": (0.0, 0.4),
    "steady": (0.0, 1.0),
    "steady_jump": (1e-5, 0.1),
    "wandering": (0.0, 1.0),
    "wander": (0.0, 1.0),
    "leave": (0.0, 0.3),
    "settle": (0.0, 0.3),
}
assert tuple(RANGES) == Rates._fields


def drawn_rates(rng: np.random.Generator) -> Rates:
    return Rates(**{name: float(rng.uniform(*ends)) for name, ends in RANGES.items()})


@contextlib.contextmanager
def shipped_with(rates: Rates) -> Iterator[None]:
    """Environments made and reset meanwhile take these rates for the fitted ones.

    Both, because a reset that needs more room asks for the rates again.
    """
    with mock.patch.object(estimator, "fitted", return_value=rates):
        yield


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


def mind_of(env: TechniqueSelectionEnv):
    """MIND record of a single environment."""
    return env.task.episodes.estimator.state.minds[0, 0]


def belief_of(env: TechniqueSelectionEnv) -> np.ndarray:
    """(ways, R) belief of a single environment."""
    minds = env.task.episodes.estimator.state
    size = env.task.episodes.routes[0].bank.references
    return minds.belief[0, 0, minds.minds[0, 0]["side"], :, -minds.prior.size :][:, :size]


def settings_of(env: TechniqueSelectionEnv, bank: ScoreBank, **options) -> oracle_belief.Settings:
    """What the explicit loops need to know of an environment."""
    return oracle_belief.Settings(
        rates=env.task.episodes.estimator.state.rates,
        coefficients=coefficients("belief"),
        tolerance=bank.tolerance,
        seconds=bank.seconds,
        **options,
    )


def slack(*logarithms: float) -> float:
    """How far logarithms of shares and odds may differ: the rarer, the rounder they are."""
    return CLOSE + 1e-14 * math.exp(min(max(abs(x) for x in logarithms), 28.0))


def assert_own(info: dict, witness, t: int, own: oracle_belief.Own) -> None:
    """What a technique's row made of the belief."""
    room = slack(own.statistic, own.statistic - own.correction, own.margin)
    assert info["place"][t] == witness["place"] == own.place
    assert info["statistic"][t] == witness["statistic"]
    assert info["correction"][t] == witness["correction"]
    for name in ("statistic", "correction", "margin"):
        assert abs(witness[name] - getattr(own, name)) <= room, (t, name)
    for name in ("weight", "trust", "once", "twice", "fourfold", "said"):
        assert abs(witness[name] - getattr(own, name)) <= CLOSE, (
            t,
            name,
            witness[name],
            getattr(own, name),
        )


def assert_frame(env: TechniqueSelectionEnv, info: dict, step: oracle_belief.Step) -> None:
    """One frame of a single environment is the loops'."""
    frame, mind = step.frame, mind_of(env)
    np.testing.assert_allclose(belief_of(env).sum(axis=0), frame.places, rtol=0, atol=1e-9)
    assert mind["place"] == frame.place
    assert mind["heard"] == frame.heard
    for name in ("share", "rival", "steady", "strange", "said"):
        assert abs(mind[name] - getattr(frame, name)) <= CLOSE, name
    assert info["ran"].tolist() == step.ran
    assert info["prediction"] == step.prediction
    room = slack(step.margin, oracle_belief.log_odds(frame.share))
    for name in ("confidence", "margin", "p_correct"):
        assert abs(info[name] - getattr(step, name)) <= 10 * room, name
    witnesses = env.task.episodes.estimator.state.witnesses[0, 0]
    statistics = {}
    for t, own in enumerate(frame.own):
        if own is None:
            assert [info[key][t] for key in ("place", "statistic", "correction")] == [0, 0, 0]
        else:
            assert_own(info, witnesses[t], t, own)
            statistics[t] = own.statistic
    if statistics:
        best = max(statistics.values())
        assert statistics[info["technique"]] >= best - 2 * slack(best)
    else:
        assert info["technique"] == -1
