"""The re-select bit against explicit loops: the paper's rule, and any other use of the bit."""

from __future__ import annotations

import golden
import numpy as np
import oracle
import pytest
from amusic_baselines.amusic import AMuSIC, differ
from env_cases import noisy_bank, random_bank
from hypothesis import given, settings
from hypothesis import strategies as st
from selection_cases import CLOSE, assert_details, assert_route, follow

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import STATISTICS, SICSettings
from amusic_gym.evaluation.rollout import Job, rollout, rollouts

pytestmark = pytest.mark.slow

techniques = st.integers(1, 16)
blocks = st.integers(1, 7)
shares = st.sampled_from([0.1, 0.3, 0.5, 0.7, 0.9, 1.0])


def both(on: bool) -> dict[str, bool]:
    """Whether there are carried candidates and a discount, which there are with the evidence."""
    return {"carry": on, "discount": on}


def drive(policy: AMuSIC, banks: list[ScoreBank], **arguments) -> list[list[dict]]:
    """Infos of the A-MuSIC rule, one list per bank, all banks in one vector environment."""
    env = TechniqueSelectionVectorEnv(
        len(banks),
        banks,
        slots=max(len(bank.techniques) for bank in banks),
        statistic=policy.needs.statistic,
        reselection=policy.needs.reselection,
        coverage=policy.needs.coverage,
        **arguments,
    )
    observation, info = env.reset(seed=0, options={"bank": np.arange(len(banks))})
    policy.reset(np.ones(len(banks), np.bool_))
    infos: list[list[dict]] = [[] for _ in banks]
    for _ in range(max(bank.queries for bank in banks)):
        observation, _, _, _, info = env.step(policy.act(observation, info))
        for i, bank in enumerate(banks):
            if len(infos[i]) < bank.queries:
                infos[i].append(route_info(info, i, len(bank.techniques)))
    return infos


def route_info(info: dict, i: int, width: int) -> dict:
    """What one route's infos say, without masks and empty slots."""
    names = ("prediction", "confidence", "similarity", "technique", "seconds")
    chosen = {key: info[key][i] for key in names}
    selection = {k: v[i] for k, v in info["selection"].items() if not k.startswith("_")}
    assert not info["ran"][i][width:].any()
    assert not selection["late_runs"][width:].any()
    chosen["ran"] = info["ran"][i][:width].tolist()
    for key in ("tally", "selected", "late_runs", "corrections"):
        selection[key] = selection[key][:width]
    return {**chosen, "selection": selection}


# ---- the rule ----------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**32),
    st.lists(techniques, min_size=1, max_size=3),
    st.sampled_from(oracle.STATISTICS),
    blocks,
    shares,
    st.sampled_from([0.05, 0.3, 0.8]),
    st.tuples(st.integers(1, 12), st.sampled_from([3, 1000]), st.sampled_from([1.0, 0.9])),
    st.tuples(st.booleans(), st.booleans()),  # carry and discount
)
def test_rule_is_the_loops(seed, widths, statistic, block, share, alpha, sic, ours):
    rng = np.random.default_rng(seed)
    sizes = [(width, *rng.integers(1, 30, 2)) for width in widths]
    banks = [noisy_bank(rng, *size, levels=rng.integers(2, 9)) for size in sizes]
    policy = AMuSIC(statistic, block, share, alpha)
    candidates, history, gamma = sic
    settings = {"candidates": candidates, "history": history, "gamma": gamma}
    found = drive(policy, banks, **settings, carry=ours[0], discount=ours[1])
    for bank, infos in zip(banks, found, strict=True):
        expected = oracle.amusic(bank.scores, *sic, statistic, block, share, alpha, *ours)
        assert_route(infos, expected, bank.seconds)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
def test_rule_reselects_on_a_smooth_route(statistic):
    bank = random_bank(4, techniques=5, queries=90, references=100)
    ours = both(statistic == "evidence")
    expected = oracle.amusic(bank.scores, statistic=statistic, alpha=0.3, **ours)
    assert expected.reselections() >= 2
    assert any(len(selection.chosen) < 5 for selection in expected.selections)
    [infos] = drive(AMuSIC(statistic, alpha=0.3), [bank])
    assert_route(infos, expected, bank.seconds)


@pytest.mark.parametrize(
    ("share", "alpha", "expected"),
    [(0.5, 0.05, golden.AMUSIC_QUIET), (1.0, 0.5, golden.AMUSIC_RESELECTING)],
)
def test_rule_on_the_bank_worked_out_by_hand(tiny_bank, share, alpha, expected):
    policy = AMuSIC("mean", golden.AMUSIC_BLOCK, share, alpha)
    [infos] = drive(policy, [tiny_bank], candidates=golden.CANDIDATES)
    assert [info["prediction"] for info in infos] == expected["predictions"]
    np.testing.assert_allclose([i["confidence"] for i in infos], expected["confidences"], **CLOSE)
    assert [info["ran"] for info in infos] == [[bool(x) for x in row] for row in expected["ran"]]
    happened = [
        (
            frame,
            info["selection"]["tally"].tolist(),
            np.flatnonzero(info["selection"]["selected"]).tolist(),
            info["selection"]["late_runs"].tolist(),
        )
        for frame, info in enumerate(infos)
        if info["selection"]["happened"]
    ]
    assert happened == expected["selections"]
    shares = sum(info["seconds"] for info in infos) / (5 * sum(golden.SECONDS))
    np.testing.assert_allclose(shares, expected["compute"], **CLOSE)


def test_traces_of_several_routes_are_the_loops():
    rng = np.random.default_rng(8)
    banks = [noisy_bank(rng, *size) for size in [(4, 47, 30), (2, 31, 50), (7, 25, 20)]]
    for policy, statistic in [(AMuSIC(), "mean"), (AMuSIC("evidence"), "evidence")]:
        together = rollouts(policy, [Job(bank) for bank in banks], name="amusic")
        for bank, trace in zip(banks, together, strict=True):
            alone = rollout(policy, bank, name="amusic", statistic="mean")
            ours = both(statistic == "evidence")
            expected = oracle.amusic(bank.scores, statistic=statistic, **ours)
            for found in (trace, alone):
                assert found.statistic == statistic
                assert found.predictions.tolist() == expected.predictions
                assert found.chosen.tolist() == expected.chosen
                assert found.ran.tolist() == expected.ran
                np.testing.assert_allclose(found.confidence, expected.confidences, **CLOSE)
                np.testing.assert_allclose(found.similarity, expected.similarities, **CLOSE)
                late = {selection.frame: selection.late_runs for selection in expected.selections}
                assert np.flatnonzero(found.selections).tolist() == sorted(late)
                for frame, row in enumerate(found.late_runs.tolist()):
                    assert row == late.get(frame, [0] * len(row))


def test_one_selection_with_one_technique_active_costs_the_others_block():
    """The paper's arithmetic: (T - 1) * M = 30 extra runs."""
    bank = random_bank(2, techniques=4)
    env = TechniqueSelectionEnv(bank, reselection=10)
    env.reset()
    for _ in range(10):
        env.step([0, 0, 1, 0, 0])
    selection = env.step([0, 0, 0, 0, 1])[4]["selection"]
    assert selection["late_runs"].tolist() == [10, 10, 0, 10]


# ---- the re-selection test ---------------------------------------------------------------


@settings(max_examples=300, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from([0.0, 0.5, 1.0, 1.5]), st.sampled_from([0.0, 0.5, 1.0, 1.5])),
        max_size=20,
    ),
    st.sampled_from([0.05, 0.3, 0.8]),
)
def test_39_t_test_is_the_one_of_the_loops(pairs, alpha):
    before, after = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    assert differ(before, after, alpha) == (oracle.paired_t_test(before, after) < alpha)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("gamma", [1.0, 0.9])
def test_39_a_standing_robot_is_no_change(statistic, gamma):
    """Equal frames give equal, non-zero corrections; rounding must not look like a change."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        rows = np.repeat(rng.normal(size=(4, 1, 30)), 60, axis=1)
        bank = ScoreBank(
            rows, list("ABCD"), np.ones(4), tolerance=1, ground_truth=np.zeros(60, int)
        )
        ours = both(statistic == "evidence")
        expected = oracle.amusic(bank.scores, 10, 5, gamma, statistic, **ours)
        policy = AMuSIC(statistic)
        [infos] = drive(policy, [bank], candidates=10, history=5, gamma=gamma)
        assert_route(infos, expected, bank.seconds)


# ---- any use of the bit ------------------------------------------------------------------


@settings(max_examples=120, deadline=None)
@given(
    st.integers(0, 2**32),
    techniques,
    blocks,
    shares,
    st.builds(
        SICSettings,
        statistic=st.sampled_from(oracle.STATISTICS),
        candidates=st.integers(1, 12),
        history=st.sampled_from([0, 3, 1000]),
        gamma=st.sampled_from([1.0, 0.9]),
        carry=st.booleans(),
        discount=st.booleans(),
    ),
    st.floats(0.05, 0.9),
    st.floats(0.05, 0.6),
)
def test_any_use_of_the_bit_is_the_loops(seed, width, block, share, sic, activity, reselect):
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, width, *rng.integers(1, 25, 2), levels=rng.integers(2, 9))
    actions = rng.random((bank.queries, width + 1)) < activity
    actions[:, -1] = rng.random(bank.queries) < reselect
    env = TechniqueSelectionEnv(bank, **vars(sic), reselection=block, coverage=share)
    env.reset()
    infos = [env.step(action)[4] for action in actions]
    expected = follow(bank, actions, sic, block=block, share=share)
    assert_route(infos, expected, bank.seconds)
    assert_details(infos, expected, bank.tolerance, sic.statistic)


def test_selections_on_a_route_longer_than_the_room_of_the_sums():
    rng = np.random.default_rng(5)
    queries, sic = 1100, SICSettings("mean", history=50, carry=True)
    bank = noisy_bank(rng, 3, queries, 8)
    actions = rng.random((queries, 4)) < 0.4
    actions[:, -1] = rng.random(queries) < 0.02
    env = TechniqueSelectionEnv(bank, **vars(sic), reselection=6)
    env.reset()
    infos = [env.step(action)[4] for action in actions]
    expected = follow(bank, actions, sic, block=6)
    assert [info["prediction"] for info in infos] == expected.predictions
    confidences = [info["confidence"] for info in infos]
    np.testing.assert_allclose(confidences, expected.confidences, **CLOSE)


@pytest.mark.parametrize("statistic", STATISTICS)
def test_after_a_selection_all_is_as_if_everything_had_run_on_its_block(statistic):
    """All but p̂, which asks what was predicted on the frames before, and what ran beside what."""
    bank, block, selections = random_bank(7), 5, [3, 14, 17, 30]  # two blocks overlap
    actions = np.random.default_rng(2).random((bank.queries, 4)) < 0.4
    actions[:, -1] = False
    actions[selections, -1] = True
    env = TechniqueSelectionEnv(bank, statistic=statistic, reselection=block, allow_idle=True)
    env.reset()
    infos = [env.step(action)[4] for action in actions]
    plain = TechniqueSelectionEnv(bank, statistic=statistic, allow_idle=True)
    for stop, following in zip(selections, [*selections[1:], bank.queries], strict=True):
        ran = np.stack([info["ran"] for info in infos])
        for selection in selections[: selections.index(stop) + 1]:
            ran[max(0, selection - block) : selection] = True
        plain.reset()
        hindsight = [plain.step(row)[4] for row in ran[:following]]
        for info, expected in zip(infos[stop:following], hindsight[stop:], strict=True):
            assert info["prediction"] == expected["prediction"]
            keys = ["place", "statistic", "correction", "margin"]
            if statistic != "belief":  # whose confidence is the logit of p̂
                keys += ["confidence", "technique"]
            for key in keys:
                np.testing.assert_allclose(info[key], expected[key], **CLOSE)


def test_late_runs_leave_earlier_predictions_as_they_were():
    bank = random_bank(6)
    env = TechniqueSelectionEnv(bank, reselection=5)
    env.reset()
    first = [env.step([1, 0, 0, 0])[4] for _ in range(5)]
    kept = [dict(info) for info in first]
    env.step([0, 0, 0, 1])
    assert [info["prediction"] for info in first] == [info["prediction"] for info in kept]
    env.reset()
    again = [env.step([1, 0, 0, 0])[4]["prediction"] for _ in range(5)]
    assert again == [info["prediction"] for info in first]


def test_block_beyond_the_start_selects_over_the_frames_there_are():
    bank = random_bank(6)
    env = TechniqueSelectionEnv(bank, reselection=50)
    env.reset()
    selection = env.step([1, 0, 0, 1])[4]["selection"]
    assert not selection["happened"]  # nothing to select from: the other bits hold
    selection = env.step([0, 0, 0, 1])[4]["selection"]
    assert selection["happened"]
    assert selection["late_runs"].tolist() == [0, 1, 1]
    assert selection["tally"].sum() == 1
    assert selection["corrections"].shape == (3, 50)
