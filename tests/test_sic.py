"""SIC, alone and inside the environment, against explicit loops and values worked out by hand."""

from __future__ import annotations

import golden
import numpy as np
import oracle
import pytest
from env_cases import infos_of, noisy_bank, random_bank
from hypothesis import example, given, settings
from hypothesis import strategies as st
from selection_cases import CLOSE, as_arguments, as_settings, assert_details, assert_route, follow

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic import state as kernels
from amusic_gym.estimation.sic.correction import SIC
from amusic_gym.estimation.sic.state import SLACK

PLAIN = {"carry": False, "discount": False}
NOWHERE = np.full(60, -1)

sic_settings = st.builds(
    SICSettings,
    statistic=st.sampled_from(oracle.STATISTICS),
    candidates=st.integers(1, 20),
    history=st.one_of(st.integers(0, 8), st.just(1000)),
    gamma=st.sampled_from([1.0, 0.95, 0.5, 0.05]),
    carry=st.booleans(),
    discount=st.booleans(),
)
sizes = st.tuples(st.integers(1, 5), st.integers(1, 18), st.integers(1, 16))  # T, Q, R


def walk(rows, ran, chosen: SICSettings) -> list[tuple[int, float, float] | None]:
    """What the class says, frame by frame."""
    sic = SIC(rows.shape[1], chosen)
    found: list[tuple[int, float, float] | None] = []
    for row, runs in zip(rows, ran, strict=True):
        if not runs:
            sic.skip()
        found.append(tuple(sic.correct(row)) if runs else None)
    return found


# ---- values worked out by hand -----------------------------------------------------------


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("technique", golden.TECHNIQUES)
def test_golden_corrections(technique, statistic):
    rows = golden.SCORES[golden.TECHNIQUES.index(technique)]
    found = walk(rows, [1] * 5, SICSettings(statistic, golden.CANDIDATES, **PLAIN))
    np.testing.assert_allclose(found, golden.SIC[statistic][technique], **CLOSE)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("case", golden.OTHER_SETTINGS)
def test_golden_other_settings(case, statistic):
    history, gamma, ran = case
    chosen = SICSettings(statistic, golden.CANDIDATES, history, gamma, **PLAIN)
    found = walk(golden.SCORES[0], ran, chosen)
    np.testing.assert_allclose(found[4], golden.OTHER_SETTINGS[case][statistic], **CLOSE)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
def test_golden_fusion(tiny_bank, statistic):
    settings = {"statistic": statistic, "candidates": golden.CANDIDATES, **PLAIN}
    env = TechniqueSelectionEnv(tiny_bank, **settings)
    infos = infos_of(env, np.ones((5, 3)))
    found = [[i[k] for k in ("technique", "prediction", "confidence", "margin")] for i in infos]
    np.testing.assert_allclose(found, golden.MUSIC[statistic], **CLOSE)
    similarities = [info["similarity"] for info in infos]
    np.testing.assert_allclose(similarities, golden.SIMILARITIES[statistic], **CLOSE)
    for t, name in enumerate(golden.TECHNIQUES):
        own = [(i["place"][t], i["statistic"][t], i["correction"][t]) for i in infos]
        np.testing.assert_allclose(own, golden.SIC[statistic][name], **CLOSE)


# ---- explicit loops ----------------------------------------------------------------------


def loops(rows, ran, chosen: SICSettings, fused=None):
    """What the loops say of one technique, frame by frame; ``fused``: frame -> prediction."""
    z = [oracle.standardise(row) for row in rows]
    own: dict[int, int] = {}
    for q, runs in enumerate(ran):
        if not runs:
            yield None
            continue
        carried = [oracle.moved_on(own, q), oracle.moved_on(fused or {}, q)]
        places = carried if chosen.carry else []
        found = oracle.sic(rows, ran, q, *as_arguments(chosen), z=z, carried=places)
        own[q] = found.place
        yield found


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), sizes, st.integers(1, 5), sic_settings, st.floats(0.2, 1.0))
@example(0, (1, 18, 16), 1, SICSettings("mean", 20, 3, 0.5), 0.5)
def test_class_is_the_loops(seed, size, levels, chosen, activity):
    rng = np.random.default_rng(seed)
    rows = noisy_bank(rng, 1, *size[1:], levels).scores[0]
    ran = rng.random(len(rows)) < activity
    for found, expected in zip(walk(rows, ran, chosen), loops(rows, ran, chosen), strict=True):
        assert (found is None) == (expected is None)
        if found:
            assert found[0] == expected.place
            np.testing.assert_allclose(found, expected[:3], **CLOSE)


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 2**32), sizes, st.integers(1, 5), sic_settings, st.floats(0.2, 1.0))
def test_class_with_predictions_of_all_techniques_is_the_loops(
    seed, size, levels, chosen, activity
):
    """With any prediction, on the map and off it; its discount is that of the loops, too."""
    rng = np.random.default_rng(seed)
    rows = noisy_bank(rng, 1, *size[1:], levels).scores[0]
    ran = rng.random(len(rows)) < activity
    given_on = np.flatnonzero(rng.random(len(rows)) < 0.7).tolist()
    fused = {q: int(rng.integers(rows.shape[1])) for q in given_on}
    sic, z = SIC(rows.shape[1], chosen), [oracle.standardise(row) for row in rows]
    for q, expected in enumerate(loops(rows, ran, chosen, fused)):
        if expected is None:
            sic.skip()
            continue
        place = oracle.moved_on(fused, q)
        place = -1 if place is None else place
        seen = sic.preview(rows[q], fused=place)
        match = sic.correct(rows[q], fused=place)
        assert seen == match
        assert match.place == expected.place
        np.testing.assert_allclose(match, expected[:3], **CLOSE)
        discount = oracle.serial_discount(z, ran, q, rows) if chosen.discount else 1.0
        np.testing.assert_allclose(sic.discount, discount, **CLOSE)


@settings(max_examples=300, deadline=None)
@given(
    st.integers(0, 2**32),
    sizes,
    st.integers(1, 5),
    sic_settings,
    st.floats(0.1, 1.0),
    st.one_of(st.none(), st.integers(1, 7)),
    st.booleans(),
)
def test_environment_is_the_loops(seed, size, levels, chosen, activity, block, idle):
    """With any activity, idle frames, selections that look back, and a start anywhere."""
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, *size, levels)
    start = int(rng.integers(bank.queries))
    actions = rng.random((bank.queries - start, size[0] + (block is not None))) < activity
    if block:
        actions[:, -1] = rng.random(len(actions)) < 0.3
    arguments = {"reselection": block, "coverage": 0.6, "allow_idle": idle}
    env = TechniqueSelectionEnv(bank, **vars(chosen), **arguments)
    infos = infos_of(env, actions, options={"start": start})
    expected = follow(bank, actions, chosen, block=block or 0, share=0.6, idle=idle, start=start)
    assert_route(infos, expected, bank.seconds)
    assert_details(infos, expected, bank.tolerance, chosen.statistic)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32), sic_settings, st.integers(1, 4), st.floats(0.1, 0.9))
def test_smooth_routes_are_the_loops(seed, chosen, block, activity):
    """Rows that resemble each other, as those of a drive do: every discount is another."""
    rng = np.random.default_rng(seed)
    bank = random_bank(seed, queries=30, references=35)
    actions = rng.random((30, 4)) < activity
    actions[:, -1] = rng.random(30) < 0.15
    env = TechniqueSelectionEnv(bank, **vars(chosen), reselection=block, allow_idle=True)
    infos = infos_of(env, actions)
    expected = follow(bank, actions, chosen, block=block, idle=True)
    assert_route(infos, expected, bank.seconds)
    assert_details(infos, expected, bank.tolerance, chosen.statistic)


@pytest.mark.parametrize("history", [3, 12, 1000])
@pytest.mark.parametrize("carry", [False, True])
def test_rows_that_wait_carry_and_discount_alike(monkeypatch, carry, history):
    monkeypatch.setattr(kernels, "LARGE", 1)
    for seed in range(8):
        rng = np.random.default_rng(seed)
        bank = random_bank(seed, queries=60, references=25, ground_truth=NOWHERE)
        actions = rng.random((60, 4)) < rng.choice([0.2, 0.6, 0.95])
        actions[:, -1] = rng.random(60) < 0.1
        chosen = SICSettings("evidence", 5, history, carry=carry)
        env = TechniqueSelectionEnv(bank, **vars(chosen), reselection=4, allow_idle=True)
        infos = infos_of(env, actions)
        assert env.task.episodes.estimator.state.marks["depth"].all()
        expected = follow(bank, actions, chosen, block=4, idle=True)
        assert_route(infos, expected, bank.seconds)
        assert_details(infos, expected, bank.tolerance, "evidence")


LONG = [  # references, F, gamma, share of the frames it runs on
    (5, 1000, 1.0, 1.0),
    (20, 1000, 1.0, 0.3),
    (12, 7, 1.0, 0.6),
    (20, 3, 0.9, 0.5),
    (8, 1000, 0.99, 0.02),  # gaps longer than the map
    (40, 12, 1.0, 0.02),
    (700, 600, 1.0, 0.9),  # a map longer than the sums may move
]


@pytest.mark.parametrize("carry", [False, True])
@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("case", LONG)
def test_routes_longer_than_the_room_of_the_sums(case, statistic, carry):
    references, history, gamma, activity = case
    queries = 2 * SLACK + 200
    rng = np.random.default_rng(references)
    bank = noisy_bank(rng, 1, queries, references, levels=9)
    ran = rng.random(queries) < activity
    ran[0] = True
    chosen = SICSettings(statistic, 6, history, gamma, carry)
    found = walk(bank.scores[0], ran, chosen)
    around = {k * (SLACK + offset) for k in (1, 2) for offset in range(-3, 4)}
    samples = around | set(rng.integers(0, queries, 40).tolist()) | {queries - 1}
    z = [oracle.standardise(row) for row in bank.scores[0]]
    own = {q: match[0] for q, match in enumerate(found) if match}
    compared = 0
    for q in samples | set(np.flatnonzero(ran)[-20:].tolist()):
        if q < queries and ran[q]:
            carried = [oracle.moved_on(own, q)] if chosen.carry else []
            known = (bank.scores[0], ran, q, *as_arguments(chosen), z, carried)
            expected = oracle.sic(*known)
            np.testing.assert_allclose(found[q], expected[:3], rtol=1e-8, atol=1e-8)
            compared += 1
    assert compared >= 10


def test_long_route_inside_the_environment():
    queries = 2 * SLACK + 100
    rng = np.random.default_rng(3)
    bank = noisy_bank(rng, 2, queries, 9)
    ran = rng.random((queries, 2)) < 0.5
    ran[~ran.any(axis=1), 0] = True
    chosen = SICSettings("evidence", history=30)
    infos = infos_of(TechniqueSelectionEnv(bank, **vars(chosen)), ran)
    memory = oracle.Memory.of(2)
    for q, info in enumerate(infos):
        memory.fused[q] = info["prediction"]
        for t in np.flatnonzero(info["ran"]):
            memory.winners[t][q] = info["place"][t]
    z = oracle.standardise_bank(bank.scores)
    for q in [*range(0, queries, 29), SLACK, SLACK + 1, 2 * SLACK, queries - 1]:
        expected = oracle.music(bank.scores, ran, q, *as_settings(chosen, z), memory)
        assert infos[q]["prediction"] == expected.place
        np.testing.assert_allclose(infos[q]["confidence"], expected.confidence, **CLOSE)


# ---- the class itself --------------------------------------------------------------------


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32), sic_settings)
def test_preview_changes_nothing(seed, chosen):
    rng = np.random.default_rng(seed)
    rows = rng.integers(0, 4, (80, 6)).astype(np.float32)  # beyond the first 64 frames
    ran = rng.random(80) < 0.7
    looked, plain = SIC(6, chosen), SIC(6, chosen)
    for row, other, runs in zip(rows, rows[::-1], ran, strict=True):
        looked.preview(other)
        if runs:
            seen = looked.preview(row)
            taken = looked.correct(row)
            assert seen == taken == plain.correct(row)
        else:
            looked.skip()
            plain.skip()


def test_preview_before_the_room_of_the_sums_is_used_up():
    rows = np.random.default_rng(0).integers(0, 4, (SLACK + 4, 5)).astype(np.float32)
    looked, plain = SIC(5), SIC(5)
    for row in rows:
        assert looked.preview(row) == looked.correct(row) == plain.correct(row)


@pytest.mark.parametrize("row", [[1.0, np.nan, 0.0], [np.inf, 0.0, 1.0], [1.0, 2.0], [[1, 2, 3]]])
def test_wrong_rows_are_refused_and_change_nothing(row):
    sic, plain = SIC(3), SIC(3)
    sic.correct([3, 1, 2])
    plain.correct([3, 1, 2])
    with pytest.raises(ValueError, match=r"NaN or infinite score at frame 1|shape"):
        sic.correct(row)
    assert sic.correct([1, 1, 2]) == plain.correct([1, 1, 2])


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"statistic": "meen"}, "unknown statistic 'meen': did you mean 'mean'"),
        ({"candidates": 0}, r"candidates \(K\) is 0"),
        ({"candidates": 2.5}, r"candidates \(K\) is 2.5"),
        ({"history": -1}, r"history \(F\) is -1"),
        ({"gamma": 0.0}, "gamma is 0.0"),
        ({"gamma": 1.5}, "gamma is 1.5"),
        ({"gamma": float("nan")}, "gamma is nan"),
    ],
)
def test_wrong_settings_are_refused(wrong, words):
    with pytest.raises(ValueError, match=words):
        SICSettings(**wrong)
    with pytest.raises(ValueError, match=words):
        TechniqueSelectionEnv(ScoreBank(np.eye(3)[None], ["A"], [1.0], tolerance=0), **wrong)


def test_the_belief_of_all_techniques_is_refused():
    with pytest.raises(ValueError, match=r"'belief', which all .* give 'evidence' or 'mean', or"):
        SIC(3, SICSettings("belief"))


def test_without_settings_it_is_the_evidence():
    row, other = [3, 1, 2], [1, 1, 2]
    plain, meant = SIC(3), SIC(3, SICSettings("evidence"))
    assert [plain.correct(row), plain.correct(other)] == [meant.correct(row), meant.correct(other)]


def test_a_map_without_places_is_refused():
    with pytest.raises(ValueError, match="references is 0"):
        SIC(0)
