"""The observation: its layout, and every entry against the documented meaning."""

from __future__ import annotations

import math
import re
from collections import defaultdict

import numpy as np
import oracle
import pytest
from env_cases import assert_same, play, random_actions, random_bank

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.observation import (
    ROUTE_FEATURES,
    TECHNIQUE_FEATURES,
    limit_compute_weight,
    observation_names,
    observation_size,
)
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.prediction import SMOOTHING
from amusic_gym.estimation.settings import STATISTICS


def documented(heading: str) -> list[str]:
    """Names in one of the docstring's tables, in order."""
    table = TechniqueSelectionEnv.__doc__.split(f"| {heading} | meaning |")[1].split("\n\n")[0]
    return re.findall(r"^ *\| (\w+) \|", table, re.MULTILINE)


def test_layout_is_the_documented_one(bank):
    assert tuple(documented("per technique")) == TECHNIQUE_FEATURES
    assert tuple(documented("route")) == ROUTE_FEATURES
    names = observation_names(bank.techniques)
    assert len(names) == len(set(names)) == observation_size(3)
    assert TechniqueSelectionEnv(bank).reset(seed=0)[0].shape == (len(names),)
    assert names[0] == "T0.present"
    assert names[len(TECHNIQUE_FEATURES)] == "T1.present"
    assert names[-1] == "route.on_map"


def squash(value: float) -> float:
    return value / (abs(value) + 4)


class Observer:
    """The documented observation, worked out from the infos and the explicit loops of SIC."""

    def __init__(self, env: TechniqueSelectionEnv, bank: ScoreBank, weight: float) -> None:
        self.bank, self.weight = bank, weight
        self.settings, self.block = env.task.settings, env.task.block
        self.width = len(bank.techniques)
        self.z = oracle.standardise_bank(bank.scores)
        ours = (self.settings.carry, self.settings.discount)
        self.how = (50, 1000, 1.0, self.settings.statistic, self.z, *ours)
        self.memory = oracle.Memory.of(self.width)
        self.exists = np.zeros((bank.queries, self.width), bool)
        self.slots: list[dict] = [defaultdict(float, last=-1) for _ in range(self.width)]
        self.route: dict = defaultdict(float, prediction=-1)
        self.on_map = oracle.OnMap(bank.scores, self.z, bank.tolerance)

    def look_back(self, frame: int) -> None:
        """Run everything on the block before a frame."""
        block = list(range(max(0, frame - self.block), frame))
        oracle.select(self.bank.scores, self.exists, block, self.how, 0.7, self.memory)
        self.run(frame - 1, keep=False)

    def run(self, frame: int, keep: bool = True) -> None:
        """Remember the corrected match on a frame of every technique that ran there."""
        result = oracle.music(self.bank.scores, self.exists, frame, *self.how, self.memory)
        for t, sic in enumerate(result.sics):
            if sic is None:
                continue
            alone = oracle.Music(0, sic.place, sic.statistic, [sic])
            self.slots[t].update(
                place=sic.place,
                statistic=sic.statistic,
                margin=oracle.margin(alone, self.bank.tolerance) or 0.0,
                last=frame,
                correction=sic.correction,
                weight=result.compared(t, 1.0),
            )
        if keep:
            self.memory.note(result, frame)
            self.route["supported"] = self.support(result, frame)

    def support(self, result: oracle.Music, frame: int) -> float:
        """How far another technique than the chosen one supports what MuSIC says."""
        best, chosen = 0.0, self.z[result.technique][frame]
        for t, slot in enumerate(self.slots):
            if t == result.technique or slot["last"] < 0:
                continue
            if slot["last"] == frame:
                slot["likeness"] = float(np.dot(chosen, self.z[t][frame])) / len(chosen)
                if not np.any(chosen) or not np.any(self.z[t][frame]):
                    slot["likeness"] = 1.0
            age = frame - slot["last"]
            if abs(slot["place"] + age - result.place) <= self.bank.tolerance:
                best = max(best, (1 - min(max(slot["likeness"], 0), 1)) * 0.98**age)
        return best

    def note(self, frame: int, info: dict) -> None:
        """Take in what a step's infos say."""
        route, before = self.route, self.route["prediction"]
        late = info["selection"]["happened"]
        if late:
            self.look_back(frame)
        self.exists[frame] = info["ran"]
        if info["ran"].any():
            self.run(frame)
        route["prediction"] = info["prediction"]
        route["continues"] = float(before >= 0 and self.continues(before, info))
        route["track"] = route["continues"] * (route["track"] + 0.1)
        route["since_confirmed"] += 1
        route["since_doubt"] = 0.0 if info["p_correct"] < 0.5 else route["since_doubt"] + 1
        route["p_mean"] += SMOOTHING * (info["p_correct"] - route["p_mean"])
        route["compute"] = info["seconds"] / self.bank.seconds.sum()
        route["compute_mean"] += SMOOTHING * (route["compute"] - route["compute_mean"])
        self.relate(frame, info)
        self.on_map.note(frame, np.flatnonzero(info["ran"]).tolist(), info["prediction"])

    def continues(self, before: int, info: dict) -> bool:
        """Whether the prediction moved on by one place; idle ones do, up to the map's end."""
        return info["idle"] or info["prediction"] == before + 1

    def stored(self, t: int, place: int) -> float:
        """What a technique's last run said for the fused place, moved back along its diagonal."""
        slot = self.slots[t]
        if place < 0:
            return 0.0
        known = (self.z[t], self.exists[:, t], slot["last"], place, 1000, 1.0)
        return oracle.diagonal_statistic(*known, self.settings.statistic)

    def relate(self, frame: int, info: dict) -> None:
        """Compare every technique's last match with the fused prediction."""
        agreeing = 0.0
        for t, slot in enumerate(self.slots):
            if slot["last"] < 0 or info["prediction"] < 0:
                continue
            age = frame - slot["last"]
            near = abs(slot["place"] + age - info["prediction"]) <= self.bank.tolerance
            slot["agrees"] = float(near)
            agreeing += near
            slot["stored"] = self.stored(t, info["prediction"] - age)
            if info["ran"][t]:
                slot["support"] = self.z[t][frame][info["prediction"]]
                slot["support_mean"] += SMOOTHING * (slot["support"] - slot["support_mean"])
                slot["agreement"] += SMOOTHING * (near - slot["agreement"])
                slot["runs"] += 1
                usual = slot["support"] - slot["support_usual"]
                slot["support_usual"] += max(0.02, 1 / slot["runs"]) * usual
                (best,) = oracle.top_candidates(self.bank.scores[t][frame], 1)
                slot["confirms"] = float(abs(best - info["prediction"]) <= self.bank.tolerance)
                slot["confirmation"] += SMOOTHING * (slot["confirms"] - slot["confirmation"])
                if slot["confirms"]:
                    self.route["since_confirmed"] = 0
        self.route["agreeing"] = agreeing / self.width

    def technique_group(self, t: int, frame: int, info: dict) -> list[float]:
        slot, share = self.slots[t], self.bank.seconds[t] / self.bank.seconds.sum()
        return [
            1.0,
            float(info["ran"][t]),
            squash(slot["statistic"]),
            squash(slot["margin"]),
            squash(slot["correction"]),
            slot["agrees"],
            slot["agreement"],
            squash(slot["support"]),
            squash(slot["support_mean"]),
            squash(slot["stored"]),
            slot["weight"],
            squash(frame - slot["last"]) if slot["last"] >= 0 else 1.0,
            float(info["technique"] == t),
            share,
            max(-1.0, 1 + math.log10(share) / 4),
            max(-1.0, min(1.0, 0.5 + 0.5 * math.log10(self.weight * share))),
            slot["confirms"],
            slot["confirmation"],
            squash(slot["support_usual"]),
            squash(slot["statistic"] - slot["stored"]),
        ]

    def route_group(self, frame: int, info: dict) -> list[float]:
        route = self.route
        weight = -1 + 2 * (math.log10(self.weight) + 2) / 3
        return [
            max(-1.0, min(1.0, weight)),
            float(info["prediction"] >= 0),
            squash(info["confidence"]),
            squash(info["margin"]),
            info["p_correct"],
            route["p_mean"],
            route["continues"],
            squash(route["since_doubt"]),
            squash(frame + 1),
            squash(route["compute"]),
            squash(route["compute_mean"]),
            route["agreeing"],
            route["p_steady"],
            squash(route["log_likelihood"]),
            squash(route["log_likelihood_mean"]),
            math.log10(self.bank.references) / 3 - 1,
            squash(self.logit(info)),
            squash(route["since_confirmed"]),
            squash(route["track"]),
            route["supported"],
            1 / (1 + math.exp(-self.on_map.log_odds)),
        ]

    def logit(self, info: dict) -> float:
        """Of p̂."""
        p = info["p_correct"]
        return math.log(p / (1 - p)) if info["prediction"] >= 0 else 0.0

    def expected(self, frame: int, info: dict) -> list[float]:
        groups = [self.technique_group(t, frame, info) for t in range(self.width)]
        return sum(groups, []) + self.route_group(frame, info)


class BeliefObserver(Observer):
    """The same where all that ran feeds one belief: its own records are taken at their word."""

    def __init__(self, env: TechniqueSelectionEnv, bank: ScoreBank, weight: float) -> None:
        super().__init__(env, bank, weight)
        self.episodes = env.task.episodes  # tests/test_belief.py holds its state right

    def look_back(self, frame: int) -> None:
        """Run everything on the block before a frame."""
        self.exists[max(0, frame - self.block) : frame] = True
        self.run(frame - 1)

    def run(self, frame: int, keep: bool = True) -> None:
        """Remember what the rows made of the belief."""
        for t in np.flatnonzero(self.exists[frame]):
            self.read(t, frame)

    def read(self, t: int, frame: int) -> None:
        """Remember what a technique's row made of the belief."""
        known = self.episodes.estimator.state.techniques[0, 0, t]
        self.slots[t].update({key: known[key] for key in ("statistic", "margin", "correction")})
        self.slots[t].update(weight=known["weight"] * known["news"], place=known["place"])
        self.slots[t].update(log_likelihood=known["log_likelihood"], last=frame)

    def note(self, frame: int, info: dict) -> None:
        """Take in what a step's infos say."""
        super().note(frame, info)
        if info["prediction"] >= 0:
            summary, known = self.episodes.estimator.state.beliefs[0, 0], self.route
            known.update({key: float(summary[key]) for key in ("p_steady", "log_likelihood")})
            if not info["idle"]:
                mean = known["log_likelihood"] / info["ran"].sum()
                known["log_likelihood_mean"] += SMOOTHING * (mean - known["log_likelihood_mean"])
        for key in ("place", "statistic", "correction"):
            for t in np.flatnonzero(info["ran"]):
                assert info[key][t] == self.slots[t][key]

    def continues(self, before: int, info: dict) -> bool:
        """Whether the prediction moved on by one place."""
        return info["prediction"] == before + 1

    def stored(self, t: int, place: int) -> float:
        """What a technique's last row said for the place that was the fused one then."""
        return self.slots[t]["log_likelihood"]


@pytest.mark.parametrize("statistic", STATISTICS)
@pytest.mark.parametrize("weight", [0.001, 0.4, 30.0])
def test_observation_means_what_the_table_says(bank, statistic, weight):
    env = TechniqueSelectionEnv(
        bank, statistic=statistic, reselection=4, allow_idle=True, compute_weight=weight
    )
    observer = (BeliefObserver if statistic == "belief" else Observer)(env, bank, weight)
    observation, info = env.reset(seed=0)
    names = observation_names(bank.techniques)
    actions = random_actions(3, 40, (4,), reselect=0.15)
    actions[:2] = 0  # idle before there is any prediction
    for frame, action in enumerate([None, *actions], start=-1):
        if action is not None:
            observation, _, _, _, info = env.step(action)
            observer.note(frame, info)
        expected = dict(zip(names, observer.expected(frame, info), strict=True))
        found = dict(zip(names, observation.tolist(), strict=True))
        assert found == pytest.approx(expected, rel=1e-5, abs=1e-6), f"frame {frame}"


def test_the_belief_has_entries_of_its_own(bank):
    """None of them stays at one value, and a row that repeats the last one weighs less."""
    scores = np.array(bank.scores)
    scores[0, 20:25] = scores[0, 20]  # the robot stands
    standing = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=np.arange(scores.shape[1])
    )
    env = TechniqueSelectionEnv(standing, statistic="belief")
    names = observation_names(bank.techniques)
    seen = [env.reset(seed=0)[0], *(env.step([1, 1, 1])[0] for _ in range(40))]
    columns = dict(zip(names, np.transpose(seen), strict=True))
    for name in (
        "T0.weight",
        "T0.stored",
        "route.p_steady",
        "route.log_likelihood",
    ):
        assert len(set(columns[name])) > 10, name
    repeated = columns["T0.weight"][22:26]
    assert (np.diff(repeated) < 0.0).all()
    assert repeated[-1] < 0.8 * columns["T1.weight"][25]


def test_a_first_prediction_continues_nothing():
    scores = np.zeros((1, 4, 4)) + np.eye(4)
    bank = ScoreBank(scores, ["A"], [1.0], tolerance=0)
    env = TechniqueSelectionEnv(bank)
    env.reset(seed=0)
    position = observation_names(bank.techniques).index("route.continues")
    steps = [env.step([1]) for _ in range(4)]
    assert [step[4]["prediction"] for step in steps] == [0, 1, 2, 3]
    assert [step[0][position] for step in steps] == [0.0, 1.0, 1.0, 1.0]


def test_observation_holds_nothing_of_techniques_that_did_not_run(bank):
    """Other scores of a technique that never runs change nothing; nor does the ground truth."""
    scores = np.array(bank.scores)
    scores[2] = np.random.default_rng(0).normal(size=scores[2].shape)
    truth = np.random.default_rng(1).integers(0, 60, 40)
    other = ScoreBank(
        scores, bank.techniques, bank.seconds, tolerance=2, ground_truth=truth, name=bank.name
    )
    actions = random_actions(0, 30, (3,))
    actions[:, 2] = 0
    both = [play(TechniqueSelectionEnv(b, compute_weight=0.2), actions) for b in (bank, other)]
    assert_same(*both)


@pytest.mark.parametrize(
    ("weight", "nearest"),
    [
        (0.001, 0.02),
        (0.0199, 0.02),
        (0.02, 0.02),
        (0.3, 0.3),
        (0.5, 0.5),
        (0.51, 0.5),
        (100.0, 0.5),
    ],
)
def test_a_compute_weight_out_of_a_range_is_seen_as_its_nearest_end(weight, nearest):
    def seen(compute_weight):
        banks = [random_bank(1, techniques=3), random_bank(2, techniques=2)]
        env = TechniqueSelectionVectorEnv(2, banks, slots=3, compute_weight=compute_weight)
        env.reset(seed=0, options={"bank": np.arange(2)})
        return env.step(np.ones((2, 3)))[0]

    given = seen(weight)
    before = given.copy()
    limited = limit_compute_weight(given, 0.02, 0.5)
    np.testing.assert_allclose(limited, seen(nearest), rtol=0, atol=2e-7)  # shares are float32
    assert (limited is given) == (weight == nearest)
    np.testing.assert_array_equal(given, before)
