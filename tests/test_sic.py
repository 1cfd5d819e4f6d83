"""SIC, alone and inside the environment, against explicit loops and values worked out by hand."""

from __future__ import annotations

import math

import golden
import numpy as np
import oracle
import pytest
from env_cases import infos_of, noisy_bank
from hypothesis import example, given, settings
from hypothesis import strategies as st

from amusic_gym.bank import ScoreBank
from amusic_gym.calibration import coefficients
from amusic_gym.env import TechniqueSelectionEnv
from amusic_gym.settings import SICSettings
from amusic_gym.sic import SIC, SLACK

CLOSE = {"rtol": 1e-9, "atol": 1e-9}

sic_settings = st.builds(
    SICSettings,
    statistic=st.sampled_from(oracle.STATISTICS),
    candidates=st.integers(1, 20),
    history=st.one_of(st.integers(0, 8), st.just(1000)),
    gamma=st.sampled_from([1.0, 0.95, 0.5, 0.05]),
)
sizes = st.tuples(st.integers(1, 5), st.integers(1, 18), st.integers(1, 16))  # T, Q, R


def as_arguments(chosen: SICSettings) -> tuple[int, int, float, str]:
    """In the order of the oracle."""
    return chosen.candidates, chosen.history, chosen.gamma, chosen.statistic


def walk(rows, ran, chosen: SICSettings) -> list[tuple[int, float, float] | None]:
    """What the class says, frame by frame."""
    sic = SIC(rows.shape[1], chosen)
    found: list[tuple[int, float, float] | None] = []
    for row, runs in zip(rows, ran, strict=True):
        if not runs:
            sic.skip()
        found.append(tuple(sic.correct(row)) if runs else None)
    return found


def estimated(statistic: str, confidence: float, margin: float | None) -> float:
    """p̂ of a fused match; no margin where there is no rival."""
    b = coefficients(statistic)
    if margin is None:
        logit = b[3] + b[4] * math.asinh(confidence)
    else:
        logit = b[0] + b[1] * math.asinh(confidence) + b[2] * math.asinh(margin)
    return 1.0 / (1.0 + math.exp(-min(30.0, max(-30.0, logit))))


# ---- values worked out by hand -----------------------------------------------------------


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("technique", golden.TECHNIQUES)
def test_golden_corrections(technique, statistic):
    rows = golden.SCORES[golden.TECHNIQUES.index(technique)]
    found = walk(rows, [1] * 5, SICSettings(statistic, golden.CANDIDATES))
    np.testing.assert_allclose(found, golden.SIC[statistic][technique], **CLOSE)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("case", golden.OTHER_SETTINGS)
def test_golden_other_settings(case, statistic):
    history, gamma, ran = case
    chosen = SICSettings(statistic, golden.CANDIDATES, history, gamma)
    found = walk(golden.SCORES[0], ran, chosen)
    np.testing.assert_allclose(found[4], golden.OTHER_SETTINGS[case][statistic], **CLOSE)


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
def test_golden_fusion(tiny_bank, statistic):
    env = TechniqueSelectionEnv(tiny_bank, statistic=statistic, candidates=golden.CANDIDATES)
    infos = infos_of(env, np.ones((5, 3)))
    found = [[i[k] for k in ("technique", "prediction", "confidence", "margin")] for i in infos]
    np.testing.assert_allclose(found, golden.MUSIC[statistic], **CLOSE)
    similarities = [info["similarity"] for info in infos]
    np.testing.assert_allclose(similarities, golden.SIMILARITIES[statistic], **CLOSE)
    for t, name in enumerate(golden.TECHNIQUES):
        own = [(i["place"][t], i["statistic"][t], i["correction"][t]) for i in infos]
        np.testing.assert_allclose(own, golden.SIC[statistic][name], **CLOSE)


# ---- explicit loops ----------------------------------------------------------------------


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), sizes, st.integers(1, 5), sic_settings, st.floats(0.2, 1.0))
@example(0, (1, 18, 16), 1, SICSettings("mean", 20, 3, 0.5), 0.5)
def test_class_is_the_loops(seed, size, levels, chosen, activity):
    rng = np.random.default_rng(seed)
    rows = noisy_bank(rng, 1, *size[1:], levels).scores[0]
    ran = rng.random(len(rows)) < activity
    for q, found in enumerate(walk(rows, ran, chosen)):
        if ran[q]:
            expected = oracle.sic(rows, ran, q, *as_arguments(chosen))
            assert found is not None
            assert found[0] == expected.place
            np.testing.assert_allclose(found, expected[:3], **CLOSE)


@settings(max_examples=200, deadline=None)
@given(st.integers(0, 2**32), sizes, st.integers(1, 5), sic_settings, st.floats(0.2, 1.0))
def test_environment_is_the_loops(seed, size, levels, chosen, activity):
    rng = np.random.default_rng(seed)
    bank = noisy_bank(rng, *size, levels)
    start = int(rng.integers(bank.queries))
    scores = bank.scores[:, start:]
    ran = rng.random((scores.shape[1], size[0])) < activity
    ran[~ran.any(axis=1), rng.integers(size[0])] = True
    env = TechniqueSelectionEnv(bank, **vars(chosen))
    z = oracle.standardise_bank(scores)
    for q, info in enumerate(infos_of(env, ran, options={"start": start})):
        expected = oracle.music(scores, ran, q, *as_arguments(chosen), z=z)
        assert info["ran"].tolist() == ran[q].tolist()
        assert (info["technique"], info["prediction"]) == (expected.technique, expected.place)
        np.testing.assert_allclose(info["confidence"], expected.confidence, **CLOSE)
        similarity = z[expected.technique][q][expected.place]
        np.testing.assert_allclose(info["similarity"], similarity, **CLOSE)
        margin = oracle.margin(expected, bank.tolerance)
        np.testing.assert_allclose(info["margin"], margin or 0.0, **CLOSE)
        for t, sic in enumerate(expected.sics):
            own = [info["place"][t], info["statistic"][t], info["correction"][t]]
            np.testing.assert_allclose(own, sic[:3] if sic else [0, 0, 0], **CLOSE)
        estimate = estimated(chosen.statistic, expected.confidence, margin)
        np.testing.assert_allclose(info["p_correct"], estimate, **CLOSE)


LONG = [  # references, F, gamma, share of the frames it runs on
    (5, 1000, 1.0, 1.0),
    (20, 1000, 1.0, 0.3),
    (12, 7, 1.0, 0.6),
    (20, 3, 0.9, 0.5),
    (8, 1000, 0.99, 0.02),  # gaps longer than the map
    (40, 12, 1.0, 0.02),
    (700, 600, 1.0, 0.9),  # a map longer than the sums may move
]


@pytest.mark.parametrize("statistic", oracle.STATISTICS)
@pytest.mark.parametrize("case", LONG)
def test_routes_longer_than_the_room_of_the_sums(case, statistic):
    references, history, gamma, activity = case
    queries = 2 * SLACK + 200
    rng = np.random.default_rng(references)
    bank = noisy_bank(rng, 1, queries, references, levels=9)
    ran = rng.random(queries) < activity
    ran[0] = True
    chosen = SICSettings(statistic, 6, history, gamma)
    found = walk(bank.scores[0], ran, chosen)
    around = {k * (SLACK + offset) for k in (1, 2) for offset in range(-3, 4)}
    samples = around | set(rng.integers(0, queries, 40).tolist()) | {queries - 1}
    z = [oracle.standardise(row) for row in bank.scores[0]]
    compared = 0
    for q in samples | set(np.flatnonzero(ran)[-20:].tolist()):
        if q < queries and ran[q]:
            expected = oracle.sic(bank.scores[0], ran, q, *as_arguments(chosen), z=z)
            np.testing.assert_allclose(found[q], expected[:3], rtol=1e-8, atol=1e-8)
            compared += 1
    assert compared >= 10


def test_long_route_inside_the_environment():
    queries = 2 * SLACK + 100
    rng = np.random.default_rng(3)
    bank = noisy_bank(rng, 2, queries, 9)
    ran = rng.random((queries, 2)) < 0.5
    ran[~ran.any(axis=1), 0] = True
    infos = infos_of(TechniqueSelectionEnv(bank, statistic="evidence", history=30), ran)
    z = oracle.standardise_bank(bank.scores)
    for q in [*range(0, queries, 29), SLACK, SLACK + 1, 2 * SLACK, queries - 1]:
        expected = oracle.music(bank.scores, ran, q, 50, 30, 1.0, "evidence", z)
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
