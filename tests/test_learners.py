"""The registry of learners, the selector that rates subsets, and when to select again."""

from __future__ import annotations

import json
import shutil
import zipfile
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
import torch
from amusic_agents import subsets
from amusic_agents.config import ALGORITHMS, TrainingConfig, training_config
from amusic_agents.network import PRESENT, ROUTE_WIDTH, WIDTH
from amusic_agents.ppo import ReselectLearner
from amusic_agents.reselect import (
    FIRST_LOGIT,
    HeldSelection,
    ReselectNetwork,
    ReselectSelector,
    ReselectSizes,
)
from amusic_agents.run_folder import CHECKPOINT, SELECTOR, read_tensors
from amusic_agents.selector import KINDS, load_selector
from amusic_agents.subsets import SubsetNetwork, SubsetSelector, SubsetSizes
from amusic_agents.training import train
from env_cases import random_bank
from safetensors.torch import load_file, save_file
from small_training import SMALL, Quick

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.observation import ROUTE_FEATURES, TECHNIQUE_FEATURES
from amusic_gym.envs.sources import Banks
from amusic_gym.estimation.settings import BLOCK, SICSettings
from amusic_gym.evaluation.rollout import Job, rollout, rollouts

pytestmark = pytest.mark.slow

STATISTIC = SICSettings.statistic


def small(**changes) -> TrainingConfig:
    return training_config("reselect", **{**SMALL, "timesteps": 96, **changes})


@pytest.fixture(autouse=True, scope="module")
def quick():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("amusic_agents.records.HeldOut", Quick)
        yield


def mixed_banks() -> list[ScoreBank]:
    """Banks of two, three and four techniques."""
    return [random_bank(n, techniques=n, queries=15 + n) for n in (2, 3, 4)]


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A small run on ensembles of different size."""
    folder = tmp_path_factory.mktemp("run")
    train(folder, small(), banks=mixed_banks(), progress=False)
    return folder


def observations(rng: np.random.Generator, batch: int, slots: int, absent: int = 0) -> torch.Tensor:
    """(B, D) random observations whose last slots are empty."""
    groups = rng.uniform(-1, 1, (batch, slots, WIDTH)).astype(np.float32)
    groups[..., PRESENT] = 1.0
    groups[:, slots - absent :] = 0.0
    route = rng.uniform(-1, 1, (batch, ROUTE_WIDTH)).astype(np.float32)
    return torch.from_numpy(np.concatenate([groups.reshape(batch, -1), route], axis=1))


def permuted(observation: torch.Tensor, order: list[int]) -> torch.Tensor:
    """The same observations with the techniques in another order."""
    groups = observation[:, :-ROUTE_WIDTH].unflatten(1, (-1, WIDTH))[:, order]
    return torch.cat([groups.flatten(1), observation[:, -ROUTE_WIDTH:]], dim=1)


# ---- what is trained -----------------------------------------------------------------------


def test_a_run_folder_holds_the_trained_network_and_no_pickle(run):
    for file in run.iterdir():
        assert file.suffix in (".json", ".safetensors", ".csv") or "tfevents" in file.name
        assert not zipfile.is_zipfile(file)
    config = json.loads((run / "config.json").read_text())
    assert config["training"]["algorithm"] == "reselect"
    weights, metadata = read_tensors(run / SELECTOR)
    checkpoint, _ = read_tensors(run / CHECKPOINT)
    assert json.loads(metadata["network"])["kind"] == "reselect"
    for name, tensor in load_selector(run).network.state_dict().items():
        assert torch.equal(tensor, weights[name])
        assert sum(key.endswith(name) for key in checkpoint) >= 1


def test_a_selector_drives_ensembles_of_any_size_in_any_company(run):
    """Alone or beside other routes, a route goes the same way."""
    jobs = [Job(bank, weight) for bank in mixed_banks() for weight in (0.1, 3.0)]
    jobs.append(Job(random_bank(9, techniques=6, queries=30), 0.5))
    together = rollouts(load_selector(run), jobs, name="x")
    for job, trace in zip(jobs, together, strict=True):
        assert trace.ran.any(axis=1).all()
        assert trace.statistic == STATISTIC
        selector = load_selector(run)
        alone = rollout(selector, job.bank, name="x", compute_weight=job.compute_weight)
        np.testing.assert_array_equal(alone.runs, trace.runs)
        np.testing.assert_array_equal(alone.predictions, trace.predictions)


def test_a_run_is_resumed(run, tmp_path):
    again = Path(shutil.copytree(run, tmp_path / "run"))
    before = load_file(again / CHECKPOINT)
    train(again, small(timesteps=160), banks=mixed_banks(), resume=True, progress=False)
    after, metadata = read_tensors(again / CHECKPOINT)
    assert int(metadata["timesteps"]) == 160
    assert after.keys() == before.keys()
    assert any(not torch.equal(after[name], before[name]) for name in before)


def test_the_same_seed_gives_the_same_weights(run, tmp_path):
    train(tmp_path, small(), banks=mixed_banks(), progress=False)
    first, second = load_file(run / CHECKPOINT), load_file(tmp_path / CHECKPOINT)
    assert [name for name in first if not torch.equal(first[name], second[name])] == []
    assert (run / SELECTOR).read_bytes() == (tmp_path / SELECTOR).read_bytes()


def test_unknown_algorithms_and_kinds_are_refused_with_the_nearest(run, tmp_path):
    with pytest.raises(ValueError, match="algorithm 'reselct'.*'reselect'"):
        TrainingConfig(algorithm="reselct")
    with pytest.raises(ValueError, match="algorithm 'pqo'.*'ppo'"):
        training_config("pqo")
    again = Path(shutil.copytree(run, tmp_path / "run"))
    tensors, _ = read_tensors(again / SELECTOR)
    save_file(tensors, again / SELECTOR, {"network": json.dumps({"kind": "subset"})})
    with pytest.raises(ValueError, match="kind of selector 'subset'.*'subsets'"):
        load_selector(again)


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_every_algorithm_has_defaults_and_trains_a_kind_that_loads(algorithm):
    assert training_config(algorithm, seed=3).algorithm == algorithm
    assert resolve_name(ALGORITHMS[algorithm]).kind in KINDS.values()


@pytest.mark.parametrize("name", KINDS)
def test_every_kind_is_stored_under_its_name_and_refuses_sizes(name):
    kind = KINDS[name]
    assert kind.kind == name
    network = kind.network_type(kind.sizes_type(hidden=8))
    assert isinstance(kind(network, STATISTIC, None).needs.statistic, str)
    with pytest.raises(ValueError, match="hidden is 0; give a whole number from 1 to"):
        kind.sizes_type(hidden=0)


# ---- subsets -------------------------------------------------------------------------------


def bits(*rows: str) -> np.ndarray:
    return np.array([[digit == "1" for digit in row] for row in rows])


def test_subsets_are_numbered_by_their_bits():
    wanted = bits("000", "100", "010", "110", "001", "101", "011", "111")
    np.testing.assert_array_equal(subsets.members(3).numpy(), wanted)


def test_subsets_with_absent_members_and_the_empty_one_are_not_valid():
    present = torch.from_numpy(bits("111", "101", "010"))
    wanted = bits("01111111", "01001100", "00100000")
    np.testing.assert_array_equal(subsets.valid(present).numpy(), wanted)


def test_of_many_techniques_subsets_of_at_most_two_are_rated():
    rated = subsets.members(11).numpy()
    assert not rated[0].any()
    assert sorted(rated.sum(axis=1)) == [0, *[1] * 11, *[2] * 55]
    assert len(np.unique(rated, axis=0)) == len(rated)
    trace = rollout(
        SubsetSelector(subset_network(), STATISTIC),
        random_bank(1, techniques=11, queries=5),
        name="many",
    )
    assert set(trace.ran.sum(axis=1)) <= {1, 2}


def subset_network() -> SubsetNetwork:
    torch.manual_seed(1)
    network = SubsetNetwork(SubsetSizes(hidden=16, encoding=8, ensemble=2))
    with torch.no_grad():  # ratings that differ, as they do after training
        for values in network.ensemble:
            values.member.weight.mul_(10.0)
            values.value.weight.mul_(10.0)
    return network


@torch.no_grad()
def test_ratings_are_the_means_over_the_ensemble_less_the_price_of_the_compute():
    network, seen = subset_network(), observations(np.random.default_rng(0), 4, 3)
    first, second = (values(seen) for values in network.ensemble)
    assert (first - second).abs().min() > 0.0
    correctness, compute = ((first + second) / 2.0).unbind(2)
    wanted = correctness - subsets.compute_weight(seen).unsqueeze(1) * compute
    torch.testing.assert_close(network(seen), wanted)


@torch.no_grad()
def test_permuting_the_techniques_permutes_the_subsets():
    network, seen = subset_network(), observations(np.random.default_rng(0), 4, 3)
    order = [2, 0, 1]
    member = subsets.members(3).numpy()
    same = [int(np.flatnonzero((member[:, order] == row).all(1))[0]) for row in member]
    ratings = network(seen)
    moved = network(permuted(seen, order))
    torch.testing.assert_close(moved, ratings[:, same], rtol=1e-4, atol=1e-4)
    assert ratings.std(dim=1).min() > 0.1


@torch.no_grad()
def test_absent_members_change_no_rating():
    network, seen = subset_network(), observations(np.random.default_rng(0), 4, 3)
    groups, route = seen[:, :-ROUTE_WIDTH], seen[:, -ROUTE_WIDTH:]
    wider = torch.cat([groups, torch.zeros(4, WIDTH), route], dim=1)
    ratings = network(wider)
    for half in (ratings[:, :8], ratings[:, 8:]):
        torch.testing.assert_close(half, network(seen), rtol=1e-4, atol=1e-4)


def test_the_selector_runs_the_valid_subset_of_the_highest_rating():
    seen = observations(np.random.default_rng(3), 50, 3, absent=1)
    network = subset_network()
    runs = SubsetSelector(network, STATISTIC).act(seen.numpy(), {})
    with torch.no_grad():
        best = network(seen)[:, 1:4].argmax(1).numpy() + 1
    np.testing.assert_array_equal(runs, subsets.members(3).numpy()[best])
    assert len(set(best)) > 1


# ---- when to select again ------------------------------------------------------------------


def reselect_selector(logit: float, block: int = BLOCK) -> ReselectSelector:
    """One that wants to select again at a constant rate."""
    network = ReselectNetwork(ReselectSizes(block=block))
    with torch.no_grad():
        network.last.weight.zero_()
        network.last.bias.fill_(logit)
    return ReselectSelector(network, STATISTIC)


def test_all_run_until_the_first_selection_and_the_selected_ones_from_there(bank):
    trace = rollout(reselect_selector(-50.0, block=7), bank, name="once")
    assert np.flatnonzero(trace.selections).tolist() == [7]
    assert trace.ran[:7].all()
    assert (trace.ran[7:] == trace.ran[7]).all()
    assert not trace.ran[7].all()


def test_a_route_that_begins_runs_all_again():
    held = HeldSelection(block=2)
    present = np.array([[True, True, True], [True, True, False]])
    nothing = {"happened": np.zeros(2, np.bool_), "selected": np.zeros((2, 3), np.bool_)}
    chosen = {"happened": np.ones(2, np.bool_), "selected": bits("010", "100")}

    def actions(frames: list[int], selection: dict) -> list[list[int]]:
        held.note({"present": present, "selection": selection, "frame": np.array(frames)})
        return held.actions(np.ones(2, np.bool_)).astype(int).tolist()

    assert actions([-1, -1], nothing) == [[1, 1, 1, 0], [1, 1, 0, 0]]
    assert actions([0, 0], nothing) == [[1, 1, 1, 0], [1, 1, 0, 0]]
    assert actions([1, 1], nothing) == [[1, 1, 1, 1], [1, 1, 0, 1]]
    assert actions([2, 2], chosen) == [[0, 1, 0, 1], [1, 0, 0, 1]]
    assert actions([3, -1], nothing) == [[0, 1, 0, 1], [1, 1, 0, 0]]


def test_the_bit_selects_again(bank):
    trace = rollout(reselect_selector(50.0, block=7), bank, name="always")
    assert np.flatnonzero(trace.selections).tolist() == list(range(7, 40))


@pytest.mark.parametrize("rate", [0.05, 0.3])
def test_the_learned_rate_is_kept(rate):
    bank = random_bank(2, queries=210, references=210)
    trace = rollout(reselect_selector(float(np.log(rate / (1 - rate)))), bank, name="sometimes")
    assert trace.selections[BLOCK + 1 :].mean() == pytest.approx(rate, abs=0.02)


def test_training_and_driving_hold_the_same_selection():
    """What the environment of the training runs is what the selector asks for."""
    model = ReselectLearner.make_model(small(), Banks([random_bank(1), random_bank(2, queries=25)]))
    selector = reselect_selector(0.0)
    env = model.env.env
    seen, info = env.reset(seed=0)
    for _ in range(60):
        actions = selector.act(seen, info)
        seen, _, terminated, truncated, info = env.step(actions[:, -1])
        going = ~(terminated | truncated) & ~info["selection"]["happened"]
        np.testing.assert_array_equal(info["ran"][going], actions[going, :-1])
    assert env.single_action_space.n == 2


def test_selecting_again_is_rare_at_first():
    torch.manual_seed(0)
    network = ReselectNetwork(ReselectSizes())
    logits = network.logits(observations(np.random.default_rng(0), 20, 3))
    assert (logits - FIRST_LOGIT).abs().max() < 0.2


def test_the_layout_is_the_observation_s():
    assert (WIDTH, ROUTE_WIDTH) == (len(TECHNIQUE_FEATURES), len(ROUTE_FEATURES))
