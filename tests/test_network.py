"""One network fits any number and order of techniques."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import torch
from amusic_agents.adapter import SB3VecEnv
from amusic_agents.config import NetworkConfig, TrainingConfig
from amusic_agents.network import ABSENT, ROUTE_WIDTH, WIDTH, SelectorNetwork
from amusic_agents.ppo import PPOLearner
from amusic_agents.selector import TrainedSelector, load_selector
from amusic_agents.shipped import shipped
from env_cases import random_bank
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from amusic_gym.envs.sources import Banks
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.evaluation.rollout import rollout

NUMBERS = st.floats(-1.0, 1.0, width=32)
BATCH = 3


def network(seed: int = 0) -> SelectorNetwork:
    """One whose last layer is not nearly zero, as it is before training."""
    torch.manual_seed(seed)
    made = SelectorNetwork(NetworkConfig())
    with torch.no_grad():
        made.head[-1].weight.mul_(100.0)
    return made


NETWORK = network()


@st.composite
def observations(draw, least: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Groups (B, S, F), some of empty slots, and the route's (B, G)."""
    slots = draw(st.integers(least, 16))
    groups = draw(arrays.arrays(np.float32, (BATCH, slots, WIDTH), elements=NUMBERS))
    present = draw(arrays.arrays(np.bool_, (BATCH, slots)))
    present[:, 0] = True
    groups[..., 0] = 1.0
    groups[~present] = 0.0
    return groups, draw(arrays.arrays(np.float32, (BATCH, ROUTE_WIDTH), elements=NUMBERS))


@torch.no_grad()
def outputs(groups: np.ndarray, route: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logits (B, S) and the critic's features (B, V)."""
    flat = np.concatenate([groups.reshape(BATCH, -1), route], axis=1)
    logits, value = NETWORK(torch.from_numpy(flat))
    np.testing.assert_array_equal(NETWORK.logits(torch.from_numpy(flat)), logits)
    np.testing.assert_array_equal(NETWORK.forward_critic(torch.from_numpy(flat)), value)
    return logits.numpy(), value.numpy()


def assert_close(first: np.ndarray, second: np.ndarray) -> None:
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-4)


@settings(max_examples=60, deadline=None)
@given(observations(), st.randoms(use_true_random=False))
def test_permuting_the_techniques_permutes_the_logits_and_keeps_the_value(seen, random):
    groups, route = seen
    order = list(range(groups.shape[1]))
    random.shuffle(order)
    logits, value = outputs(groups, route)
    moved, same = outputs(groups[:, order], route)
    assert logits.shape == groups.shape[:2]
    assert_close(moved, logits[:, order])
    assert_close(same, value)


@settings(max_examples=60, deadline=None)
@given(observations(), st.integers(1, 15))
def test_empty_slots_do_not_run_and_change_nothing(seen, more):
    groups, route = seen
    logits, value = outputs(groups, route)
    assert (logits[groups[..., 0] == 0.0] == ABSENT).all()
    assert (logits[groups[..., 0] == 1.0] > ABSENT).all()
    empty = np.zeros((BATCH, more, WIDTH), np.float32)
    wider, same = outputs(np.concatenate([groups, empty], axis=1), route)
    assert_close(wider[:, : groups.shape[1]], logits)
    assert (wider[:, groups.shape[1] :] == ABSENT).all()
    assert_close(same, value)


def test_logits_depend_on_the_technique_the_others_and_the_route():
    rng = np.random.default_rng(0)
    groups = rng.uniform(-1, 1, (BATCH, 4, WIDTH)).astype(np.float32)
    groups[..., 0] = 1.0
    route = rng.uniform(-1, 1, (BATCH, ROUTE_WIDTH)).astype(np.float32)
    logits, value = outputs(groups, route)
    assert np.ptp(logits, axis=1).min() > 0.01
    other = groups.copy()
    other[:, 3, 1:] *= -1
    changed, new_value = outputs(other, route)
    assert (np.abs(changed - logits) > 1e-4).all()  # of the three others too
    assert (new_value != value).any()
    assert (np.abs(outputs(groups, -route)[0] - logits) > 1e-4).all()


@pytest.mark.parametrize("techniques", [1, 2, 5, 16])
def test_any_number_of_techniques_is_driven_by_the_same_weights(techniques):
    bank = random_bank(techniques, techniques=techniques, queries=12)
    trace = rollout(TrainedSelector(NETWORK, "evidence"), bank, name="net", compute_weight=0.5)
    assert trace.ran.shape == (12, techniques)
    assert trace.ran.any(axis=1).all()  # an empty action runs the cheapest
    if techniques == 1:
        assert trace.ran.all()


def test_the_policy_samples_no_empty_slot_and_learns_on_mixed_ensembles():
    banks = [random_bank(n, techniques=n, queries=8) for n in (1, 3, 5)]
    config = TrainingConfig(n_envs=6, n_steps=16, epochs=1)
    model = PPOLearner.make_model(config, Banks(banks, aligned=False))
    before = {k: v.clone() for k, v in model.policy.state_dict().items()}
    model.learn(2 * config.rollout)  # the learning rate falls to 0 at the last update
    after = model.policy.state_dict()
    assert all(torch.isfinite(value).all() for value in after.values())
    assert [name for name in before if torch.equal(before[name], after[name])] == []
    present = model.rollout_buffer.observations[..., : 5 * WIDTH : WIDTH] == 1.0
    actions = model.rollout_buffer.actions.reshape(present.shape) == 1.0
    assert {1, 3, 5} == set(present.sum(axis=-1).ravel())
    assert not actions[~present].any()
    assert actions[present].any()


def test_the_policy_and_the_selector_agree():
    env = SB3VecEnv(
        TechniqueSelectionVectorEnv(4, random_bank(1), autoreset_mode="SameStep", allow_idle=True)
    )
    model = PPOLearner.make_model(TrainingConfig(n_envs=4), env.env.task.source)
    net = model.policy.mlp_extractor
    env.reset()
    observation, *_ = env.step(np.ones((4, 3)))
    with torch.no_grad():  # a last layer that tells these techniques apart
        net.head[-1].weight.mul_(100.0)
        net.head[-1].bias.sub_(net.logits(torch.from_numpy(observation)).mean())
    selector = TrainedSelector(net, "evidence")
    seen = set()
    for _ in range(20):
        action, _ = model.predict(observation, deterministic=True)
        np.testing.assert_array_equal(selector.act(observation, {}), action == 1)
        seen.update(map(tuple, action))
        observation, *_ = env.step(action)
    assert len(seen) > 1


@pytest.mark.parametrize("first", [-2.0, 0.0, 2.0])
def test_every_technique_starts_near_the_first_logit(first):
    torch.manual_seed(0)
    made = SelectorNetwork(NetworkConfig(first_logit=first))
    observation = torch.rand(8, 3 * WIDTH + ROUTE_WIDTH)
    observation[:, : 3 * WIDTH : WIDTH] = 1.0
    assert (made.logits(observation) - first).abs().max() < 0.1


@pytest.mark.parametrize("size", [0, -3, 2.5, "64", None, 10**9])
@pytest.mark.parametrize("name", ["hidden", "encoding"])
def test_sizes_out_of_range_are_refused(name, size):
    with pytest.raises(ValueError, match=rf"{name} is {size!r}; give a whole number from 1 to"):
        NetworkConfig(**{name: size})


def test_beyond_its_range_a_selector_acts_as_at_the_nearest_end():
    bank = random_bank(4, queries=60)
    selector = load_selector(allow_idle=True)
    low, high = selector.compute_weights
    for weight, nearest in ((low / 3, low), (high, high), (high * 20, high)):
        ran = [rollout(selector, bank, name="s", compute_weight=w).ran for w in (weight, nearest)]
        np.testing.assert_array_equal(*ran)
    selector.compute_weights = None
    far = rollout(selector, bank, name="s", compute_weight=high * 20).ran
    assert (far != ran[0]).any()


@pytest.mark.parametrize("wrong", [[0.0, 1.0], [2.0, 1.0], [1.0], "ab", 3, [1.0, None]])
def test_a_range_that_no_training_has_is_refused(tmp_path, wrong):
    shutil.copytree(shipped(), tmp_path / "run")
    path = tmp_path / "run" / "config.json"
    config = json.loads(path.read_text())
    config["training"]["compute_weights"] = wrong
    path.write_text(json.dumps(config))
    with pytest.raises(ValueError, match="is damaged"):
        load_selector(tmp_path / "run")
