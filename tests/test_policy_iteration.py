"""Policy iteration: copies of routes, what rollouts come to, and what is learned from them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from amusic_agents import policy_iteration, records
from amusic_agents.config import RolloutConfig, TrainingConfig
from amusic_agents.network import PRESENT, ROUTE_WIDTH, WIDTH
from amusic_agents.policy_iteration import (
    ACTION_REPEAT,
    BehaviourPolicy,
    Samples,
    draw_subset,
    draw_subsets,
    learn,
    roll_out,
)
from amusic_agents.run_folder import (
    CHECKPOINT,
    CONFIG,
    EVALUATIONS,
    SELECTOR,
    read_tensors,
    stored_banks,
    stored_config,
    write_tensors,
)
from amusic_agents.selector import load_selector
from amusic_agents.subsets import (
    SubsetNetwork,
    SubsetSelector,
    SubsetSizes,
    compute_weight,
    members,
    valid,
)
from amusic_agents.training import train
from env_cases import random_actions, random_bank
from live_cases import pair
from safetensors.torch import load_file
from small_training import SMALL, TRIED, Quick, contents, small_rollouts, stop_at
from stable_baselines3.common.callbacks import CheckpointCallback

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.env import TechniqueSelectionEnv
from amusic_gym.envs.observation import TECHNIQUE_FEATURES
from amusic_gym.envs.outcome import Outcome
from amusic_gym.envs.sources import Banks
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.rollout import rollout

pytestmark = pytest.mark.slow

STATISTIC = SICSettings.statistic
CONFIRMS = TECHNIQUE_FEATURES.index("confirms")


@pytest.fixture(autouse=True, scope="module")
def quick():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("amusic_agents.records.HeldOut", Quick)
        yield


def banks() -> list[ScoreBank]:
    """Two, three and four techniques; the longest route last."""
    return [random_bank(n, techniques=n, queries=14 + 13 * (n - 2)) for n in (2, 3, 4)]


# ---- copies of routes ----------------------------------------------------------------------


def driven(statistic: str, **arguments) -> TechniqueSelectionVectorEnv:
    """Routes of different techniques and length, each in its middle; the first has begun anew."""
    source = Banks([random_bank(1, techniques=2, queries=9), *banks()[1:]], aligned=False)
    env = TechniqueSelectionVectorEnv(
        *(3, source),
        slots=4,
        statistic=statistic,
        compute_weight=(0.1, 3.0),
        autoreset_mode="SameStep",
        **arguments,
    )
    env.reset(seed=3, options={"bank": np.arange(3)})
    for actions in random_actions(1, 9, env.action_space.shape):
        env.step(actions)
    for actions in random_actions(2, 4, env.action_space.shape):
        env.step(actions)
    frames = env.task.episodes.state.routes["frame"]
    assert (frames > 2).all()
    assert len(set(frames.tolist())) > 1
    return env


def assert_rows(whole: Outcome, part: Outcome, rows: slice) -> None:
    """Some of an outcome's routes went as those of another, bit for bit."""
    for ours, theirs in zip(whole, part, strict=True):
        np.testing.assert_array_equal(ours[rows], theirs)


@pytest.mark.parametrize(
    ("statistic", "arguments"),
    [
        ("evidence", {}),
        ("evidence", {"reselection": 5}),
        ("evidence", {"reselection": 8, "candidates": 1}),
        ("evidence", {"carry": False, "discount": False, "gamma": 0.9, "allow_idle": True}),
        ("mean", {}),
        ("mean", {"reselection": 5, "reward": "ground_truth"}),
        ("belief", {}),
        ("belief", {"reselection": 5, "threads": 2}),
    ],
)
def test_copies_go_on_as_the_routes_do_and_leave_them_as_they_are(statistic, arguments):
    """The routes and the first of their copies go one way, an equal batch and the second another.

    All by turns: whatever they shared would show.
    """
    both = [driven(statistic, **arguments) for _ in range(2)]
    copies = both[0].task.repeated(2)
    slots = both[0].task.action_space.n
    active = np.ones((3, 2), np.bool_)
    for actions in random_actions(8, 25, (3, 2, slots), reselect=0.3) == 1:
        out, rewards, terms = copies.step(actions.reshape(6, slots), active.reshape(6))
        ends = copies.ends(out)[0].reshape(3, 2)
        for c, env in enumerate(both):
            own, own_rewards, own_terms = env.task.step(actions[:, c], active[:, c])
            assert_rows(out, own, slice(c, None, 2))
            np.testing.assert_array_equal(rewards[c::2], own_rewards)
            for name, term in own_terms.items():
                np.testing.assert_array_equal(terms[name][c::2], term)
        active &= ~ends
    assert active.any(1).tolist() == [False, False, True]  # routes have ended, one has not


@pytest.mark.parametrize("statistic", ["evidence", "belief"])
def test_copies_of_routes_that_have_just_begun_show_what_these_show(statistic):
    env = TechniqueSelectionVectorEnv(2, banks()[:1], statistic=statistic)
    observation, _ = env.reset(seed=0)
    shown = env.task.repeated(3).episodes.look().observation
    np.testing.assert_array_equal(shown, np.repeat(observation, 3, 0))


def test_a_copy_of_a_copy_goes_on_too():
    env = driven("evidence")
    first = env.task.repeated(2)
    second = first.repeated(2)
    for actions in random_actions(5, 4, (3, 4)) == 1:
        first.step(np.repeat(actions, 2, 0))
    for actions in random_actions(5, 4, (3, 4)) == 1:
        out = second.step(np.repeat(actions, 4, 0))[0]
        own = env.task.step(actions)[0]
        for c in range(4):
            assert_rows(out, own, slice(c, None, 4))


def test_live_routes_are_not_copied(tmp_path):
    env = TechniqueSelectionVectorEnv(1, pair()[1])
    env.reset(seed=0)
    with pytest.raises(ValueError, match="a live route cannot be copied; give score banks"):
        env.task.repeated(2)
    with pytest.raises(ValueError, match="a live route cannot be copied; give score banks"):
        train(tmp_path, small_rollouts(n_envs=1), banks=[pair()[1]], progress=False)


# ---- what subsets are tried ----------------------------------------------------------------


def presences(rng: np.random.Generator, number: int) -> np.ndarray:
    """(N, 5) of two techniques and more."""
    present = rng.random((number, 5)) < 0.5
    present[:, :2] |= present.sum(1, keepdims=True) < 2
    return present


def test_a_subset_has_a_drawn_size_out_of_what_is_there():
    rng = np.random.default_rng(0)
    sizes = set()
    for present in presences(rng, 300):
        subset = draw_subset(present, (1, 3, 99), rng)
        assert not (subset & ~present).any()
        assert subset.sum() in {1, min(3, present.sum()), present.sum()}
        sizes.add(int(subset.sum()))
    assert sizes == {1, 2, 3, 4, 5}


@pytest.mark.parametrize("count", [4, 5, 8, 12])
def test_the_policy_s_subset_single_techniques_all_and_others_are_tried(count):
    rng = np.random.default_rng(count)
    singles = set()
    for present in presences(rng, 200):
        action = draw_subset(present, (1, 2), rng)
        tried = draw_subsets(action, present, count, rng)
        assert (tried.shape, tried.dtype) == ((count, 5), np.bool_)
        assert tried.any(1).all()
        assert not (tried & ~present).any()
        np.testing.assert_array_equal(tried[0], action)
        alone = min(count - 3, int(present.sum()))
        np.testing.assert_array_equal(tried[1 : 1 + alone].sum(1), 1)
        assert len(np.unique(tried[1 : 1 + alone], axis=0)) == alone
        np.testing.assert_array_equal(tried[1 + alone], present)
        assert (tried[2 + alone :].sum(1) >= 2).all()
        singles.update(tried[1].nonzero()[0].tolist())
    assert singles == set(range(5))


class Constant:
    """Always the first technique."""

    def act(self, observation, info) -> np.ndarray:
        actions = np.zeros((len(observation), 6), np.bool_)
        actions[:, 0] = True
        return actions


def spells(seed: int, share: float, policy: Any = None, frames: int = 300) -> np.ndarray:
    """(frames, N, S) actions of six techniques, one of them absent."""
    drives = BehaviourPolicy(4, 6, policy, share, np.random.default_rng(seed))
    present = np.ones((4, 6), np.bool_)
    present[:, 3] = False
    seen = np.zeros((4, 1), np.float32)
    return np.stack([drives.act(seen, present).copy() for _ in range(frames)])


def test_drives_of_the_same_seed_are_the_same():
    first = spells(0, 0.5, Constant())
    np.testing.assert_array_equal(first, spells(0, 0.5, Constant()))
    assert (first != spells(1, 0.5, Constant())).any()


def test_spells_last_and_run_what_is_there():
    actions = spells(2, 0.0)
    assert actions.any(2).all()
    assert not actions[..., 3].any()
    for route in actions.transpose(1, 0, 2):
        changes = np.flatnonzero((route[1:] != route[:-1]).any(1)) + 1
        assert np.diff(changes).min() >= policy_iteration.SPELL[0]
        assert len(changes) > 300 / policy_iteration.SPELL[1] - 3
        assert len(np.unique(route, axis=0)) > 3


def test_the_policy_drives_its_share():
    single = np.arange(6) == 0
    assert (spells(3, 1.0, Constant()) == single).all()
    half = (spells(3, 0.5, Constant(), 2000) == single).all(2).mean()
    assert 0.4 < half < 0.7  # a drawn subset is the first technique at times
    assert (spells(3, 0.0, Constant()) == spells(3, 0.0)).all()
    assert (spells(3, 1.0, None) == spells(3, 0.0)).all()  # no policy yet


# ---- what a rollout comes to ---------------------------------------------------------------


def changeable(statistic: str = STATISTIC) -> SubsetSelector:
    """A policy that runs different subsets from frame to frame."""
    torch.manual_seed(1)
    network = SubsetNetwork(SubsetSizes(hidden=16, encoding=8, ensemble=2))
    with torch.no_grad():
        for values in network.ensemble:
            values.member.weight.mul_(10.0)
            values.value.weight.mul_(10.0)
            values.encoder.layers[0].weight.mul_(5.0)
    return SubsetSelector(network, statistic)


class ByHand:
    """A rollout in a single environment, step by step."""

    def __init__(self, policy: SubsetSelector | None, settings: RolloutConfig) -> None:
        self.policy, self.settings = policy, settings
        self.ran: list[tuple[bool, ...]] = []
        self.ended = 0

    def __call__(self, bank, before, subset, weight, **arguments) -> tuple[float, float]:
        env = TechniqueSelectionEnv(bank, slots=4, compute_weight=weight, **arguments)
        env.reset(seed=0)
        for action in before:
            env.step(action)
        action, correctness, compute, observation = subset, 0.0, 0.0, None
        for frame in range(self.settings.horizon):
            since = frame - self.settings.hold
            if self.policy and since >= 0 and since % ACTION_REPEAT == 0:
                action = self.policy.act(observation[None], {})[0]
            observation, reward, ended, _, info = env.step(action)
            self.ran.append(tuple(info["ran"].tolist()))
            spent = -info["reward_terms"]["compute"]
            correctness += self.settings.discount**frame * (reward + spent)
            compute += self.settings.discount**frame * spent / weight
            if ended:
                self.ended += 1
                break
        total = sum(self.settings.discount**frame for frame in range(self.settings.horizon))
        return correctness / total, compute / total


@pytest.mark.parametrize("driver", ["policy", "subset"])
@pytest.mark.parametrize(
    ("lengths", "arguments"),
    [
        ((14, 40, 50), {"statistic": "evidence"}),
        ((14, 40, 50), {"statistic": "evidence", "reward": "ground_truth"}),
        ((12, 14, 16), {"statistic": "mean"}),  # all end within the horizon
        ((14, 40, 50), {"statistic": "belief"}),
    ],
)
def test_a_rollout_is_what_single_environments_give(lengths, arguments, driver):
    settings = RolloutConfig(hold=3, horizon=14, discount=0.9)
    routes = [random_bank(n, techniques=n, queries=q) for n, q in enumerate(lengths, 2)]
    weights = np.array([0.2, 1.0, 4.0])
    env = TechniqueSelectionVectorEnv(
        3, Banks(routes, aligned=False), slots=4, autoreset_mode="SameStep", **arguments
    )
    env.reset(seed=0, options={"bank": np.arange(3), "compute_weight": weights})
    before = random_actions(4, 9, (3, 4), reselect=0.5)
    for actions in before:
        info = env.step(actions)[4]
    rng = np.random.default_rng(0)
    subsets = np.stack([draw_subsets(p, p, 6, rng) for p in info["present"]])
    policy = changeable(arguments["statistic"]) if driver == "policy" else None
    shown = [array.tobytes() for array in env.task.episodes.look()]
    correctness, compute = roll_out(env.task, subsets, policy, settings)
    assert [array.tobytes() for array in env.task.episodes.look()] == shown
    assert correctness.shape == compute.shape == (3, 6)
    assert correctness.dtype == compute.dtype == np.float32
    by_hand = ByHand(policy, settings)
    for i, b in np.ndindex(3, 6):
        own = by_hand(routes[i], before[:, i], subsets[i, b], float(weights[i]), **arguments)
        assert (correctness[i, b], compute[i, b]) == pytest.approx(own, rel=1e-5)
    assert by_hand.ended == 6 * sum(length < 9 + 14 for length in lengths)
    assert len(set(by_hand.ran)) > 5
    assert np.ptp(compute) > 0.1


def test_a_policy_may_go_on_at_once_and_not_before_it_sees_a_frame():
    env = driven(STATISTIC)
    rng = np.random.default_rng(0)
    subsets = np.stack(
        [draw_subsets(p, p, 5, rng) for p in env.task.episodes.look().slots["present"]]
    )
    asked = []

    class Asked(SubsetSelector):
        def act(self, observation, info):
            asked.append(len(observation))
            return super().act(observation, info)

    policy = Asked(changeable().network, STATISTIC)
    for hold, times in ((1, 4), (3, 3), (7, 1), (8, 0), (20, 0)):
        asked.clear()
        roll_out(env.task, subsets, policy, RolloutConfig(hold=hold, horizon=8))
        assert asked == [15] * times


# ---- learning ------------------------------------------------------------------------------


def made_up(rng: np.random.Generator, states: int = 1000) -> tuple[Samples, np.ndarray]:
    """One of three techniques is right, as a feature tells; every run costs a third.

    Returns:
        The samples and (n,) which technique it is.
    """
    groups = rng.uniform(-1, 1, (states, 3, WIDTH)).astype(np.float32)
    groups[..., PRESENT] = 1.0
    good = rng.integers(3, size=states)
    groups[..., CONFIRMS] = np.where(np.arange(3) == good[:, None], 1.0, -1.0)
    route = rng.uniform(-1, 1, (states, ROUTE_WIDTH)).astype(np.float32)
    observations = np.concatenate([groups.reshape(states, -1), route], axis=1)
    numbers = np.stack([1 + rng.permutation(7)[:6] for _ in range(states)])
    subsets = members(3).numpy()[numbers]  # (n, B, 3)
    right = np.take_along_axis(subsets, good[:, None, None], 2)[..., 0]
    correctness = np.where(right, 0.9, 0.1).astype(np.float32)
    return Samples(
        observations, numbers, correctness, (subsets.sum(2) / 3).astype(np.float32)
    ), good


FIT = RolloutConfig(epochs=30, batch_size=100, learning_rate=4e-3)


def fitted(
    samples: list[Samples], settings: RolloutConfig = FIT, level: float = 0.0
) -> tuple[SubsetNetwork, float]:
    """The network, which begins with values that much higher, and the loss."""
    torch.manual_seed(0)
    network = SubsetNetwork(SubsetSizes(ensemble=2))
    with torch.no_grad():
        for values in network.ensemble:
            values.value.bias.add_(level)
    return network, learn(network, samples, settings, np.random.default_rng(0))


def test_values_are_recovered_and_the_right_technique_runs_alone():
    samples, _ = made_up(np.random.default_rng(0))
    network, loss = fitted([samples])
    unseen, good = made_up(np.random.default_rng(1))
    actions = SubsetSelector(network, STATISTIC).act(unseen.observations, {})
    alone = (actions == (np.arange(3) == good[:, None])).all(1)
    weights = compute_weight(torch.from_numpy(unseen.observations)).numpy()
    assert actions[np.arange(len(good)), good].mean() > 0.98
    assert alone[(weights > 0.5) & (weights < 5.0)].mean() > 0.98
    with torch.no_grad():
        values = network.values(torch.from_numpy(unseen.observations)).mean(0).numpy()
    for k, wanted in enumerate((unseen.correctness, unseen.compute)):
        found = np.take_along_axis(values[..., k], unseen.subsets, 1)
        error = (found - found.mean(1, keepdims=True)) - (wanted - wanted.mean(1, keepdims=True))
        assert np.abs(error).mean() < 0.06
    assert loss < 1.0


def test_all_that_was_seen_is_learned_from_and_in_the_same_way_again():
    rng = np.random.default_rng(2)
    parts = [made_up(rng, 60)[0] for _ in range(2)]
    joined = Samples(*(np.concatenate(column) for column in zip(*parts, strict=True)))
    short = RolloutConfig(epochs=2, batch_size=20)
    both, whole, one = (fitted(seen, short)[0] for seen in (parts, [joined], parts[:1]))
    for name, tensor in whole.state_dict().items():
        assert torch.equal(tensor, both.state_dict()[name])
    assert not torch.equal(whole.ensemble[0].value.weight, one.ensemble[0].value.weight)


def test_only_differences_within_a_state_count():
    samples, _ = made_up(np.random.default_rng(3), 60)
    levels = np.random.default_rng(4).integers(-2, 3, (60, 1)).astype(np.float32)
    lifted = samples._replace(correctness=samples.correctness + levels)
    short = RolloutConfig(epochs=2, batch_size=20)
    (first, loss), (second, other) = fitted([samples], short), fitted([lifted], short)
    assert loss == pytest.approx(other, rel=1e-4)
    torch.testing.assert_close(
        first.ensemble[0].value.weight, second.ensemble[0].value.weight, rtol=1e-3, atol=1e-4
    )
    third, other = fitted([samples], short, level=3.0)
    assert loss == pytest.approx(other, rel=1e-4)
    torch.testing.assert_close(
        first.ensemble[0].value.weight, third.ensemble[0].value.weight, rtol=1e-3, atol=1e-4
    )


# ---- the iterations ------------------------------------------------------------------------


def test_the_technique_that_is_always_right_is_found(tmp_path):
    """It is dear, and beside those that never are it pays less than alone."""
    scores = np.random.default_rng(0).normal(size=(3, 40, 60))
    scores[1] = np.eye(40, 60) * 30.0
    bank, weight = (
        ScoreBank(
            scores,
            ["A", "B", "C"],
            [1.0, 2.0, 1.0],
            tolerance=1,
            ground_truth=np.arange(scores.shape[1]),
        ),
        0.5,
    )
    tried = {"iterations": 2, "states": 320, "subsets": 7, "hold": 6, "horizon": 12}
    config = small_rollouts(
        n_envs=16,
        compute_weights=(weight, weight),
        rollouts={**tried, "epochs": 20, "batch_size": 32, "learning_rate": 4e-3},
    )
    selector = train(tmp_path, config, banks=[bank], progress=False)
    ran = rollout(selector, bank, name="x", compute_weight=weight).ran[5:]
    assert ran[:, 1].mean() > 0.9
    assert ran[:, [0, 2]].mean() < 0.1


@pytest.fixture(scope="module")
def whole(tmp_path_factory, quick) -> Path:
    """A training that was not stopped, beside its banks."""
    folder = tmp_path_factory.mktemp("whole")
    folders = [bank.save(folder / bank.name) for bank in banks()]
    train(folder / "run", small_rollouts(), banks=folders, progress=False)
    return folder / "run"


def test_the_run_folder_tells_how_it_went(whole):
    assert {p.name for p in whole.iterdir()} == {CONFIG, SELECTOR, CHECKPOINT, EVALUATIONS}
    rows = (whole / EVALUATIONS).read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["8", "16", "24", "32"]
    assert stored_config(whole) == small_rollouts()
    assert [Path(bank).name for bank in stored_banks(whole)] == ["bank2", "bank3", "bank4"]
    seen = {name for name in load_file(whole / CHECKPOINT) if name.startswith("seen.")}
    assert seen == {f"seen.{i}.{name}" for i in range(2) for name in Samples._fields}
    assert len(load_file(whole / CHECKPOINT)["seen.0.subsets"]) == 8


def test_the_last_iterations_are_learned_from_but_the_first_only_at_first(
    whole, tmp_path, monkeypatch
):
    """Without a policy a subset runs to the end of its rollout: those values are others."""
    learned: list[list[bytes]] = []
    weights: list[set[float]] = []

    def noting(network, seen, settings, rng):
        learned.append([samples.correctness.tobytes() for samples in seen])
        weights.append(set(compute_weight(torch.from_numpy(seen[-1].observations)).tolist()))
        return learn(network, seen, settings, rng)

    monkeypatch.setattr(policy_iteration, "learn", noting)
    train(tmp_path, small_rollouts(), banks=stored_banks(whole), progress=False)
    first, second, third, fourth = learned
    assert [len(seen) for seen in learned] == [1, 1, 2, 2]
    assert first != second
    assert third[0] == second[0]
    assert fourth[0] == third[1]
    assert len(set.union(*weights)) == sum(map(len, weights))  # each drives on routes of its own


def test_the_selector_loads_and_drives_any_techniques(whole):
    selector = load_selector(whole)
    assert isinstance(selector, SubsetSelector)
    assert (selector.needs.statistic, selector.needs.carry) == (STATISTIC, True)
    trace = rollout(selector, random_bank(3, techniques=5), name="x", compute_weight=0.3)
    assert trace.ran.shape == (40, 5)
    assert trace.ran.any(1).all()


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(whole, tmp_path):
    folders = stored_banks(whole)
    for seed in (0, 1):
        config = small_rollouts(seed=seed)
        train(tmp_path / str(seed), config, banks=folders, progress=False)
    assert contents(tmp_path / "0") == contents(whole)
    assert (tmp_path / "1" / SELECTOR).read_bytes() != (whole / SELECTOR).read_bytes()


def test_processes_change_nothing_in_what_is_learned(whole, tmp_path):
    tried = {"iterations": 1, "states": policy_iteration.PART + 1, "horizon": 3, "every": 1}
    found = []
    for threads in (1, 2):
        config = small_rollouts(n_envs=100, threads=threads, rollouts={**tried, "epochs": 1})
        run = tmp_path / str(threads)
        train(run, config, banks=stored_banks(whole), progress=False)
        found.append(contents(run))
        del found[-1][CONFIG]  # which says how many there were
    assert found[0] == found[1]


@pytest.mark.parametrize(
    ("owner", "name", "call", "finished"),
    [
        (policy_iteration, "roll_out", 1, 0),
        (policy_iteration, "learn", 1, 0),
        (policy_iteration, "learn", 2, 1),
        (policy_iteration, "learn", 4, 3),
        (Quick, "evaluate", 3, 2),
        (records, "write_tensors", 2, 1),  # the second iteration's checkpoint
    ],
)
def test_a_stopped_training_keeps_what_is_finished_and_goes_on_to_the_same_bits(
    whole, tmp_path, monkeypatch, owner, name, call, finished
):
    run = tmp_path / "run"
    with monkeypatch.context() as patch:
        stop_at(patch, owner, name, call)
        with pytest.raises(KeyboardInterrupt):
            train(run, small_rollouts(), banks=stored_banks(whole), progress=False)
    assert len((run / EVALUATIONS).read_text().splitlines()) == 1 + finished
    assert (run / SELECTOR).exists() == (finished > 0)
    if finished:
        assert rollout(load_selector(run), random_bank(3), name="x").ran.any()
        with pytest.raises(ValueError, match="holds a training already"):
            train(run, small_rollouts(), banks=stored_banks(whole), progress=False)
    train(run, small_rollouts(seed=9), resume=True, progress=False)
    assert contents(run) == contents(whole)
    train(run, small_rollouts(), resume=True, progress=False)  # finished
    assert contents(run) == contents(whole)


def test_there_must_be_something_to_resume(tmp_path):
    with pytest.raises(FileNotFoundError):
        train(tmp_path, small_rollouts(), resume=True, progress=False)


def copied(run: Path, to: Path) -> tuple[Path, dict[str, torch.Tensor], dict[str, str]]:
    """A copy of a run, its tensors and what else its checkpoint says."""
    to.mkdir()
    for path in run.iterdir():
        (to / path.name).write_bytes(path.read_bytes())
    tensors, metadata = read_tensors(to / CHECKPOINT)
    return to, tensors, metadata


@pytest.mark.parametrize(
    "damage", ["garbage", "cut", "layer", "nan", "seen", "shorter", "no count", "rows"]
)
def test_damaged_checkpoints_are_refused(whole, tmp_path, damage):
    run, tensors, metadata = copied(whole, tmp_path / "run")
    path = run / CHECKPOINT
    if damage == "layer":
        tensors["network.ensemble.0.value.bias"] = torch.zeros(3)
    elif damage == "nan":
        tensors["network.ensemble.0.value.bias"][0] = torch.nan
    elif damage == "seen":
        del tensors["seen.1.subsets"]
    elif damage == "shorter":
        tensors["seen.1.compute"] = tensors["seen.1.compute"][:5]
    elif damage == "no count":
        metadata["done"] = "many"
    elif damage == "rows":
        metadata["evaluations"] = json.dumps([[1, 2]])
    write_tensors(path, tensors, metadata)
    if damage == "garbage":
        path.write_bytes(b"\x80\x04garbage")
    elif damage == "cut":
        path.write_bytes(path.read_bytes()[:-100])
    before = {file.name: file.read_bytes() for file in run.iterdir()}
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors.*train"):
        train(run, small_rollouts(), resume=True, progress=False)
    assert {file.name: file.read_bytes() for file in run.iterdir()} == before


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"iterations": 0}, "iterations is 0; give a whole number >= 1"),
        ({"states": 1.5}, "states is 1.5; give a whole number >= 1"),
        ({"subsets": 3}, "subsets is 3; give a whole number >= 4"),
        ({"batch_size": 1}, "batch_size is 1; give a whole number >= 2"),
        ({"share": 1.5}, r"share is 1.5; give a number in \[0, 1\]"),
        ({"discount": -0.1}, r"discount is -0.1; give a number in \[0, 1\]"),
    ],
)
def test_bad_settings_are_refused(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        RolloutConfig(**changes)


def test_routes_of_more_techniques_than_can_be_tried_are_refused(tmp_path):
    routes = Banks([random_bank(1, techniques=11, queries=9)])
    with pytest.raises(ValueError, match="11 techniques.*at most 10"):
        train(tmp_path / "run", small_rollouts(), source=routes, progress=False)


def test_a_selector_may_idle_where_it_learned_to(tmp_path):
    config = small_rollouts(allow_idle=True, compute_weights=(4.0, 4.0))
    selector = train(tmp_path / "run", config, progress=False)
    assert selector.needs.allow_idle
    assert load_selector(tmp_path / "run").needs.allow_idle
    present = torch.ones(1, 3, dtype=torch.bool)
    assert valid(present, idle=True)[0, 0]
    assert not valid(present)[0, 0]


def test_the_empty_subset_is_tried_where_idling_is_allowed():
    present = np.array([True, True, False])
    for seed in range(5):
        rng = np.random.default_rng(seed)
        tried = draw_subsets(present, present, 6, rng, idle=True)
        assert not tried[-1].any()
        assert not tried[:, 2].any()
        assert draw_subsets(present, present, 6, rng).any(axis=1).all()


def test_other_algorithms_learn_no_idling():
    with pytest.raises(ValueError, match="'ppo' learns no selector that may idle.*'rollouts'"):
        TrainingConfig(allow_idle=True)


def test_callbacks_of_stable_baselines3_are_refused(tmp_path):
    with pytest.raises(ValueError, match="'rollouts' takes no callbacks of Stable-Baselines3"):
        train(
            tmp_path / "run",
            small_rollouts(),
            callbacks=[CheckpointCallback(1, "x")],
            progress=False,
        )
    assert not (tmp_path / "run").exists()


# ---- the command ---------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch, amusic):
    """Runs train.py with small settings; its exit status and the lines on stderr."""
    defaults = {**SMALL, "rollouts": RolloutConfig(**TRIED)}
    monkeypatch.setattr(
        "amusic_agents.config.TrainingConfig", lambda **v: TrainingConfig(**defaults | v)
    )

    def call(*arguments: object) -> tuple[int, list[str]]:
        status, _, err = amusic("train", *arguments)
        lines = err.strip().splitlines()
        return status, [line for line in lines if "rollouts:" not in line]

    return call


def test_the_command_trains_stops_and_goes_on(tmp_path, command, monkeypatch):
    folder, run = random_bank(1).save(tmp_path / "bank"), tmp_path / "run"
    options = ("--algorithm", "rollouts", "--bank", folder, "--iterations", 2, "--states", 12)
    with monkeypatch.context() as patch:
        stop_at(patch, policy_iteration, "learn", 2)
        assert command("--out", run, *options)[0] == 130
    assert rollout(load_selector(run), random_bank(1), name="x").ran.any()
    status, lines = command("--out", run, "--resume", "--states", 16)
    assert (status, len(lines)) == (2, 1)
    assert "states is 16, but" in lines[0]
    assert command("--out", run, "--resume", "--states", 12) == (0, [])
    assert command("--out", tmp_path / "again", *options) == (0, [])
    assert contents(run) == contents(tmp_path / "again")
    config = stored_config(run)
    assert (config.rollouts.iterations, config.rollouts.states, config.rollouts.hold) == (2, 12, 2)
    rows = (run / EVALUATIONS).read_text().splitlines()[1:]
    assert [row.split(",")[0] for row in rows] == ["12", "24"]


def test_the_command_trains_on_simulated_routes_too(tmp_path, command):
    options = ("--algorithm", "rollouts", "--iterations", 1, "--statistic", "belief")
    assert command("--out", tmp_path / "run", *options) == (0, [])
    assert load_selector(tmp_path / "run").needs.statistic == "belief"


def test_settings_of_rollouts_are_refused_with_other_algorithms(tmp_path, command):
    for option in ("--iterations", "--states"):
        status, lines = command("--out", tmp_path / "run", option, 3)
        assert (status, len(lines)) == (2, 1)
        assert f"{option} is of the algorithm rollouts" in lines[0]
    status, lines = command("--out", tmp_path / "run", "--algorithm", "rollouts", "--states", 0)
    assert (status, len(lines)) == (2, 1)
    assert "states is 0; give a whole number >= 1" in lines[0]
    assert not (tmp_path / "run").exists()
