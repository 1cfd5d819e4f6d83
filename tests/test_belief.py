"""The belief over places, frame by frame, against explicit loops; and what must hold of it."""

from __future__ import annotations

import itertools

import numpy as np
import oracle_belief
import pytest
from belief_cases import (
    assert_frame,
    belief_of,
    planted,
    settings_of,
    summary_of,
)
from env_cases import infos_of, noisy_bank, random_bank
from hypothesis import given, settings
from hypothesis import strategies as st

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.routes.retime import retime
from amusic_gym.routes.simulate import simulate

pytestmark = pytest.mark.slow

seeds = st.integers(0, 2**32)


def compare(bank: ScoreBank, ran, start: int = 0, allow_idle: bool = True) -> None:
    """Play and compare every frame with the loops."""
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=allow_idle)
    chosen = settings_of(bank, allow_idle=allow_idle)
    steps = oracle_belief.drive(bank.scores[:, start:], ran, chosen)
    env.reset(seed=0, options={"start": start})
    for action, step in zip(ran, steps, strict=True):
        assert_frame(env, env.step(action)[4], step)


def patterned(rng, queries: int, techniques: int, activity: float):
    """What runs when: at random, with a gap in which nothing does."""
    ran = rng.random((queries, techniques)) < activity
    if queries > 8:
        gap = int(rng.integers(queries - 4))
        ran[gap : gap + int(rng.integers(1, 4))] = False
    return ran


# ---- explicit loops ----------------------------------------------------------------------


@pytest.mark.parametrize("spread", [40, 1])
def test_13_many_techniques_that_disagree_or_agree_give_finite_numbers(spread):
    techniques, places = 400, 40
    scores = np.zeros((techniques, 3, places), np.float32)
    for query in range(3):
        scores[np.arange(techniques), query, (np.arange(techniques) + query) % spread] = 1
    names = [f"T{t}" for t in range(techniques)]
    bank = ScoreBank(scores, names, np.ones(techniques), tolerance=1, ground_truth=[0, 1, 2])
    compare(bank, np.ones((3, techniques), bool))


@settings(max_examples=40, deadline=None)
@given(seeds, st.tuples(st.integers(1, 4), st.integers(1, 20)), st.floats(0.1, 1.0))
def test_filter_is_the_loops_on_noise_and_constant_rows(seed, size, activity):
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, *size, int(rng.integers(1, 30)), int(rng.integers(2, 9)))
    start = int(rng.integers(bank.queries))
    ran = patterned(rng, bank.queries - start, size[0], activity)
    compare(bank, ran, start, allow_idle=bool(rng.integers(2)))


@pytest.mark.parametrize("references", range(1, 9))
@pytest.mark.parametrize("tolerance", [0, 1, 4])
def test_filter_is_the_loops_on_tiny_maps(references, tolerance):
    rng = np.random.default_rng(references)
    scores = rng.normal(size=(2, 24, references)).round(1)
    scores[1, 5:8] = 2.0
    truth = np.zeros(24, np.int64)
    bank = ScoreBank(scores, ["A", "B"], [1.0, 2.0], tolerance=tolerance, ground_truth=truth)
    compare(bank, patterned(rng, 24, 2, 0.7))


def aliased(bank: ScoreBank) -> ScoreBank:
    """The second half of the map looks like the first."""
    half = bank.references // 2
    scores = np.concatenate([bank.scores[:, :, :half]] * 2, axis=2)
    return ScoreBank(
        scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=np.arange(scores.shape[1]),
    )


def still(bank: ScoreBank) -> ScoreBank:
    """The robot stands for seven frames, and one technique's camera hangs for good."""
    scores = np.array(bank.scores)
    scores[:, 12:19] = scores[:, 12:13]
    scores[0, 25:] = scores[0, 25]
    return ScoreBank(
        scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=np.arange(scores.shape[1]),
    )


def taken(bank: ScoreBank, frames) -> ScoreBank:
    """A drive that meets some frames of another's, in any order."""
    return ScoreBank(
        bank.scores[:, frames],
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=np.asarray(frames),
    )


@pytest.mark.parametrize("kind", ["smooth", "aliased", "still", "retimed", "turned", "simulated"])
@pytest.mark.parametrize("activity", [0.3, 1.0])
def test_filter_is_the_loops_on_routes(kind, activity):
    rng = np.random.default_rng(5)
    bank = random_bank(3, queries=40, references=46)
    if kind == "simulated":
        bank = planted(np.minimum(np.arange(40), 40), 46, strengths=(4.0, 2.0, 1.0), noise=1.5)
    change = {
        "aliased": aliased,
        "still": still,
        "retimed": lambda b: retime(b, 4),
        "turned": lambda b: taken(b, np.r_[0:20, 20:0:-1]),
    }
    bank = change.get(kind, lambda b: b)(bank)
    compare(bank, patterned(rng, 40, 3, activity))


def test_filter_is_the_loops_when_driven_off_the_map():
    """Beyond the last place, the robot may be anywhere."""
    bank = random_bank(2, queries=30, references=12, ground_truth=np.arange(30) % 12)
    compare(bank, np.ones((30, 3), bool))


def test_filter_is_the_loops_where_places_hardly_vary():
    """A camera at one spot: each place's score is nearly the same on every frame."""
    rng = np.random.default_rng(2)
    scores = rng.normal(size=(2, 1, 20)) + rng.normal(0.0, 0.05, (2, 40, 20))
    bank = ScoreBank(
        scores, ["A", "B"], [1.0, 1.0], tolerance=1, ground_truth=np.zeros(40, np.int64)
    )
    compare(bank, np.ones((40, 2), bool))


@settings(max_examples=20, deadline=None)
@given(seeds, st.integers(3, 40))
def test_filter_is_the_loops_where_places_are_no_candidates(seed, references):
    rng = np.random.default_rng(seed)
    scores = rng.normal(size=(3, 20, references))
    scores[rng.random(scores.shape) < rng.choice([0.1, 0.9])] = -np.inf
    truth = rng.integers(references, size=20)
    bank = ScoreBank(scores, ["A", "B", "C"], [1.0, 1.0, 2.0], tolerance=1, ground_truth=truth)
    compare(bank, patterned(rng, 20, 3, 0.7))


# ---- what must hold ----------------------------------------------------------------------


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(0.0, 1.0))
def test_the_belief_is_a_distribution_after_every_frame(seed, activity):
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, 3, 60, int(rng.integers(1, 40)))
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True)
    env.reset(seed=0)
    for action in rng.random((60, 3)) < activity:
        observation = env.step(action)[0]
        assert (belief_of(env) >= 0.0).all()
        assert belief_of(env).sum() == pytest.approx(1.0, abs=1e-6)
        assert np.isfinite(observation).all()
        summary = summary_of(env)
        techniques = env.task.episodes.estimator.state.techniques[0, 0]
        assert all(np.isfinite(summary[name]) for name in summary.dtype.names)
        assert all(np.isfinite(techniques[name]).all() for name in techniques.dtype.names)
        assert 0.0 <= summary["rival"] <= summary["share"] * 1.02 <= 1.02
        assert 0.0 <= summary["p_steady"] <= 1.0 + 1e-12
        assert ((techniques["weight"] >= 0.0) & (techniques["weight"] <= 1.0)).all()


def test_long_confident_routes_stay_finite():
    """Hundreds of frames of clear rows, then hundreds that contradict all that was believed."""
    places = np.concatenate([np.arange(300), np.arange(300) // 2])
    bank = planted(places, 400, strengths=(12.0,) * 4, noise=0.5)
    infos = infos_of(TechniqueSelectionEnv(bank, statistic="belief"), np.ones((600, 4)))
    found = np.array([info["prediction"] for info in infos])
    assert all(np.isfinite(info["confidence"]) for info in infos)
    assert (abs(found - places) <= 2)[np.r_[20:300, 310:600]].mean() > 0.98


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_the_future_changes_nothing(seed):
    rng = np.random.default_rng(seed)
    bank = random_bank(int(rng.integers(100)), queries=30)
    cut = int(rng.integers(1, 30))
    scores = np.array(bank.scores)
    scores[:, cut:] = rng.normal(size=scores[:, cut:].shape)
    other = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=np.arange(scores.shape[1])
    )
    ran = patterned(rng, 30, 3, 0.7)
    first, second = ([*map(fingerprint, steps_of(b, ran))] for b in (bank, other))
    assert first[:cut] == second[:cut]


def steps_of(bank: ScoreBank, ran, **arguments):
    """Every step of an episode, its belief and the summary of it."""
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True, **arguments)
    env.reset(seed=0)
    for action in ran:
        yield env.step(action), belief_of(env).copy(), summary_of(env).copy()


def fingerprint(step) -> list[bytes]:
    return [step[0][0].tobytes(), step[1].tobytes(), step[2].tobytes()]


@settings(max_examples=10, deadline=None)
@given(seeds, st.permutations(range(4)))
def test_the_order_of_techniques_does_not_matter(seed, order):
    rng = np.random.default_rng(seed)
    bank = random_bank(int(rng.integers(100)), techniques=4, queries=30, levels=1000)
    names = [bank.techniques[t] for t in order]
    other = ScoreBank(
        bank.scores[order],
        names,
        bank.seconds[order],
        tolerance=2,
        ground_truth=np.arange(bank.queries),
    )
    ran = patterned(rng, 30, 4, 0.6)
    for one, two in zip(steps_of(bank, ran), steps_of(other, ran[:, order]), strict=True):
        first, second = one[0][4], two[0][4]
        np.testing.assert_allclose(one[1], two[1], rtol=0, atol=1e-5)
        assert first["prediction"] == second["prediction"]
        if not first["idle"]:
            assert first["technique"] == order[second["technique"]]
        for key in ("place", "statistic", "correction"):
            np.testing.assert_allclose(first[key][order], second[key], rtol=1e-5, atol=1e-4)


@settings(max_examples=10, deadline=None)
@given(seeds)
def test_units_of_the_scores_do_not_matter(seed):
    """Each technique's scores times a positive number plus another."""
    rng = np.random.default_rng(seed)
    bank = random_bank(int(rng.integers(100)), queries=30)
    factors = rng.choice([0.001, 0.3, 1.0, 70.0], (3, 1, 1))
    scores = factors * (bank.scores.astype(np.float64) + rng.integers(-30, 30, (3, 1, 1)))
    other = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=np.arange(scores.shape[1])
    )
    ran = patterned(rng, 30, 3, 0.7)
    for one, two in zip(steps_of(bank, ran), steps_of(other, ran), strict=True):
        np.testing.assert_allclose(one[1], two[1], rtol=0, atol=1e-4)
        assert one[0][4]["prediction"] == two[0][4]["prediction"]


def test_empty_slots_change_nothing():
    bank = random_bank(7, queries=30)
    ran = patterned(np.random.default_rng(0), 30, 3, 0.6)
    wide = np.concatenate([ran, np.ones((30, 3), bool)], axis=1)
    for one, two in zip(steps_of(bank, ran), steps_of(bank, wide, slots=6), strict=True):
        assert fingerprint(one)[1:] == fingerprint(two)[1:]
        for key in ("prediction", "confidence", "technique", "seconds"):
            assert one[0][4][key] == two[0][4][key]


# ---- motion ------------------------------------------------------------------------------


def off_by(statistic: str, bank: ScoreBank, places) -> np.ndarray:
    env = TechniqueSelectionEnv(bank, statistic=statistic)
    infos = infos_of(env, np.ones((len(places), len(bank.techniques))))
    return np.abs([info["prediction"] for info in infos] - np.asarray(places))


MOTIONS = {  # after 40 frames at one place per frame
    "stop": np.r_[0:40, [40] * 30, 40:70],
    "half speed": np.r_[0:40, 40 + np.arange(50) // 2],
    "double speed": np.r_[0:40, 40 + 2 * np.arange(30)],
    "jump ahead": np.r_[0:40, 95:135],
    "jump back": np.r_[60:100, 10:50],
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_belief_follows_any_motion(motion):
    places = MOTIONS[motion]
    bank = planted(places, 150)
    assert (off_by("belief", bank, places)[50:] <= 3).all()
    assert (off_by("evidence", bank, places)[50:] <= 2).mean() < 0.6


@pytest.mark.parametrize("places", [np.r_[100:0:-1], np.r_[0:40, 40:0:-1]])
def test_weak_techniques_follow_a_drive_backwards(places):
    bank = planted(places, 150, strengths=(1.5, 1.5))
    assert (off_by("belief", bank, places)[-30:] <= 3).all()


@pytest.mark.parametrize("references", [60, 200])
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("weak", [2.0, 3.0])
def test_standing_carries_the_prediction_nowhere(references, seed, weak):
    """The same rows again and again have no news: the belief stays, and finds the robot again."""
    places = np.r_[5:45, [45] * 60, 45:60]
    bank = planted(places, references, strengths=(weak, weak), seed=seed)
    off = off_by("belief", bank, places)
    assert max(off[40:100]) <= 12
    assert np.ptp(off[60:100]) <= 3
    assert max(off[-5:]) <= 2


def test_without_rows_the_prediction_moves_on_but_standing_is_seen_in_them():
    places = np.r_[0:40]
    bank = planted(places, 100)
    env = TechniqueSelectionEnv(bank, statistic="belief", allow_idle=True)
    actions = np.r_[np.ones((20, 2)), np.zeros((20, 2))]
    found = [info["prediction"] for info in infos_of(env, actions)]
    assert np.diff(found[19:]).tolist() == [1] * 20
    shares = [step[2]["share"] for step in steps_of(bank, actions)]
    assert all(a > b for a, b in itertools.pairwise(shares[20:]))


def test_hubs_that_attract_every_query_are_learned():
    """Places that every row rates highest are no match; a raw row sees nothing else."""
    places = np.arange(60)
    bank = planted(places, 80, strengths=(4.0,))
    scores = np.array(bank.scores)
    scores[:, :, [11, 37, 66]] += 12.0
    hubs = ScoreBank(scores, ["T0"], [1.0], tolerance=2, ground_truth=places)
    assert set(scores[0].argmax(axis=1)) <= {11, 37, 66}
    assert (off_by("belief", hubs, places)[20:] <= 2).mean() > 0.9


@pytest.mark.parametrize("copies", [2, 3])
@pytest.mark.parametrize("motion", ["recorded", "kidnapped"])
def test_54_a_copy_of_a_technique_changes_nothing(copies, motion):
    bank = simulate(4, queries=120, references=150, techniques=3, motion=motion)
    names = [f"{name}{copy}" for copy in range(copies) for name in bank.techniques]
    several = ScoreBank(
        np.concatenate([bank.scores] * copies),
        names,
        np.tile(bank.seconds, copies),
        tolerance=bank.tolerance,
        ground_truth=bank.truth,
    )
    one, many = (
        infos_of(TechniqueSelectionEnv(b, statistic="belief"), np.ones((120, len(b.techniques))))
        for b in (bank, several)
    )
    places = np.array([[info["prediction"] for info in infos] for infos in (one, many)])
    assert (places[0] == places[1]).mean() > 0.98
    twice = several.subset([names[0], names[3]])
    first = steps_of(bank.subset(bank.techniques[:1]), np.ones((120, 1)))
    second = steps_of(twice, np.ones((120, 2)))
    for alone, both in zip(first, second, strict=True):
        np.testing.assert_allclose(alone[1], both[1], rtol=0, atol=1e-4)


def test_techniques_that_err_alike_share_a_vote():
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(3, 100, 120))
    noise[1] = 0.9 * noise[0] + 0.4 * noise[1]
    bank = ScoreBank(noise, ["A", "B", "C"], [1.0] * 3, tolerance=2, ground_truth=np.arange(100))
    env = TechniqueSelectionEnv(bank, statistic="belief")
    infos_of(env, np.ones((100, 3)))
    weights = env.task.episodes.estimator.state.techniques[0, 0]["weight"]
    assert weights[0] == pytest.approx(weights[1], abs=0.05)
    assert weights[0] + 0.1 < weights[2] < 1.0
