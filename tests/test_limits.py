"""Budgets that λ is steered to and caps that no frame exceeds, on simulated routes and clocks."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from live_cases import played, policy_on

from amusic_gym.envs import live_route, live_rows
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.live import drives
from amusic_gym.live.limits import WINDOW, Limits
from amusic_gym.live.navigation import navigate
from amusic_gym.policies.protocol import Needs
from amusic_gym.routes.simulate import simulate

pytest.importorskip("torch", reason="the selector that ships runs on PyTorch")


class Clock:
    """Time that only runs of techniques, and what each frame takes besides, let pass."""

    def __init__(self, monkeypatch, milliseconds, besides: float = 0.0, jitter: float = 0.0):
        self.now, self.milliseconds, self.besides, self.jitter = 0.0, milliseconds, besides, jitter
        self.rng = np.random.default_rng(0)
        for module in (live_route, live_rows, drives):
            monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=self.read))

    def read(self) -> float:
        return self.now / 1000.0

    def ran(self, technique: int) -> None:
        self.now += self.milliseconds[technique] * (1.0 + self.jitter * self.rng.uniform(-1, 1))


def drive(route, limits, spec="ppo", *, seconds=None, measured=False, weight=0.3):
    policy = policy_on(spec, route) if isinstance(spec, str) else spec
    seconds = route.seconds if seconds is None else seconds
    how = {"measured": measured, "weight": weight}
    keeper = limits.keeper(policy, route.techniques, seconds, **how)
    return list(navigate(policy, route, compute_weight=weight, keeper=keeper))


def off_budget(costs, budget: float) -> float:
    """Largest share by which the average over the last frames is off, once there are enough."""
    means = np.convolve(costs, np.full(WINDOW, 1 / WINDOW), "valid")
    assert means.size > 100
    return float(np.abs(means / budget - 1).max())


@pytest.mark.parametrize("seed", [1, 3])
@pytest.mark.parametrize("share", [0.0, 0.03, 0.3, 0.97])
def test_the_average_is_held_to_a_budget_of_declared_costs(seed, share):
    bank = simulate(seed, queries=450, techniques=2 + seed)
    cost = 1000 * bank.seconds
    budget = cost.min() + share * (cost.sum() - cost.min())
    seen = drive(played(bank), Limits(budget_ms=budget))
    assert off_budget([each.ran @ cost for each in seen], budget) < 0.1
    assert len({each.compute_weight for each in seen}) > 1


@pytest.mark.parametrize("limits", [{"budget_ms": 60.0}, {"budget_fps": 1000 / 60.0}])
def test_the_average_is_held_to_a_budget_of_measured_costs(monkeypatch, limits):
    bank = simulate(2, queries=450, techniques=4)
    clock = Clock(monkeypatch, [20.0, 5.0, 90.0, 40.0], jitter=0.3)
    seen = drive(played(bank, clock.ran), Limits(**limits), measured=True)
    assert off_budget([each.milliseconds for each in seen], 60.0) < 0.1


def test_a_frame_that_waits_for_a_compiler_does_not_starve_the_rest(monkeypatch):
    bank = simulate(2, queries=330, techniques=3)
    clock = Clock(monkeypatch, [20.0, 5.0, 90.0])
    clock.milliseconds = [20.0, 30_000.0, 90.0]
    policy = Rating()  # wants all, on every frame
    route = played(bank, clock.ran)
    how = {"measured": True, "weight": 0.3}
    keeper = Limits(budget_ms=60.0).keeper(policy, route.techniques, [0.02, 0.005, 0.09], **how)
    seen = []
    for each in navigate(policy, route, compute_weight=0.3, keeper=keeper):
        clock.milliseconds = [20.0, 5.0, 90.0]
        seen.append(each)
    assert seen[0].milliseconds > 30_000
    assert any(each.ran[2] for each in seen[1:60])
    assert off_budget([each.milliseconds for each in seen[1:]], 60.0) < 0.1


def test_a_budget_in_joules_counts_joules():
    bank = simulate(2, queries=450, techniques=3)
    joules = dict(zip(bank.techniques, (3.0, 0.5, 8.0), strict=True))
    limits = Limits(budget_joules=2.0, joules=joules)
    route = played(bank).with_seconds(limits.costs(bank.techniques, bank.seconds))
    assert route.seconds.tolist() == [3.0, 0.5, 8.0]
    seen = drive(route, limits, seconds=bank.seconds)
    assert off_budget([each.ran @ route.seconds for each in seen], 2.0) < 0.1


@pytest.mark.parametrize("spec", ["ppo", "voi", "ppo:idle", "music"])
def test_no_frame_exceeds_the_cap(spec):
    bank = simulate(3, queries=120, techniques=4)
    cost = 1000 * bank.seconds
    cap = np.sort(cost)[:2].sum() * 1.001
    free = drive(played(bank), Limits(), spec, weight=0.01)
    seen = drive(played(bank), Limits(cap_ms=cap), spec, weight=0.01)
    assert max(each.ran @ cost for each in free) > cap
    assert max(each.ran @ cost for each in seen) <= cap
    least = 50 if spec.endswith("idle") else len(seen)  # not only what ran nothing anyway
    assert sum(each.ran.any() for each in seen) >= least


def test_the_dearest_are_dropped_until_the_rest_fits_and_measured_costs_count(monkeypatch):
    bank = simulate(3, queries=40, techniques=3)
    clock = Clock(monkeypatch, [10.0, 30.0, 50.0])
    route = played(bank, clock.ran)
    everything = Limits(cap_ms=45.0)
    # Declared as equal: what they really take is learned from the runs.
    seen = drive(route, everything, "music", seconds=np.full(3, 0.012), measured=True)
    assert seen[0].ran.tolist() == [True, True, True]
    assert seen[-1].ran.tolist() == [True, True, False]


class Rating:
    """Wants everything, and rates the subset of the first and third next best."""

    needs = Needs()

    def reset(self, mask):
        pass

    def act(self, observation, info):
        return np.ones((1, 3), np.bool_)

    def rate(self, observation):
        assert observation.shape[0] == 1
        subsets = np.array([[1, 1, 1], [1, 1, 0], [1, 0, 1], [1, 0, 0]], np.bool_)
        return subsets, np.array([9.0, 1.0, 5.0, 4.0])


def test_a_selector_that_rates_subsets_gets_its_best_below_the_cap():
    bank = simulate(3, queries=20, techniques=3)
    for cap, wanted in ((100.0, [1, 1, 1]), (55.0, [1, 0, 1]), (25.0, [1, 0, 0])):
        seen = drive(played(bank), Limits(cap_ms=cap), Rating(), seconds=[0.01, 0.02, 0.04])
        assert {tuple(each.ran) for each in seen} == {tuple(map(bool, wanted))}


def test_the_weight_of_an_episode_changes_between_steps_as_if_it_had_begun_with_it():
    bank = simulate(1, queries=30, techniques=3)
    found = []
    for begin, later in ((2.0, 2.0), (0.1, 2.0)):
        env = TechniqueSelectionEnv(bank)
        env.reset(seed=0, options={"compute_weight": begin})
        env.step(np.array([1, 0, 1]))
        env.task.episodes.set_compute_weight(0, later)
        observation, reward, _, _, info = env.step(np.array([1, 1, 0]))
        found.append((observation.tobytes(), reward, info["compute_weight"]))
    assert found[0] == found[1]
    assert found[0][2] == 2.0


def test_without_limits_nothing_changes():
    bank = simulate(1, queries=60, techniques=3)
    assert not Limits()
    free = [each.ran.tolist() for each in drive(played(bank), Limits())]
    wide = [each.ran.tolist() for each in drive(played(bank), Limits(cap_ms=1e9))]
    assert free == wide


@pytest.mark.parametrize(
    ("limits", "spec", "words"),
    [
        ({"budget_ms": 0}, "ppo", "budget_ms is 0; give a number above 0"),
        ({"budget_ms": 9, "budget_fps": 9}, "ppo", "budget_ms and budget_fps are both budgets"),
        ({"budget_joules": 9}, "ppo", "budget_joules goes with joules"),
        ({"cap_ms": float("nan")}, "ppo", "cap_ms is nan; give a number above 0"),
        ({"budget_ms": 1e-9}, "ppo", r"no frame fits within 1e-09 ms: the cheapest technique, "),
        ({"cap_ms": 1e-9}, "music", "no frame fits within 1e-09 ms: the cheapest technique, "),
        ({"cap_ms": 1e9}, "amusic", "a budget or cap cannot hold .*; take a policy such as ppo"),
        ({"cap_ms": 1e9}, "hmm", "a budget or cap cannot hold .*; take a policy such as ppo"),
    ],
)
def test_limits_that_cannot_be_kept_are_refused(limits, spec, words):
    with pytest.raises(ValueError, match=words):
        drive(played(simulate(1, queries=5)), Limits(**limits), spec)


def test_a_budget_needs_a_policy_with_a_weight_and_joules_of_every_technique():
    with pytest.raises(ValueError, match="policy music has no λ to hold a budget with; take ppo"):
        Limits(budget_ms=5).check("music")
    Limits(budget_ms=5).check("ppo")
    Limits(cap_ms=5).check("music")
    limits = Limits(budget_joules=1.0, joules={"HOG": 1.0})
    with pytest.raises(ValueError, match="joules of CALC are not given"):
        limits.costs(["HOG", "CALC"], [1, 1])
    with pytest.raises(ValueError, match="unknown technique 'HOG'"):
        limits.costs(["CALC"], [1])
