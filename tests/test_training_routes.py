"""Training routes drawn from other ranges than the population's: an ablation's routes."""

from __future__ import annotations

import json

import numpy as np
import pytest
from amusic_agents.config import TrainingConfig
from amusic_agents.run_folder import stored, stored_config, write_config
from amusic_agents.training import simulated_routes

from amusic_gym.cli import settings, train
from amusic_gym.cli.parser import Parser
from amusic_gym.routes.simulate import TOURS, TOURS_IN_MOTION


def test_what_is_turned_off_on_the_command_line_is_in_the_configuration():
    for words, environment in (
        ([], {"carry": True, "discount": True}),
        (["--no-carry"], {"carry": False, "discount": True}),
        (["--no-discount"], {"carry": True, "discount": False}),
        (["--statistic", "belief", "--no-carry"], {"carry": False, "discount": False}),
    ):
        parser = Parser()
        train.add_arguments(parser)
        given = parser.parse_args(["--out", "run", *words])
        assert train._config(given).environment() == environment


def test_words_of_the_command_line_become_ranges():
    words = ["retimed=0", "wander=0:0.5", "motion=kidnapped"]
    assert settings.ranges(words) == {"retimed": 0, "wander": (0, 0.5), "motion": "kidnapped"}


def test_the_given_ranges_replace_those_of_the_population_and_no_others():
    config = TrainingConfig(simulation={"retimed": 0.0, "techniques": (3, 3)}, pool=4)
    population = config.population()
    assert (population.retimed, population.techniques) == (0.0, (3, 3))
    assert population.queries == TOURS.queries
    assert TrainingConfig().population() == TOURS
    assert TrainingConfig(statistic="belief").population() == TOURS_IN_MOTION
    bank, _ = simulated_routes(config).sample(np.random.default_rng(0), 0)[:2]
    assert len(bank.techniques) == 3


def test_a_run_folder_keeps_them(tmp_path):
    config = TrainingConfig(simulation={"wander": (0.0, 0.5), "retimed": 0.2})
    write_config(tmp_path, json.loads(json.dumps(stored(config, [], None))))
    assert stored_config(tmp_path) == config


@pytest.mark.parametrize(
    ("simulation", "message"),
    [
        ({"retimd": 0.0}, "unknown range of the simulation 'retimd': did you mean 'retimed'"),
        ({"retimed": 2.0}, "retimed"),
        ({"wander": (1.0, 0.0)}, "wander"),
    ],
)
def test_wrong_ranges_are_refused(simulation, message):
    with pytest.raises(ValueError, match=message):
        TrainingConfig(simulation=simulation)
