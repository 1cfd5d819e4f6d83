"""A study of settings: what is tried, pruned, kept, and where it goes on."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from amusic_agents.config import ALGORITHMS, TrainingConfig, leaves, training_config
from amusic_agents.evaluation import Evaluation
from amusic_agents.run_folder import CONFIG, stored_config
from amusic_agents.training import train
from amusic_agents.tuning import BEST, JOURNAL, SPACES, TRIALS, Range, Study, check_space, tune
from env_cases import random_bank
from small_training import SMALL, Quick, contents, learn_and_die_once, small, stop_at

from amusic_gym.cli.tune import as_space

optuna = pytest.importorskip("optuna", reason='pip install "amusic-gym[tune]"')

SPACE = {"entropy": Range(0.0, 1.0), "epochs": Range(1, 9), "network.hidden": (8, 16)}


class Landscape:
    """Trainings whose score is known: it rises to 1 - |entropy - 0.3| in five evaluations."""

    def __init__(self, stop: tuple[int, int] | None = None) -> None:
        self.stop = stop  # training and evaluation at which Ctrl-C comes
        self.bars: list[bool] = []
        self.trained: list[tuple[Path, TrainingConfig, bool, int]] = []

    def __call__(self, banks, progress):
        self.bars.append(progress)
        return self.learn

    def learn(self, out, config, resume, evaluated):
        out.mkdir(parents=True, exist_ok=True)
        (out / CONFIG).touch()
        known = out / "known"
        begun = int(known.read_text()) if known.exists() else 0
        self.trained.append((out, config, resume, begun))
        for step in range(1, 6):
            if self.stop == (len(self.trained), step):
                raise KeyboardInterrupt
            known.write_text(str(step))
            score = (1.0 - abs(config.entropy - 0.3)) * step / 5
            frames = 100 * step + len(self.trained)  # as if updates were of other lengths
            evaluated(Evaluation(frames, score, 0.0, 0.0, 0.0))


def settings(study: Path) -> list[tuple[str, dict]]:
    return [(trial.state.name, trial.params) for trial in Study(study).study.trials]


def test_the_best_is_found_and_kept_as_settings(tmp_path):
    said, config = [], training_config("ppo", seed=3)
    land = Landscape()
    best = tune(tmp_path, config, trials=25, space=SPACE, learn=land, report=said.append)
    assert abs(best.entropy - 0.3) < 0.1
    tried = [each for _, each, *_ in land.trained]
    assert len(tried) == len(said) == 25
    assert {each.network.hidden for each in tried} == {8, 16}
    assert {type(each.epochs) for each in tried} == {int}
    assert all(1 <= each.epochs <= 9 and 0 <= each.entropy <= 1 for each in tried)
    kept = json.loads((tmp_path / BEST).read_text())
    assert kept == json.loads(json.dumps(asdict(best)))
    same = {"entropy", "epochs", "network.hidden"}
    assert {n for n, v in leaves(best).items() if v != leaves(config)[n]} <= same
    ends = [state for state, _ in settings(tmp_path)]
    assert set(ends) == {"COMPLETE", "PRUNED"}
    assert ends[:5] == ["COMPLETE"] * 5  # what is pruned must be behind the median of others
    assert sum("pruned after" in line for line in said) == ends.count("PRUNED")
    assert f"best {1 - abs(best.entropy - 0.3):.4f}" in said[-1]


def test_trials_behind_the_median_of_the_others_are_pruned(tmp_path):
    space = {"entropy": (0.3, 0.31, 0.32, 0.33, 0.34, 0.5, 0.9)}
    tune(tmp_path, TrainingConfig(), trials=25, space=space, learn=Landscape(), report=str)
    complete, pruned = [], 0
    for trial in Study(tmp_path).study.trials:
        scores = list(trial.intermediate_values.values())
        behind = [
            len(complete) >= 5 and max(scores[:step]) < np.median([c[step - 1] for c in complete])
            for step in range(1, len(scores) + 1)
        ]
        assert behind == [False] * (len(scores) - 1) + [trial.state.name == "PRUNED"]
        if behind[-1]:
            pruned += 1
        else:
            assert len(scores) == 5
            complete.append(scores)
    assert 2 < pruned < 20


def test_an_interrupted_study_goes_on_with_the_trial_it_was_in(tmp_path):
    land, config = Landscape(stop=(3, 4)), training_config("ppo", seed=1)
    with pytest.raises(KeyboardInterrupt):
        tune(tmp_path, config, trials=6, space=SPACE, learn=land, report=str)
    assert [state for state, _ in settings(tmp_path)] == ["COMPLETE"] * 2 + ["RUNNING"]
    assert json.loads((tmp_path / BEST).read_text())["seed"] == 1
    again = Landscape()
    tune(tmp_path, None, trials=6, learn=again, report=str)
    out, same, resume, begun = again.trained[0]
    assert (out, same) == land.trained[2][:2]
    assert (resume, begun) == (True, 3)
    states = settings(tmp_path)
    assert [state for state, _ in states][2] == "FAIL"
    assert states[3][1] == states[2][1]
    finished = [state for state, _ in states if state != "FAIL"]
    assert len(finished) == 6
    folders = {out for out, *_ in land.trained + again.trained}
    assert folders == set((tmp_path / TRIALS).iterdir())
    assert len(folders) == 6
    assert len({params["entropy"] for state, params in states if state != "FAIL"}) == 6
    before = (tmp_path / JOURNAL).read_bytes()
    tune(tmp_path, None, trials=6, learn=again, report=str)  # has them all
    assert len(again.trained) == 4
    assert (tmp_path / JOURNAL).read_bytes() == before


def test_trials_of_a_round_know_nothing_of_each_other(tmp_path):
    land, config = Landscape(), training_config("ppo", seed=1)
    tune(tmp_path, config, trials=8, at_once=3, space=SPACE, learn=land, report=str)
    assert len(land.trained) == 8  # the last round is of two
    scores = [list(trial.intermediate_values.values()) for trial in Study(tmp_path).study.trials]
    states = [state for state, _ in settings(tmp_path)]
    for number, (state, mine) in enumerate(zip(states, scores, strict=True)):
        before = [
            other
            for other, ended in zip(scores, states[: number // 3 * 3], strict=False)
            if ended == "COMPLETE"
        ]
        behind = len(before) >= 5 and any(
            max(mine[:step]) < np.median([other[step - 1] for other in before])
            for step in range(1, len(mine) + 1)
        )
        assert behind == (state == "PRUNED")
    assert "PRUNED" in states
    assert land.bars == [True]


def test_a_trial_of_several_seeds_has_the_mean_of_their_scores(tmp_path):
    class Seeded(Landscape):
        def learn(self, out, config, resume, evaluated):
            self.trained.append((out, config, resume, 0))
            for step in (1, 2):
                evaluated(Evaluation(step, step * config.entropy + config.seed, 0.0, 0.0, 0.0))

    land, config = Seeded(), training_config("ppo", seed=4)
    best = tune(tmp_path, config, trials=6, seeds=3, space=SPACE, learn=land, report=str)
    assert best.seed == 4
    folders = [str(out.relative_to(tmp_path / TRIALS)) for out, *_ in land.trained]
    assert folders[:4] == ["0000/seed-4", "0000/seed-5", "0000/seed-6", "0001/seed-4"]
    assert [each.seed for _, each, *_ in land.trained] == [4, 5, 6] * 6
    for trial in Study(tmp_path).study.trials:  # none is pruned
        entropy = trial.params["entropy"]
        assert trial.intermediate_values == pytest.approx({1: entropy + 5, 2: 2 * entropy + 5})
        assert trial.value == pytest.approx(2 * entropy + 5)
    tune(tmp_path, None, trials=7, learn=land, report=str)
    assert len(land.trained) == 21


@pytest.mark.parametrize("algorithm", ALGORITHMS)
def test_what_is_searched_by_default_is_what_the_algorithm_takes(algorithm):
    check_space(SPACES[algorithm], training_config(algorithm))


@pytest.mark.parametrize(
    ("space", "sentence"),
    [
        ({}, "nothing to search"),
        ({"entropi": Range(0, 1)}, "entropi is no number of a training's settings"),
        ({"statistic": ("mean",)}, "statistic is no number"),
        ({"allow_idle": (True,)}, "allow_idle is no number"),
        ({"seed": Range(0, 9)}, "seed decides how trials are judged"),
        ({"highest_weight": (1.0,)}, "highest_weight decides how trials are judged"),
        ({"entropy": Range(1.0, 0.5)}, "entropy from 1.0 to 0.5; give LOW <= HIGH"),
        ({"entropy": Range(0.0, 0.5, log=True)}, "0 < LOW for log"),
        ({"gae_lambda": Range(0.5, 1.5)}, "gae_lambda is 1.5"),
        ({"epochs": (1, 0)}, "epochs is 0"),
    ],
)
def test_what_cannot_be_searched_is_refused_before_a_folder_is_made(tmp_path, space, sentence):
    with pytest.raises(ValueError, match=sentence):
        tune(tmp_path / "study", TrainingConfig(), trials=1, space=space)
    assert not (tmp_path / "study").exists()


def test_folders_of_other_states_are_refused(tmp_path, monkeypatch):
    tune(tmp_path / "a", TrainingConfig(), trials=1, space=SPACE, learn=Landscape(), report=str)
    with pytest.raises(ValueError, match="holds a study already; resume it or give another"):
        tune(tmp_path / "a", TrainingConfig(), trials=1, space=SPACE, learn=Landscape())
    with pytest.raises(ValueError, match="holds no study; leave out resume"):
        tune(tmp_path / "b", None, trials=1)
    assert not (tmp_path / "b").exists()
    (tmp_path / "a" / JOURNAL).write_text('{"op": \n{}\n')
    with pytest.raises(ValueError, match=r"journal\.log is damaged"):
        tune(tmp_path / "a", None, trials=1)
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(ValueError, match=r"pip install \"amusic-gym\[tune\]\""):
        tune(tmp_path / "c", TrainingConfig(), trials=1)


def test_spaces_are_read_from_words():
    words = ["entropy=1e-4:0.1:log", "epochs=2:6", "network.hidden=8,16", "gae_lambda=0.9,1"]
    assert as_space(words, TrainingConfig()) == {
        "entropy": Range(1e-4, 0.1, log=True),
        "epochs": Range(2, 6),
        "network.hidden": (8, 16),
        "gae_lambda": (0.9, 1.0),
    }


# ---- with real trainings -------------------------------------------------------------------


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr("amusic_agents.records.HeldOut", Quick)


def test_every_evaluation_is_told_also_those_before_a_resume(tmp_path, quick):
    seen: list[Evaluation] = []
    banks = [random_bank(1)]
    train(tmp_path, small("ppo"), banks=banks, evaluated=seen.append, progress=False)
    assert [each.timesteps for each in seen] == [64, 96]
    again: list[Evaluation] = []
    config = small("ppo", timesteps=160)
    options = {"banks": banks, "resume": True, "progress": False}
    train(tmp_path, config, evaluated=again.append, **options)
    assert again[:2] == seen
    assert [each.timesteps for each in again] == [64, 96, 160]


def search(out: Path, marker: Path, executor: str) -> None:
    """Two rounds of two trials of real trainings."""
    learn = partial(learn_and_die_once, marker)
    space = {"learning_rate": Range(1e-4, 1e-2, log=True)}
    options = {"trials": 4, "at_once": 2, "space": space, "executor": executor, "report": str}
    tune(out, small("ppo"), learn=lambda banks, progress: learn, **options)


def untimed(run: Path) -> dict[str, bytes]:
    """What a run folder says, but for logs that say how long things took."""
    found = contents(run)
    assert {"selector.safetensors", "evaluation.csv", CONFIG} <= set(found)
    return {
        name: data for name, data in found.items() if not name.startswith(("events.", "progress."))
    }


def told(out: Path) -> list[tuple]:
    trials = Study(out).study.trials
    return [(each.state.name, each.params, each.intermediate_values) for each in trials]


@pytest.fixture(scope="module")
def serial(tmp_path_factory) -> Path:
    """The search as one process does it."""
    out = tmp_path_factory.mktemp("serial")
    (out / "done").touch()
    search(out / "study", out / "done", "serial")
    return out / "study"


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["process:2", "ray"])
def test_37_a_killed_worker_changes_nothing_of_a_search(tmp_path, serial, executor, request):
    if executor == "ray":
        request.getfixturevalue("two_ray_workers")
    elsewhere = tmp_path / "elsewhere"
    search(elsewhere, tmp_path / "marker", executor)
    assert (tmp_path / "marker").exists()
    assert (elsewhere / BEST).read_bytes() == (serial / BEST).read_bytes()
    assert told(elsewhere) == told(serial)
    runs = sorted(path.name for path in (serial / TRIALS).iterdir())
    assert runs == [path.name for path in sorted((elsewhere / TRIALS).iterdir())]
    assert len(runs) == 4
    for run in runs:
        ours, theirs = (untimed(out / TRIALS / run) for out in (elsewhere, serial))
        assert ours == theirs


def test_32_without_ray_a_search_says_how_to_install_it(tmp_path, amusic, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    status, _, said = amusic("tune", "--out", tmp_path / "study", "--executor", "ray")
    assert (status, said.count("\n")) == (2, 1)
    assert 'pip install "amusic-gym[ray]"' in said
    assert not (tmp_path / "study").exists()


@pytest.fixture
def command(quick, monkeypatch, amusic):
    monkeypatch.setattr(
        "amusic_agents.config.TrainingConfig", lambda **v: TrainingConfig(**SMALL | v)
    )
    return partial(amusic, "tune")


@pytest.mark.slow
def test_the_command_searches_stops_and_goes_on(tmp_path, command, amusic, monkeypatch):
    out, bank = tmp_path / "study", random_bank(1).save(tmp_path / "bank")
    options = ("--bank", bank, "--timesteps", 96, "--space", "learning_rate=1e-4:1e-2:log")
    with monkeypatch.context() as patch:
        stop_at(patch, Quick, "evaluate", 3)
        status, said, told = command("--out", out, "--trials", 3, *options)
    assert status == 130
    assert "trial 0: score 0." in said
    assert "interrupted; what was finished is kept" in told
    assert (out / BEST).is_file()
    status, said, told = command("--out", out, "--trials", 3, "--resume", "--seed", 3)
    assert (status, told.count("\n")) == (2, 1)
    assert "seed is the study's own when it is resumed; leave it out" in told
    status, said, _ = command("--out", out, "--trials", 3, "--resume")
    assert status == 0
    assert said.splitlines()[-1].endswith(f"train with --config {out / BEST}")
    runs = sorted((out / TRIALS).iterdir())
    assert len(runs) == 3
    rates = {stored_config(run).learning_rate for run in runs}
    assert len(rates) == 3
    assert json.loads((out / BEST).read_text())["learning_rate"] in rates
    trained = amusic("train", "--out", tmp_path / "run", "--config", out / BEST, "--bank", bank)
    assert trained[0] == 0
    assert stored_config(tmp_path / "run").learning_rate in rates


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--trials", 0], "trials is 0; give a whole number >= 1"),
        (["--at-once", 0], "at_once is 0; give a whole number >= 1"),
        (["--seeds", 0], "seeds is 0; give a whole number >= 1"),
        (["--executor", "rya"], "did you mean 'ray'"),
        (["--resume", "--seeds", 2], "seeds is the study's own when it is resumed"),
        (["--space", "entropi=0:1"], "did you mean 'entropy'"),
        (["--space", "entropy=low:high"], "give entropy=LOW:HIGH, LOW:HIGH:log or A,B,C"),
        (["--space", "epochs=0.5:2"], "of whole numbers"),
        (["--space", "rollouts.hold=1:5"], "--rollouts-hold is of the algorithm rollouts"),
        (["--resume"], "holds no study"),
        (["--config", "nothing.json"], "nothing.json does not exist"),
    ],
)
def test_bad_arguments_are_refused_in_a_line(tmp_path, amusic, words, sentence):
    status, _, said = amusic("tune", "--out", tmp_path / "study", *words)
    assert (status, said.count("\n")) == (2, 1)
    assert sentence in said
    assert not (tmp_path / "study").exists()
