"""The settings of a training as options and as a file: all of them, with one list of defaults."""

from __future__ import annotations

import json
from dataclasses import asdict

import pytest
from amusic_agents.config import (
    ALGORITHMS,
    USED_BY,
    TrainingConfig,
    leaves,
    nested,
    training_config,
    with_values,
)
from amusic_agents.run_folder import stored, write_config

from amusic_gym.cli import train
from amusic_gym.cli.parser import Parser
from amusic_gym.cli.settings import APART, given_settings, option, settings_of


def parsed(*words: object):
    parser = Parser(prog="train")
    train.add_arguments(parser)
    return parser.parse_args(["--out", "run", *map(str, words)])


def config_of(*words: object) -> TrainingConfig:
    return settings_of(parsed(*words))


def another(name: str, default):
    """A valid value that is not the default, and the words for it."""
    if name in ("statistic", "reward"):
        value = {"statistic": "mean", "reward": "ground_truth"}[name]
        return value, [value]
    if isinstance(default, tuple):
        return (0.5, 2.0), [0.5, 2.0]
    if isinstance(default, float):
        return default / 2, [default / 2]
    return default + 1, [default + 1]


LEAVES = {
    name: value
    for name, value in leaves(TrainingConfig()).items()
    if name not in (*APART, "algorithm", "allow_idle")
}


def test_nothing_given_is_the_default_of_every_algorithm():
    assert config_of() == TrainingConfig()
    for algorithm in ALGORITHMS:
        assert config_of("--algorithm", algorithm) == training_config(algorithm)


@pytest.mark.parametrize("name", LEAVES)
def test_every_setting_has_an_option_with_its_description(name, capsys):
    value, words = another(name, LEAVES[name])
    algorithm = USED_BY.get(name.partition(".")[0], ("ppo",))[-1]
    config = config_of("--algorithm", algorithm, option(name), *words)
    assert leaves(config)[name] == value
    assert config == with_values(training_config(algorithm), nested({name: value}))
    with pytest.raises(SystemExit):
        parsed("--help")
    said = " ".join(
        capsys.readouterr().out.split(f"\n  {option(name)} ")[1].split("\n  --")[0].split()
    )
    assert "(default: " in said
    assert len(said.partition(" (default")[0].split()) > 2, f"{name} is not in its docstring"


def test_what_is_no_plain_value_has_an_option_too():
    config = config_of("--algorithm", "rollouts", "--allow-idle", "--no-carry", "--states", 12)
    assert (config.allow_idle, config.carry, config.rollouts.states) == (True, False, 12)
    assert config_of("--simulation", "retimed=0.5", "queries=80:100").simulation == {
        "retimed": 0.5,
        "queries": (80, 100),
    }


def test_a_run_s_own_file_makes_the_same_configuration(tmp_path):
    config = config_of(
        *("--algorithm", "rollouts", "--rollouts-hold", 3, "--seed", 5),
        *("--simulation", "queries=80:100", "--compute-weights", 0.1, 2),
    )
    write_config(tmp_path, stored(config, [], None))
    assert config_of("--config", tmp_path / "config.json") == config
    (tmp_path / "settings.json").write_text(json.dumps(asdict(config)))
    assert config_of("--config", tmp_path / "settings.json") == config


def test_options_go_before_the_file_and_the_file_before_defaults(tmp_path):
    file = tmp_path / "settings.json"
    file.write_text('{"algorithm": "imitation+ppo", "seed": 3, "network": {"hidden": 16}}')
    config = config_of("--config", file, "--seed", 4, "--network-encoding", 8)
    assert (config.seed, config.network.hidden, config.network.encoding) == (4, 16, 8)
    assert config.frozen_updates == training_config("imitation+ppo").frozen_updates
    assert config.network.first_logit == TrainingConfig().network.first_logit
    other = config_of("--config", file, "--algorithm", "ppo")
    assert (other.algorithm, other.frozen_updates, other.seed) == ("ppo", 0, 3)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ('{"sed": 3}', "settings.json: unknown setting 'sed': did you mean 'seed'?"),
        ('{"network": {"hiden": 3}}', "did you mean 'hidden'?"),
        ('{"network": 3}', "network is 3; give an object with its settings"),
        ('{"timesteps": "many"}', "settings.json: timesteps is 'many'; give a whole number"),
        ('{"compute_weights": [1, 2, 3]}', "compute_weights is"),
        ('{"compute_weights": [2, 1]}', "compute_weights is (2, 1); give (low, high)"),
        ('{"algorithm": "pop"}', "did you mean 'ppo'"),
        ('{"training": 3}', "settings.json: training is 3; give an object"),
        ("{", "settings.json is damaged"),
        ("[]", "settings.json is damaged"),
        (None, "settings.json does not exist"),
    ],
)
def test_bad_files_are_refused_in_a_line(tmp_path, amusic, content, sentence):
    file = tmp_path / "settings.json"
    if content is not None:
        file.write_text(content)
    status, _, said = amusic("train", "--out", tmp_path / "run", "--config", file)
    assert status == 2
    assert len(said.splitlines()) == 1
    assert sentence in said
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--states", 3], "--states is of the algorithm rollouts; leave it out, or give"),
        (
            ["--algorithm", "rollouts", "--network-hidden", 3],
            "--network-hidden is of the algorithm ppo or imitation",
        ),
        (["--algorithm", "reselect", "--imitation-rounds", 3], "--algorithm imitation"),
        (["--compute-weights", 3, 1], "compute_weights is (3.0, 1.0); give (low, high)"),
        (["--network-hidden", 0], "hidden is 0; give a whole number from 1 to"),
        (["--network-hiden", 4], "did you mean '--network-hidden'"),
        (["--gae-lambda", 1.5], "gae_lambda is 1.5; give a number in [0, 1]"),
        (["--resume", "--config", "x.json"], "a run is resumed with its own; leave it out"),
    ],
)
def test_bad_options_are_refused_in_a_line(tmp_path, amusic, words, sentence):
    status, _, said = amusic("train", "--out", tmp_path / "run", *words)
    assert status == 2
    assert len(said.splitlines()) == 1
    assert sentence in said
    assert not (tmp_path / "run").exists()


def test_what_is_given_is_named_as_the_settings_are():
    given = given_settings(parsed("--network-hidden", 3, "--no-discount"))
    assert given == {"network.hidden": 3, "discount": False}
    assert nested(given) == {"network": {"hidden": 3}, "discount": False}
