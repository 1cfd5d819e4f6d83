"""Training finds out what is planted, and its run folder tells how it went."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from amusic_agents import network
from amusic_agents.config import NetworkConfig, TrainingConfig
from amusic_agents.evaluation import COMPUTE_WEIGHTS, Evaluation, HeldOut
from amusic_agents.learning import make_env
from amusic_agents.network import SelectorNetwork
from amusic_agents.ppo import PPOLearner
from amusic_agents.records import Records
from amusic_agents.run_folder import (
    CHECKPOINT,
    EVALUATIONS,
    SELECTOR,
    read_config,
    read_tensors,
    stored_banks,
    stored_config,
)
from amusic_agents.selector import TrainedSelector, load_selector
from amusic_agents.training import train
from env_cases import random_bank
from planted_routes import planted
from small_training import SMALL
from stable_baselines3.common.logger import Logger
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs import observation
from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.metrics import compute
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.policies.trace import Trace

pytestmark = pytest.mark.slow

FILES = {"config.json", SELECTOR, CHECKPOINT, EVALUATIONS, "progress.csv"}


def small(**changes) -> TrainingConfig:
    return TrainingConfig(**{**SMALL, "timesteps": 160, **changes})


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A run on two banks: 160 frames, evaluated after 64, 128 and 160."""
    folder = tmp_path_factory.mktemp("trained")
    bank = random_bank(3, queries=9).save(folder / "bank")
    train(folder / "run", small(), banks=[bank, random_bank(4).save(folder / "b4")], progress=False)
    return folder / "run"


# ---- what is learned -----------------------------------------------------------------------


def planted_routes(first: int, number: int) -> list[ScoreBank]:
    """Routes on which one technique is good at a time, another one every 25 frames."""
    return [planted(first + i, frames_per_regime=25, references=120) for i in range(number)]


def score(traces: list[Trace], weight: float) -> float:
    """Correct − λ · compute per frame, as the reward counts it, with true correctness."""
    return float(np.mean([trace.correct.mean() - weight * compute(trace) for trace in traces]))


def test_a_selector_learns_to_follow_the_planted_technique(tmp_path):
    weight = 0.5
    config = TrainingConfig(
        timesteps=80_000,
        n_envs=32,
        n_steps=32,
        batch_size=512,
        learning_rate=2e-3,
        compute_weights=(weight, weight),
        evaluate_every=10**6,
        held_out=1,
        statistic="evidence",  # its memory is what makes finding the good technique pay so soon
        carry=False,  # else useless techniques go on from where the good one was
        network=NetworkConfig(first_logit=0.0),
    )
    unseen = [Job(bank, weight) for bank in planted_routes(900, 4)]
    torch.manual_seed(0)  # an untrained network may follow a little by chance
    first = SelectorNetwork(config.network)
    before = rollouts(
        TrainedSelector(first, "evidence", config.environment()), unseen, name="untrained"
    )
    trained = train(tmp_path / "run", config, banks=planted_routes(0, 24), progress=False)
    after = rollouts(trained, unseen, name="trained")
    assert score(after, weight) > score(before, weight) + 0.2
    pairs = [(trace, job.bank) for trace, job in zip(after, unseen, strict=True)]
    assert np.mean([follows(*pair) for pair in pairs]) > 0.6
    pairs = [(trace, job.bank) for trace, job in zip(before, unseen, strict=True)]
    assert np.mean([follows(*pair) for pair in pairs]) < 0.1


def follows(trace: Trace, bank: ScoreBank) -> float:
    """How much more often the one good technique runs than the others, late in each regime."""
    best = bank.scores.argmax(axis=2)  # (T, Q)
    right = np.stack([bank.truth.correct(places) for places in best])
    good = np.repeat([np.argmax(part.sum(1)) for part in np.split(right, 4, axis=1)], 25)
    late = np.arange(bank.queries) % 25 >= 5
    is_good = good[late, None] == np.arange(4)
    return float(trace.ran[late][is_good].mean() - trace.ran[late][~is_good].mean())


# ---- the run folder ------------------------------------------------------------------------


def test_the_run_folder_holds_what_it_should_and_nothing_else(run):
    names = {file.name for file in run.iterdir()}
    events = {name for name in names if name.startswith("events.out.tfevents.")}
    assert names == FILES | events
    assert len(events) == 1


def test_config_json_holds_arguments_versions_banks_and_the_best(run):
    config = read_config(run)
    assert config["versions"] == {
        "format": 1,
        "observation": observation.VERSION,
        "network": network.VERSION,
        "statistic": SICSettings.statistic,
    }
    assert stored_config(run) == small()
    assert stored_banks(run) == [str(run.parent / "bank"), str(run.parent / "b4")]
    assert config["environment"] == {"carry": True, "discount": True}
    rows = evaluations(run)
    assert config["best"] == max(rows, key=lambda row: row["score"])


def test_threads_change_nothing_in_what_is_learned(run, tmp_path):
    train(tmp_path, small(threads=2), banks=stored_banks(run), progress=False)
    assert stored_config(tmp_path).threads == 2
    (first, _), (second, _) = (read_tensors(folder / CHECKPOINT) for folder in (run, tmp_path))
    assert [name for name in first if not torch.equal(first[name], second[name])] == []


def evaluations(run: Path) -> list[dict[str, float]]:
    with (run / EVALUATIONS).open(newline="") as file:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]
    return [{**row, "timesteps": int(row["timesteps"])} for row in rows]


def test_evaluation_csv_has_a_row_per_evaluation(run):
    rows = evaluations(run)
    assert [row["timesteps"] for row in rows] == [64, 128, 160]
    for row in rows:
        assert tuple(row) == Evaluation._fields
        assert all(math.isfinite(value) for value in row.values())
        assert 0 <= min(row["accuracy"], row["compute"], row["p_correct"])
        assert max(row["accuracy"], row["compute"], row["p_correct"]) <= 1 + 1e-9


def test_the_terms_of_the_reward_are_logged(run):
    events = EventAccumulator(str(run)).Reload()
    tags = set(events.Tags()["scalars"])
    assert {"route/return", "route/correctness", "route/compute", "held_out/score"} <= tags
    for scalar in events.Scalars("route/correctness"):
        assert 0.0 < scalar.value <= 1.0
    assert all(scalar.value < 0.0 for scalar in events.Scalars("route/compute"))
    assert [scalar.step for scalar in events.Scalars("held_out/score")] == [96, 160, 160]
    with (run / "progress.csv").open(newline="") as file:
        logged = list(csv.DictReader(file))
    assert [row["time/total_timesteps"] for row in logged[:2]] == ["32", "64"]
    assert "route/return" in logged[0]


def test_the_return_is_the_sum_of_the_terms(run):
    events = EventAccumulator(str(run)).Reload()
    values = {
        name: [scalar.value for scalar in events.Scalars(f"route/{name}")]
        for name in ("return", "correctness", "compute")
    }
    first = values["return"][0]  # 40 and 9 frames: only routes of 9 have ended so early
    assert first == pytest.approx(9 * (values["correctness"][0] + values["compute"][0]), rel=1e-4)


class Scripted(HeldOut):
    """Held-out routes whose scores are written down beforehand."""

    def __init__(self, scores: list[float]) -> None:
        self.scores = iter(scores)

    def evaluate(self, selector: TrainedSelector, timesteps: int) -> Evaluation:
        return Evaluation(timesteps, next(self.scores), 0.5, 0.5, 0.5)


def test_the_best_selector_is_kept(tmp_path, bank):
    config = small()
    records = Records(tmp_path, config, [None], PPOLearner.kind)
    records.held_out = Scripted([0.1, 0.7, 0.4, 0.7])
    learner = PPOLearner(config, SimulatedRoutes(pool=1), records)
    learner.model.set_logger(Logger(None, []))
    kept = []
    for step in range(4):
        learner.model.num_timesteps = step
        with torch.no_grad():
            learner.network.head[-1].bias.fill_(float(step))
        learner.evaluate()
        kept.append(float(load_selector(tmp_path).network.head[-1].bias.detach()))
    assert kept == [0.0, 1.0, 1.0, 1.0]
    assert read_config(tmp_path)["best"]["score"] == 0.7
    assert read_config(tmp_path)["best"]["timesteps"] == 1
    assert [row["score"] for row in evaluations(tmp_path)] == [0.1, 0.7, 0.4, 0.7]
    tensors, _ = read_tensors(tmp_path / CHECKPOINT)
    assert float(tensors["policy.mlp_extractor.head.2.bias"]) == 3.0  # the last, not the best


def test_train_returns_the_stored_selector(run, bank):
    loaded = load_selector(run)
    tensors, metadata = read_tensors(run / SELECTOR)
    assert loaded.network.state_dict().keys() == tensors.keys()
    assert json.loads(metadata["network"]) == {"hidden": 64, "encoding": 32, "first_logit": 1.0}
    traces = rollouts(loaded, [Job(bank, 0.1), Job(bank, 10.0)], name="ppo")
    assert [trace.statistic for trace in traces] == [SICSettings.statistic] * 2


@pytest.mark.parametrize("name", ["carry", "discount"])
def test_a_selector_brings_what_it_was_trained_with(name, bank, tmp_path):
    config = small(**{name: False, "timesteps": 32})
    selector = train(tmp_path, config, banks=[bank], progress=False)
    other = {"carry", "discount"} - {name}
    assert read_config(tmp_path)["environment"] == {name: False, other.pop(): True}
    assert stored_config(tmp_path) == config
    assert (selector.needs.carry, selector.needs.discount) == (name != "carry", name == "carry")
    trace = rollout(selector, bank, name="ppo", **{name: True})
    assert trace.carry is (name != "carry")


def test_a_training_drives_as_its_configuration_says():
    for config in (small(), small(carry=False), small(discount=False), small(statistic="belief")):
        env = make_env(config, SimulatedRoutes(pool=1))
        settings = env.task.settings
        assert settings.statistic == config.statistic
        assert {name: getattr(settings, name) for name in ("carry", "discount")} == (
            config.environment()
        )


# ---- evaluation ----------------------------------------------------------------------------


def test_held_out_routes_are_always_the_same_and_no_training_ones():
    first, second = HeldOut(2, "evidence"), HeldOut(3, "evidence")
    assert len(first.jobs) == 2 * len(COMPUTE_WEIGHTS)
    for one, other in zip(first.jobs, second.jobs, strict=False):
        np.testing.assert_array_equal(one.bank.scores, other.bank.scores)
    seen = {job.bank.scores.tobytes() for job in second.jobs}
    for seed in (0, 1):
        source = SimulatedRoutes(pool=3, seed=1_000_000 + seed)
        banks = [source.sample(np.random.default_rng(0), i)[0] for i in range(3)]
        assert not seen & {bank.scores.tobytes() for bank in banks}


def test_an_evaluation_is_correct_minus_weighted_compute():
    network = SelectorNetwork(NetworkConfig(first_logit=5.0))  # runs everything
    result = HeldOut(2, "evidence").evaluate(TrainedSelector(network, "evidence"), 7)
    assert result.timesteps == 7
    assert result.compute == pytest.approx(1.0)
    assert result.score == pytest.approx(result.accuracy - np.mean(COMPUTE_WEIGHTS))


@pytest.mark.parametrize(
    ("within", "weights"), [((0.02, 0.3), [0.03, 0.1, 0.3]), ((0.4, 0.9), [0.6])]
)
def test_a_selector_is_judged_at_the_compute_weights_that_it_was_trained_for(
    within, weights, tmp_path
):
    held_out = HeldOut(2, "evidence", within)
    assert [job.compute_weight for job in held_out.jobs] == pytest.approx(2 * weights)
    config = small(compute_weights=within, held_out=1)
    records = Records(tmp_path, config, [None], PPOLearner.kind)
    assert {job.compute_weight for job in records.held_out.jobs} <= {
        job.compute_weight for job in held_out.jobs
    }
    assert records.policy(SelectorNetwork(NetworkConfig())).compute_weights == within


def test_beyond_its_highest_weight_a_selector_acts_as_at_it(tmp_path, bank):
    config = small(compute_weights=(0.1, 2.0), highest_weight=0.5, timesteps=32)
    assert config.acting_weights == (0.1, 0.5)
    assert replace(config, highest_weight=9.0).acting_weights == (0.1, 2.0)
    assert replace(config, highest_weight=0.01).acting_weights == (0.1, 0.1)
    train(tmp_path, config, banks=[bank], progress=False)
    assert stored_config(tmp_path) == config
    assert load_selector(tmp_path).compute_weights == (0.1, 0.5)


# ---- configuration -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"timesteps": 0}, "timesteps is 0; give a whole number >= 1"),
        ({"timesteps": 1.5}, "timesteps is 1.5; give"),
        ({"n_envs": -1}, "n_envs is -1; give"),
        ({"held_out": 0}, "held_out is 0; give"),
        ({"evaluate_every": 0}, "evaluate_every is 0; give"),
        ({"batch_size": 1}, "batch_size is 1; give a whole number >= 2"),
        ({"seed": -1}, "seed is -1; give a whole number from 0 to"),
        ({"seed": 2_000_000_000}, "seed is 2000000000; give"),
        ({"n_envs": 1, "n_steps": 1}, r"n_steps \* n_envs is 1; raise"),
        ({"statistic": "evidense"}, "statistic 'evidense'.*evidence"),
        ({"statistic": "belief", "carry": True}, "carry is True, but 'belief' has no candidates"),
        ({"discount": 0.95}, "discount is 0.95"),
    ],
)
def test_bad_configurations_are_refused(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        TrainingConfig(**changes)


@pytest.mark.parametrize("n_envs", [1, 2, 3, 24, 61, 64, 100])
def test_batches_divide_an_update_evenly(n_envs):
    config = TrainingConfig(n_envs=n_envs)
    assert config.rollout % config.batch == 0
    assert config.rollout // config.batch <= 2 * math.ceil(config.rollout / 1024)
    PPOLearner.make_model(config, SimulatedRoutes(pool=1))  # no warning of a truncated batch
