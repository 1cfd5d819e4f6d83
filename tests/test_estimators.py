"""Estimators behind one protocol: every registered one, and one of a user's own."""

from __future__ import annotations

import copy
import pickle
from typing import Any

import numpy as np
import pytest
from env_cases import assert_same, random_actions, random_bank
from numpy.typing import NDArray

from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.episode import Episodes
from amusic_gym.envs.memory import Route
from amusic_gym.envs.outcome import Outcome
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation import settings
from amusic_gym.estimation.settings import ESTIMATORS, SICSettings
from amusic_gym.kernels.tables import Table, array

BANKS = [random_bank(1), random_bank(2, references=90, queries=50)]


def begun(statistic: str, banks=BANKS, block: int = 0) -> Episodes:
    episodes = Episodes(len(banks), 3, SICSettings(statistic), reselection=block)
    for i, bank in enumerate(banks):
        episodes.begin(i, Route(bank, 0, bank.queries, np.arange(3), 1.0, i))
    return episodes


def step(episodes: Episodes, actions: NDArray[np.bool_], **options: Any) -> list[Any]:
    return shown(episodes.step(actions, **options))


def shown(out: Outcome) -> list[list[Any]]:
    """All of an outcome, route by route: padding between fields does not count."""
    return [array.tolist() for array in out]


def actions_of(count: int, width: int = 3, seed: int = 0) -> NDArray[np.bool_]:
    return np.random.default_rng(seed).random((count, len(BANKS), width)) < 0.5


@pytest.mark.parametrize("statistic", ESTIMATORS)
def test_an_update_takes_the_active_routes_one_frame_on(statistic):
    episodes = begun(statistic)
    for frame, actions in enumerate(actions_of(5)):
        step(episodes, actions)
        assert episodes.state.routes["frame"].tolist() == [frame] * 2
    before = shown(episodes.look())
    after = step(episodes, actions_of(1)[0], active=np.array([False, True]))
    assert episodes.state.routes["frame"].tolist() == [4, 5]
    for old, new in zip(before, after, strict=True):
        assert old[0] == new[0]
    assert (0 <= episodes.state.routes["p_correct"]).all()
    assert (episodes.state.routes["p_correct"] <= 1).all()


@pytest.mark.parametrize("statistic", ESTIMATORS)
def test_a_route_that_begins_anew_is_forgotten(statistic):
    episodes, fresh = begun(statistic), begun(statistic)
    for actions in actions_of(6):
        step(episodes, actions)
    for i, bank in enumerate(BANKS):
        episodes.begin(i, Route(bank, 0, bank.queries, np.arange(3), 1.0, i))
    for actions in actions_of(6, seed=1):
        assert step(episodes, actions) == step(fresh, actions)


@pytest.mark.parametrize("statistic", ESTIMATORS)
def test_room_for_a_larger_map_keeps_what_is_remembered(statistic):
    small, large = random_bank(3, references=20, queries=40), random_bank(4, references=200)
    alone, grown = begun(statistic, [small]), begun(statistic, [small, small])
    for k, actions in enumerate(actions_of(12)):
        one = step(alone, actions[:1])
        if k == 5:
            grown.begin(1, Route(large, 0, large.queries, np.arange(3), 1.0, 1))
        both = step(grown, actions)
        for ours, theirs in zip(one, both, strict=True):
            assert ours[0] == theirs[0]


@pytest.mark.parametrize("statistic", ESTIMATORS)
@pytest.mark.parametrize("twin_of", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))])
def test_copies_go_on_alike_and_apart(statistic, twin_of):
    episodes = begun(statistic, block=4)
    for actions in actions_of(6, 4):
        step(episodes, actions)
    twin = twin_of(episodes)
    for actions in actions_of(6, 4, seed=1):
        assert step(episodes, actions) == step(twin, actions)
    repeated = episodes.repeated(2)
    for actions in actions_of(6, 4, seed=2):
        several = step(repeated, np.repeat(actions, 2, 0))
        for ours, theirs in zip(step(episodes, actions), several, strict=True):
            assert [route for route in ours for _ in range(2)] == theirs


@pytest.mark.parametrize("statistic", ESTIMATORS)
def test_looking_back_gives_what_running_all_would_have_given(statistic):
    """Statistics of the last block, as if every technique had run on its frames."""
    sparse, full = begun(statistic, block=4), begun(statistic, block=4)
    nothing = np.zeros((2, 4), np.bool_)
    everything = np.ones((2, 4), np.bool_)
    everything[:, 3] = False
    for frame in range(4):
        cheap = nothing.copy()
        cheap[:, frame % 3] = True
        step(sparse, cheap)
        step(full, everything)
    selections = []
    for episodes in (sparse, full):
        step(episodes, nothing | [0, 0, 0, 1])
        selections.append(episodes.state)
    assert selections[0].slots["late_runs"].sum(1).tolist() == [8, 8]
    assert selections[1].slots["late_runs"].sum(1).tolist() == [0, 0]
    if statistic == "mean":  # nothing is carried on from the predictions that were given
        np.testing.assert_array_equal(selections[0].statistics, selections[1].statistics)
        np.testing.assert_array_equal(selections[0].corrections, selections[1].corrections)


# ---- of a user's own ------------------------------------------------------------------------


class LastState(Table):
    places: NDArray[np.int64] = array(np.int64, "routes")


class LastMatch:
    """The best place of the last technique that ran, all of Python; sure of nothing."""

    def __init__(self, settings: SICSettings, *, block: int, threads: int) -> None:
        self.state = LastState({"routes": 0})

    def allocate(self, batch, sizes) -> None:
        self.state = LastState(sizes)
        self.link(batch)

    def begin(self, i: int, references: int) -> None:
        self.state.places[i] = -1

    def update(self) -> None:
        for route, slots, active in zip(
            self.batch.routes, self.batch.slots, self.batch.active, strict=True
        ):
            if active:
                route["frame"] += 1
                route["prediction"] = route["frame"] + slots["ran"].sum()
                route["p_correct"] = 0.5
                route["technique"] = int(np.flatnonzero(slots["ran"])[-1])

    def look_back(self) -> None:
        raise NotImplementedError

    def link(self, batch) -> None:
        self.batch = batch

    def repeated(self, batch, copies: int):
        raise NotImplementedError


def test_a_statistic_is_one_class_and_one_line(monkeypatch):
    monkeypatch.setitem(settings.ESTIMATORS, "last", f"{__name__}:LastMatch")
    single = TechniqueSelectionEnv(BANKS[0], statistic="last")
    several = TechniqueSelectionVectorEnv(2, BANKS[0], statistic="last")
    first, _ = single.reset(seed=0)
    assert_same(first, several.reset(seed=0)[0][0])
    for frame, action in enumerate(random_actions(0, 10, (3,))):
        shown, reward, *_, info = single.step(action)
        assert info["prediction"] == frame + max(1, np.sum(action))
        assert reward == 0.5 - info["seconds"] / BANKS[0].seconds.sum()
        together = several.step([action, action])
        assert_same(shown, together[0][0])
