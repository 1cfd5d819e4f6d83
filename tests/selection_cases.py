"""What must come of actions with a re-select bit, as explicit loops, and the comparison with it."""

from __future__ import annotations

import numpy as np
import oracle

from amusic_gym.bank import ScoreBank

CLOSE = {"rtol": 1e-9, "atol": 1e-9}


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
    assert [info["ran"] for info in infos] == expected.ran
    selections = {selection.frame: selection for selection in expected.selections}
    for frame, info in enumerate(infos):
        assert info["selection"]["happened"] == (frame in selections)
        late = np.zeros(len(seconds))
        if frame in selections:
            assert_selection(info["selection"], selections[frame])
            late += selections[frame].late_runs
        np.testing.assert_allclose(info["seconds"], (late + info["ran"]) @ seconds, **CLOSE)
    total = sum(info["seconds"] for info in infos)
    np.testing.assert_allclose(total, np.dot(expected.runs(), seconds), **CLOSE)


def follow(bank: ScoreBank, actions, block: int, share: float, sic) -> oracle.Route:
    """What must come of actions with a re-select bit, as explicit loops."""
    z = oracle.standardise_bank(bank.scores)
    settings = (*sic, z)
    width = len(bank.techniques)
    exists = [[False] * width for _ in range(bank.queries)]
    route = oracle.Route()
    for q, action in enumerate(actions):
        active = np.flatnonzero(action[:-1]).tolist()
        if action[-1] and q > 0:
            frames = list(range(max(0, q - block), q))
            route.selections.append(oracle.select(bank.scores, exists, frames, settings, share))
            active = route.selections[-1].chosen
        active = active or [int(np.argmin(bank.seconds))]
        for t in active:
            exists[q][t] = True
        result = oracle.music(bank.scores, exists, q, *settings)
        route.predictions.append(result.place)
        route.confidences.append(result.confidence)
        route.similarities.append(z[result.technique][q][result.place])
        route.chosen.append(result.technique)
        route.ran.append(list(exists[q]))
    return route
