"""Learning from a teacher, and PPO that goes on from there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from amusic_agents import imitation, records
from amusic_agents.config import ImitationConfig, NetworkConfig, TrainingConfig
from amusic_agents.evaluation import Evaluation
from amusic_agents.imitation import ImitationLearner, cross_entropy
from amusic_agents.network import PRESENT, ROUTE_WIDTH, WIDTH, SelectorNetwork
from amusic_agents.records import Records
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
from amusic_agents.selector import TrainedSelector, load_selector
from amusic_agents.teachers import ByWeight, partition
from amusic_agents.training import IMITATION, train, training_source
from amusic_baselines.amusic import AMuSIC
from amusic_baselines.cascade import Cascade
from env_cases import random_bank
from safetensors.torch import load_file
from small_training import SMALL, Quick, contents, small, stop_at

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.cli import teacher as teachers
from amusic_gym.envs.sources import Banks
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.metrics import compute
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.policies.protocol import Needs

pytestmark = pytest.mark.slow

STATISTIC = SICSettings.statistic
WEIGHTS = (0.1, 1.0)


@pytest.fixture(autouse=True, scope="module")
def quick():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("amusic_agents.records.HeldOut", Quick)
        yield


def banks(first: int = 0, number: int = 4) -> list[ScoreBank]:
    return [random_bank(first + i, techniques=2 + i % 3, queries=30) for i in range(number)]


def cautious(weight: float) -> Cascade:
    """A cascade that saves more the dearer compute is."""
    return Cascade(cheap=1, hold=8 if weight < 0.3 else 3, threshold=0.5)


def teacher() -> ByWeight:
    edges, middles = partition(WEIGHTS, 2)
    return ByWeight(edges, [cautious(middle) for middle in middles])


def imitate(out, config, taught_by, **arguments) -> TrainedSelector:
    return train(out, config, teacher=taught_by, **arguments)


# ---- a teacher for every λ -----------------------------------------------------------------


class Constant:
    """Always the same technique; remembers what it was shown."""

    def __init__(self, column: int, needs: Needs | None = None) -> None:
        self.column = column
        self.needs = needs or Needs()
        self.shown: list[np.ndarray] = []
        self.begun: list[np.ndarray] = []

    def reset(self, mask: np.ndarray) -> None:
        self.begun.append(mask.copy())

    def act(self, observation, info) -> np.ndarray:
        self.shown.append(observation.copy())
        actions = np.zeros(info["present"].shape, np.bool_)
        actions[:, self.column] = True
        return actions


def test_every_route_is_taught_by_the_teacher_of_its_weight():
    teachers = [Constant(column) for column in range(3)]
    joint = ByWeight([0.5, 2.0], teachers)
    weights = np.array([0.1, 0.49, 0.5, 1.9, 2.0, 9.0])
    info = {"compute_weight": weights, "present": np.ones((6, 3), np.bool_)}
    actions = joint.act(np.zeros((6, 5), np.float32), info)
    assert actions.argmax(axis=1).tolist() == [0, 0, 1, 1, 2, 2]
    joint.reset(np.array([True, False] * 3))
    for each in teachers:  # whoever does not drive must know what happened all the same
        assert each.shown[0].shape == (6, 5)
        assert each.begun[0].tolist() == [True, False] * 3


def test_a_range_is_cut_evenly_on_a_logarithmic_scale():
    edges, middles = partition((0.01, 100.0), 2)
    np.testing.assert_allclose(edges, [1.0])
    np.testing.assert_allclose(middles, [0.1, 10.0])
    assert partition((0.5, 0.5), 1) == ([], [0.5])


@pytest.mark.parametrize("edges", [[], [1.0, 1.0], [2.0, 1.0], [0.1, 0.2, 0.3]])
def test_edges_that_do_not_fit_are_refused(edges):
    with pytest.raises(ValueError, match="for 3 selectors; give one rising"):
        ByWeight(edges, [Constant(0)] * 3)


def test_teachers_of_different_needs_are_refused():
    with pytest.raises(ValueError, match="need different environments"):
        ByWeight([1.0], [Constant(0), Constant(0, Needs(statistic="mean"))])


# ---- DAgger --------------------------------------------------------------------------------


class Rising(Quick):
    """Every evaluation is better than the one before, so that the last round is kept."""

    def evaluate(self, selector, timesteps) -> Evaluation:
        return Evaluation(timesteps, float(timesteps), 0.5, 0.5, 0.5)


class Watched:
    """Drives as a student does, and notes where the teacher would have done the same."""

    def __init__(self, student) -> None:
        self.student, self.teacher, self.needs = student, teacher(), student.needs
        self.same: list[np.ndarray] = []

    def reset(self, mask) -> None:
        self.student.reset(mask)
        self.teacher.reset(mask)

    def act(self, observation, info) -> np.ndarray:
        actions = self.student.act(observation, info)
        label = np.asarray(self.teacher.act(observation, info)) == 1
        self.same.append((actions == label)[info["present"]])
        return actions


def agreement(student, jobs) -> float:
    """Share of the bits that the teacher would have set as its student did."""
    watched = Watched(student)
    rollouts(watched, jobs, name="student")
    return np.concatenate(watched.same).mean()


def test_a_teacher_is_imitated_on_routes_it_never_saw(tmp_path, monkeypatch):
    monkeypatch.setattr("amusic_agents.records.HeldOut", Rising)
    config = small(
        n_envs=16,
        compute_weights=WEIGHTS,
        imitation={"frames": 2_000, "epochs": 6, "batch_size": 128, "learning_rate": 4e-3},
        network=NetworkConfig(hidden=32, encoding=16),
    )
    learned = imitate(tmp_path / "run", config, teacher(), banks=banks(0, 24), progress=False)
    unseen = [Job(bank, weight) for bank in banks(900, 6) for weight in (0.15, 0.8)]
    untrained = TrainedSelector(SelectorNetwork(NetworkConfig()), STATISTIC)
    assert agreement(learned, unseen) > 0.95
    assert agreement(untrained, unseen) < 0.8
    costs = [
        compute(rollout(learned, j.bank, name="x", compute_weight=j.compute_weight)) for j in unseen
    ]
    assert np.mean(costs[::2]) > np.mean(costs[1::2]) + 0.03  # it reads λ


class Watching(Constant):
    """Says "all"; notes which techniques really ran, and when routes began."""

    def __init__(self) -> None:
        super().__init__(0)
        self.ran: list[np.ndarray] = []
        self.frames: list[np.ndarray] = []

    def act(self, observation, info) -> np.ndarray:
        super().act(observation, info)
        self.ran.append(info["ran"][info["frame"] >= 0])
        self.frames.append(info["frame"].copy())
        return info["present"].copy()


@pytest.mark.parametrize(("share", "runs"), [(0.0, 1.0), (1.0, 3.0)])
def test_who_drives_is_the_student_or_the_teacher(tmp_path, share, runs):
    """An untrained student that would run nothing falls back on the cheapest technique."""
    config = small(
        imitation={"rounds": 2, "epochs": 1, "learning_rate": 0.0, "teacher_share": share},
        network=NetworkConfig(first_logit=-5.0),
    )
    watching = Watching()
    imitate(tmp_path, config, watching, banks=[random_bank(1, queries=15)], progress=False)
    second = np.concatenate(watching.ran[20:])  # in the first round the teacher drives anyway
    assert (second.sum(axis=1) == runs).all()
    assert (np.concatenate(watching.ran[:20]).sum(axis=1) == 3).all()
    for begun, frames in zip(watching.begun, watching.frames, strict=True):
        np.testing.assert_array_equal(begun, frames == -1)


def learner(out: Path, config: TrainingConfig, taught_by) -> ImitationLearner:
    kept = Records(out, config, [], ImitationLearner.kind)
    return ImitationLearner(config, Banks(banks(), aligned=False), kept, taught_by)


def test_what_was_seen_and_said_is_what_is_learned_from(tmp_path):
    watching = Watching()
    config = small(imitation={"rounds": 2})
    made = learner(tmp_path, config, watching)
    made.run(progress=False)
    assert made.observations.shape == (160, made.env.single_observation_space.shape[0])
    np.testing.assert_array_equal(made.observations.numpy(), np.concatenate(watching.shown))
    present = made.observations[:, : 4 * WIDTH].unflatten(1, (4, WIDTH))[..., PRESENT] == 1.0
    assert torch.equal(made.labels, present)


def test_every_round_learns_again_from_all_that_was_seen(tmp_path, monkeypatch):
    made = learner(tmp_path, small(), teacher())
    sizes, sums, original = [], [], cross_entropy

    def counting(network, observations, labels):
        sizes.append(len(labels))
        sums.append(float(observations.sum()))
        return original(network, observations, labels)

    monkeypatch.setattr(imitation, "cross_entropy", counting)
    made.run(progress=False)
    assert len(sizes) == 2 * (2 + 3 + 4)  # two passes over 80, 160 and 240 frames, 64 at a time
    assert max(sizes) - min(sizes) <= 20
    assert sum(sizes) == 2 * (80 + 160 + 240)
    assert sum(sums[-4:]) == pytest.approx(float(made.observations.sum()), rel=1e-4)


def test_the_loss_is_the_mean_cross_entropy_of_present_bits():
    torch.manual_seed(0)
    network = SelectorNetwork(NetworkConfig(first_logit=0.3))
    seen = torch.rand(5, 3 * WIDTH + ROUTE_WIDTH)
    seen[:, PRESENT : 3 * WIDTH : WIDTH] = 1.0
    seen[2:, 2 * WIDTH : 3 * WIDTH] = 0.0  # an empty slot
    labels = torch.rand(5, 3) > 0.5
    logits = network.logits(seen).detach()
    losses = []
    for b in range(5):
        for s in range(3 if b < 2 else 2):
            p = 1.0 / (1.0 + np.exp(-float(logits[b, s])))
            losses.append(-np.log(p if labels[b, s] else 1.0 - p))
    loss = cross_entropy(network, seen, labels).detach()
    assert float(loss) == pytest.approx(np.mean(losses), rel=1e-5)


def test_the_run_folder_tells_how_it_went(whole):
    run = whole
    assert {p.name for p in run.iterdir()} == {
        *(CONFIG, SELECTOR, CHECKPOINT, EVALUATIONS, "imitation.csv")
    }
    rows = [line.split(",") for line in (run / "imitation.csv").read_text().splitlines()]
    assert rows[0] == ["round", "teacher_share", "agreement", "loss"]
    assert [(row[0], float(row[1])) for row in rows[1:]] == [("0", 1.0), ("1", 0.5), ("2", 0.25)]
    assert all(0.0 < float(row[2]) <= 1.0 and 0.0 < float(row[3]) < 1.0 for row in rows[1:])
    evaluations = (run / EVALUATIONS).read_text().splitlines()
    assert [line.split(",")[0] for line in evaluations[1:]] == ["80", "160", "240"]
    assert stored_config(run) == small()
    trace = rollout(load_selector(run), random_bank(3, techniques=5), name="i", compute_weight=0.3)
    assert trace.ran.shape == (40, 5)


@pytest.fixture(scope="module")
def whole(tmp_path_factory, quick) -> Path:
    """An imitation that was not stopped, beside its banks."""
    folder = tmp_path_factory.mktemp("whole")
    folders = [bank.save(folder / bank.name) for bank in banks()]
    imitate(folder / "run", small(), teacher(), banks=folders, progress=False)
    return folder / "run"


@pytest.mark.parametrize(
    ("owner", "name", "call"),
    [
        (ImitationLearner, "_drive", 1),
        (ImitationLearner, "_drive", 3),
        (imitation, "fit", 2),
        (Quick, "evaluate", 2),
        (records, "write_tensors", 1),  # the first round's checkpoint
        (records, "write_tensors", 2),
        (imitation, "write_table", 3),
    ],
)
def test_a_stopped_imitation_goes_on_to_the_same_bits(
    whole, tmp_path, monkeypatch, owner, name, call
):
    folders = stored_banks(whole)
    with monkeypatch.context() as patch:
        stop_at(patch, owner, name, call)
        with pytest.raises(KeyboardInterrupt):
            imitate(tmp_path / "run", small(), teacher(), banks=folders, progress=False)
    assert (tmp_path / "run" / CONFIG).exists()
    imitate(tmp_path / "run", small(seed=9), teacher(), resume=True, progress=False)
    assert contents(tmp_path / "run") == contents(whole)
    assert not [name for name in load_file(tmp_path / "run" / CHECKPOINT) if "seen." in name]
    imitate(tmp_path / "run", small(), teacher(), resume=True, progress=False)  # finished
    assert contents(tmp_path / "run") == contents(whole)


@pytest.mark.parametrize("damage", ["garbage", "missing", "shorter"])
def test_damaged_memories_are_refused(tmp_path, monkeypatch, damage):
    with monkeypatch.context() as patch:
        stop_at(patch, ImitationLearner, "_drive", 3)
        with pytest.raises(KeyboardInterrupt):
            imitate(tmp_path, small(), teacher(), banks=banks(), progress=False)
    file = tmp_path / CHECKPOINT
    tensors, metadata = read_tensors(file)
    if damage == "missing":
        del tensors["seen.labels"]
    elif damage == "shorter":
        tensors["seen.observations"] = tensors["seen.observations"][:5]
    write_tensors(file, tensors, metadata)
    if damage == "garbage":
        file.write_bytes(b"\x80\x04garbage")
    with pytest.raises(ValueError, match=r"checkpoint\.safetensors.*train"):
        imitate(tmp_path, small(), teacher(), banks=banks(), resume=True, progress=False)


def test_a_checkpoint_of_another_training_is_refused(tmp_path):
    imitate(tmp_path, small(), teacher(), banks=banks(), progress=False)
    tensors = load_file(tmp_path / CHECKPOINT)
    write_tensors(tmp_path / CHECKPOINT, tensors, {"evaluations": "[]", "rounds": "many"})
    with pytest.raises(ValueError, match="checkpoint.safetensors holds no whole checkpoint"):
        imitate(tmp_path, small(), teacher(), banks=banks(), resume=True, progress=False)


@pytest.mark.parametrize(
    ("asked", "sentence"),
    [
        (AMuSIC(STATISTIC), "needs more of the environment than a statistic"),
        (Constant(0, Needs(allow_idle=True)), "needs more of the environment than a statistic"),
        (Constant(0, Needs(statistic="mean")), "needs the statistic 'mean', the training uses"),
        (Constant(0, Needs(carry=False)), "needs carry False, the training uses True"),
        (Constant(0, Needs(discount=False)), "needs discount False, the training uses True"),
    ],
)
def test_a_teacher_of_another_environment_is_refused(tmp_path, asked, sentence):
    with pytest.raises(ValueError, match=sentence):
        imitate(tmp_path / "new", small(), asked, banks=banks(), progress=False)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"rounds": 0}, "rounds is 0; give a whole number >= 1"),
        ({"frames": 1.5}, "frames is 1.5; give"),
        ({"epochs": 0}, "epochs is 0; give"),
        ({"teacher_share": 1.5}, r"teacher_share is 1.5; give a number in \[0, 1\]"),
    ],
)
def test_bad_settings_are_refused(changes, sentence):
    with pytest.raises(ValueError, match=sentence):
        ImitationConfig(**changes)


# ---- PPO from there ------------------------------------------------------------------------


class Falling(Quick):
    """Every evaluation is worse than the one before."""

    def evaluate(self, selector, timesteps) -> Evaluation:
        return Evaluation(timesteps, -float(timesteps), 0.5, 0.5, 0.5)


def test_ppo_begins_with_the_imitation_s_weights_and_keeps_them_if_they_are_best(
    tmp_path, monkeypatch
):
    monkeypatch.setattr("amusic_agents.records.HeldOut", Falling)
    config = small("imitation+ppo", frozen_updates=0)
    best = imitate(tmp_path, config, teacher(), banks=banks(), progress=False)
    start = load_selector(tmp_path / IMITATION)
    for name, tensor in start.network.state_dict().items():
        assert torch.equal(best.network.state_dict()[name], tensor)
    evaluations = (tmp_path / EVALUATIONS).read_text().splitlines()[1:]
    assert [line.split(",")[0] for line in evaluations] == ["0", "64", "96"]
    assert moved(tmp_path) == (True, True)


def moved(run: Path) -> tuple[bool, bool]:
    """Whether, in the last checkpoint, the actor and the critic differ from the imitation's."""
    start = load_selector(run / IMITATION).network.state_dict()
    tensors, _ = read_tensors(run / CHECKPOINT)
    names = {
        name
        for name, tensor in start.items()
        if not torch.equal(tensors[f"policy.mlp_extractor.{name}"], tensor)
    }
    critic = {name for name in names if name.startswith("critic.")}
    return bool(names - critic), bool(critic)


def test_the_critic_learns_alone_at_first_also_after_a_resume(tmp_path):
    config = small("imitation+ppo", frozen_updates=3, timesteps=64)  # two updates
    imitate(tmp_path, config, teacher(), banks=banks(), progress=False)
    assert moved(tmp_path) == (False, True)
    for timesteps, actor in ((96, False), (160, True)):
        again = replace(config, timesteps=timesteps)
        train(tmp_path, again, banks=banks(), resume=True, progress=False)
        assert moved(tmp_path) == (actor, True)


def test_the_actor_is_what_the_logits_depend_on():
    network = SelectorNetwork(NetworkConfig())
    seen = torch.rand(2, 2 * WIDTH + ROUTE_WIDTH)
    seen[:, PRESENT : 2 * WIDTH : WIDTH] = 1.0
    network.logits(seen).sum().backward()
    for name, parameter in network.named_parameters():
        assert (parameter.grad is None) == name.startswith("critic."), name


def test_imitation_and_ppo_in_one_go_and_what_is_stored(tmp_path):
    config = small("imitation+ppo", frozen_updates=1)
    imitate(tmp_path, config, teacher(), banks=banks(), progress=False)
    assert stored_config(tmp_path) == config
    assert stored_config(tmp_path / IMITATION) == replace(config, algorithm="imitation")
    for run in (tmp_path, tmp_path / IMITATION):
        assert rollout(load_selector(run), random_bank(3), name="x").ran.any()
    with pytest.raises(ValueError, match="holds a training already"):
        imitate(tmp_path, config, teacher(), banks=banks(), progress=False)


def test_an_imitation_without_a_teacher_is_refused(tmp_path):
    with pytest.raises(ValueError, match="an imitation learns from a teacher; give one"):
        train(tmp_path / "new", small(), banks=banks(), progress=False)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("owner", "name", "call"),
    [(ImitationLearner, "_drive", 2), (Quick, "evaluate", 4), (Quick, "evaluate", 5)],
)
def test_imitation_and_ppo_resume_in_either_part(tmp_path, monkeypatch, owner, name, call):
    config = small("imitation+ppo", frozen_updates=1)
    folders = [bank.save(tmp_path / bank.name) for bank in banks()]
    with monkeypatch.context() as patch:
        stop_at(patch, owner, name, call)
        with pytest.raises(KeyboardInterrupt):
            imitate(tmp_path / "run", config, teacher(), banks=folders, progress=False)
    imitate(tmp_path / "run", config, teacher(), resume=True, progress=False)
    _, metadata = read_tensors(tmp_path / "run" / CHECKPOINT)
    assert int(metadata["timesteps"]) == 96
    evaluated = (tmp_path / "run" / EVALUATIONS).read_text().splitlines()[1:]
    steps = [line.split(",")[0] for line in evaluated]
    assert (steps[0], steps[-1]) == ("0", "96")


# ---- choosing the teacher ------------------------------------------------------------------


@pytest.fixture
def choosing():
    return teachers


def test_the_chosen_cascade_pays_most_by_true_correctness(choosing):
    routes = banks(40, 3)
    grid = [choosing.Parameters(*each) for each in [(1, 1, 0.0), (1, 5, 0.6), (99, 1, 0.0)]]
    weights = [0.0, 0.3, 50.0]
    chosen = choosing.choose_cascades(
        routes, weights, statistic=STATISTIC, grid=grid, progress=False
    )
    for weight, choice in zip(weights, chosen, strict=True):
        scores = []
        for p in grid:
            traces = [rollout(Cascade(p.cheap, p.hold, p.threshold), b, name="c") for b in routes]
            scores.append(np.mean([t.correct.mean() - weight * compute(t) for t in traces]))
        assert choice.parameters == grid[int(np.argmax(scores))]
        assert choice.score == pytest.approx(max(scores))
        assert choice.score == pytest.approx(choice.accuracy - weight * choice.compute)
    assert chosen[0].compute > chosen[-1].compute
    assert chosen[-1].parameters == grid[0]


def test_the_teacher_follows_the_choice_and_its_file_brings_it_back(
    choosing, tmp_path, monkeypatch
):
    both = (choosing.Parameters(1, 1, 0.0), choosing.Parameters(99, 1, 0.0))
    calls = []

    def choose(routes, weights, *, statistic, environment, grid, progress):
        assert (len(routes), grid) == (1, both)
        assert (statistic, environment) == (STATISTIC, {"carry": True, "discount": True})
        calls.append(weights)
        reached = (0.5, 0.5, 0.5)
        return [choosing.Choice(w, both[w < 0.3], *reached) for w in weights]

    monkeypatch.setattr(choosing, "choose_cascades", choose)
    config = small(compute_weights=(0.1, 1.0))
    made = choosing.make_teacher(tmp_path, config, routes=1, grid=both)
    again = choosing.make_teacher(tmp_path, config, resume=True)
    assert len(calls) == 1
    assert len(calls[0]) == choosing.PARTS
    info = {
        "compute_weight": np.array([0.11, 0.95]),
        "present": np.ones((2, 3), np.bool_),
        "run_seconds": np.array([[1.0, 2.0, 3.0]] * 2),
        "p_correct": np.ones(2),
        "frame": np.zeros(2, np.int64),
    }
    for each in (made, again):
        each.reset(np.ones(2, np.bool_))
        actions = each.act(np.zeros((2, 1), np.float32), info)
        assert actions.tolist() == [[True, True, True], [True, False, False]]
    (tmp_path / choosing.FILE).write_text("[3]")
    with pytest.raises(ValueError, match="teacher.json is damaged .*delete it"):
        choosing.make_teacher(tmp_path, config, resume=True)


def test_routes_to_choose_on_are_training_routes(choosing):
    config = small(seed=5, pool=3)
    source, rng = training_source(config), np.random.default_rng(0)
    chosen = choosing.teacher_routes(config, 2)
    for number, bank in enumerate(chosen):
        np.testing.assert_array_equal(bank.scores, source.sample(rng, number)[0].scores)
    assert len(chosen) == 2


# ---- the command ---------------------------------------------------------------------------


@pytest.fixture
def command(monkeypatch, amusic, choosing):
    """Runs the command with a small teacher; its exit status and the lines on stderr."""
    settings = ImitationConfig(rounds=2, frames=40, epochs=1)
    defaults = {**SMALL, "imitation": settings}
    monkeypatch.setattr(
        "amusic_agents.config.TrainingConfig", lambda **v: TrainingConfig(**defaults | v)
    )
    monkeypatch.setattr(choosing, "teacher_routes", lambda config, routes: banks(20, 2))
    monkeypatch.setattr(choosing, "PARTS", 2)
    monkeypatch.setitem(choosing.make_teacher.__kwdefaults__, "grid", choosing.GRID[:3])
    monkeypatch.setattr(choosing, "tqdm", lambda items, **_: items)  # no bar among the lines

    def call(*arguments: object) -> tuple[int, list[str]]:
        status, _, err = amusic("train", *arguments)
        lines = err.strip().splitlines()
        return status, [line for line in lines if "imitation:" not in line]

    return call


def test_the_command_imitates_and_goes_on_with_ppo(tmp_path, command, choosing, monkeypatch):
    folder = random_bank(1).save(tmp_path / "bank")
    run = tmp_path / "run"
    options = ("--out", run, "--bank", folder, "--seed", 2)
    with monkeypatch.context() as patch:
        stop_at(patch, ImitationLearner, "_drive", 2)
        begun = (*options, "--algorithm", "imitation+ppo", "--timesteps", 64)
        assert command(*begun)[0] == 130
    assert not (run / CHECKPOINT).exists()
    chosen = (run / IMITATION / "teacher.json").read_bytes()
    with monkeypatch.context() as patch:
        patch.delattr(choosing, "choose_cascades")  # refused before that: it takes a while
        status, lines = command(*options, "--algorithm", "imitation+ppo")
    assert (status, len(lines)) == (2, 1)
    assert "holds a training already" in lines[0]
    assert command("--out", run, "--resume") == (0, [])
    assert (run / IMITATION / "teacher.json").read_bytes() == chosen
    assert stored_config(run).algorithm == "imitation+ppo"
    assert stored_config(run).frozen_updates > 0
    assert int(read_tensors(run / CHECKPOINT)[1]["timesteps"]) == 64
    status, lines = command("--out", run, "--resume", "--algorithm", "rollouts")
    assert (status, len(lines)) == (2, 1)
    assert "algorithm is rollouts, but" in lines[0]


def test_the_command_imitates_alone(tmp_path, command):
    folder = random_bank(1).save(tmp_path / "bank")
    options = ("--bank", folder, "--algorithm", "imitation")
    assert command("--out", tmp_path / "run", *options) == (0, [])
    assert stored_config(tmp_path / "run").algorithm == "imitation"
    status, lines = command("--out", tmp_path / "x", "--algorithm", "imitate")
    assert status == 2
    assert "did you mean 'imitation'" in lines[0]
