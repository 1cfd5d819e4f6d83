"""What must come of a route's actions, as explicit loops, and the comparison with it."""

from __future__ import annotations

from typing import Any

import numpy as np
import oracle

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.settings import SICSettings

CLOSE = {"rtol": 1e-9, "atol": 1e-9}


def as_arguments(chosen: SICSettings) -> tuple[Any, ...]:
    """In the order of the loops of one technique."""
    return chosen.candidates, chosen.history, chosen.gamma, chosen.statistic


def as_settings(chosen: SICSettings, z: Any) -> tuple[Any, ...]:
    """In the order of the loops of several techniques."""
    return *as_arguments(chosen), z, chosen.carry, chosen.discount


def assert_selection(selection: dict, expected: oracle.Selection) -> None:
    size = len(expected.corrections)
    assert selection["tally"].tolist() == expected.tally
    assert np.flatnonzero(selection["selected"]).tolist() == expected.chosen
    assert selection["late_runs"].tolist() == expected.late_runs
    corrections = np.transpose(selection["corrections"])
    np.testing.assert_allclose(corrections[:size], expected.corrections, **CLOSE)
    assert not corrections[size:].any()


def assert_route(infos: list[dict], expected: oracle.Route, seconds) -> None:
    """Frame by frame the same, and the same cost."""
    assert [info["prediction"] for info in infos] == expected.predictions
    confidences = [info["confidence"] for info in infos]
    np.testing.assert_allclose(confidences, expected.confidences, **CLOSE)
    similarities = [info["similarity"] for info in infos]
    np.testing.assert_allclose(similarities, expected.similarities, **CLOSE)
    assert [info["technique"] for info in infos] == expected.chosen
    assert [list(info["ran"]) for info in infos] == expected.ran
    selections = {selection.frame: selection for selection in expected.selections}
    charged = []
    for frame, info in enumerate(infos):
        late = np.zeros(len(seconds))
        if "selection" in info:
            assert info["selection"]["happened"] == (frame in selections)
        if frame in selections:
            assert_selection(info["selection"], selections[frame])
            late += selections[frame].late_runs
        charged.append((late + info["ran"]) @ seconds)
    np.testing.assert_allclose([info["seconds"] for info in infos], charged, **CLOSE)
    total = sum(info["seconds"] for info in infos)
    np.testing.assert_allclose(total, np.dot(expected.runs(), seconds), **CLOSE)


def assert_details(infos: list[dict], expected: oracle.Route, tolerance: int, statistic: str):
    """Every technique's match, the margin and p̂ of each frame are the same, too."""
    found, wanted = [], []
    p_corrects = oracle.p_corrects(coefficients(statistic), expected, tolerance)
    for info, result, p_correct in zip(infos, expected.results, p_corrects, strict=True):
        assert info["idle"] == (result is None)
        margin = oracle.margin(result, tolerance) if result else None
        own = [info[name] for name in ("place", "statistic", "correction")]
        found.append([info["margin"], info["p_correct"], *np.ravel(np.transpose(own))])
        sics = result.sics if result else [None] * len(own[0])
        matches = [number for sic in sics for number in (sic[:3] if sic else (0, 0, 0))]
        wanted.append([margin or 0.0, p_correct, *matches])
    np.testing.assert_allclose(found, wanted, **CLOSE)


def follow(
    bank: ScoreBank,
    actions,
    chosen: SICSettings,
    *,
    block: int = 0,
    share: float = 0.7,
    idle: bool = False,
    start: int = 0,
) -> oracle.Route:
    """What must come of actions, with a re-select bit where there is a block, as explicit loops."""
    scores = bank.scores[:, start:].tolist()  # loops are sooner through with Python's numbers
    settings = as_settings(chosen, oracle.standardise_bank(scores))
    z, width, queries = settings[4], len(scores), len(scores[0])
    exists = [[False] * width for _ in range(queries)]
    memory, route = oracle.Memory.of(width), oracle.Route()
    on_map = oracle.OnMap(scores, z, bank.tolerance)
    for q, action in enumerate(actions):
        active = np.flatnonzero(action[:width]).tolist()
        if block and action[-1] and q > 0:
            frames = list(range(max(0, q - block), q))
            selection = oracle.select(scores, exists, frames, settings, share, memory)
            route.selections.append(selection)
            active = selection.chosen
        if not active and not idle:
            active = [int(np.argmin(bank.seconds))]
        for t in active:
            exists[q][t] = True
        route.ran.append(list(exists[q]))
        if not active:
            moved = oracle.moved_on(memory.fused, q)
            route.predictions.append(-1 if moved is None else min(moved, bank.references - 1))
            before = route.confidences[-1] if route.confidences else 0.0
            route.confidences.append(oracle.IDLE_DECAY * before)
            route.similarities.append(0.0)
            route.chosen.append(-1)
            route.results.append(None)
            route.on_map.append(on_map.note(q, [], route.predictions[-1]))
            route.others.append(oracle.Others())
            continue
        result = oracle.music(scores, exists, q, *settings, memory)
        memory.note(result, q)
        route.predictions.append(result.place)
        route.confidences.append(result.confidence)
        route.similarities.append(z[result.technique][q][result.place])
        route.chosen.append(result.technique)
        route.results.append(result)
        route.on_map.append(on_map.note(q, active, result.place))
        route.others.append(oracle.others(route.results, z, memory, bank.tolerance, scores))
    return route
