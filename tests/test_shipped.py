"""The selectors that ship, one for each of two statistics, and how they are asked for."""

from __future__ import annotations

import numpy as np
import pytest
from amusic_agents.config import TrainingConfig
from amusic_agents.evaluation import held_out_routes, measure
from amusic_agents.network import SelectorNetwork
from amusic_agents.run_folder import SELECTOR, read_config, stored, write_config, write_selector
from amusic_agents.selector import load_selector
from amusic_agents.shipped import IDLING, PRETRAINED, SHIPPED, shipped
from env_cases import random_bank
from small_training import SMALL

from amusic_gym.envs.sources import SimulatedRoutes
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.contestants import COMPUTE_WEIGHTS, contestants
from amusic_gym.evaluation.metrics import compute
from amusic_gym.evaluation.rollout import Job, rollout, rollouts
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.policies.protocol import Context
from amusic_gym.routes.simulate import population


def test_one_ships_for_the_default_statistic_and_one_for_the_belief():
    assert SHIPPED == (SICSettings.statistic, "belief") == ("evidence", "belief")
    folders = {path.name for path in PRETRAINED.iterdir() if path.is_dir()}
    assert folders == {*SHIPPED, *(shipped(name, allow_idle=True).name for name in IDLING)}
    assert (PRETRAINED / "CARD.md").is_file()
    for statistic in SHIPPED:
        config = read_config(shipped(statistic))
        assert config["versions"]["statistic"] == statistic
        assert config["banks"] == []
        assert {path.name for path in shipped(statistic).iterdir()} == {"config.json", SELECTOR}
        assert (shipped(statistic) / SELECTOR).stat().st_size < 300_000


def test_without_a_folder_the_one_that_ships_is_loaded():
    for selector in (load_selector(), load_selector(statistic="evidence")):
        needs = selector.needs
        assert (needs.statistic, needs.carry, needs.discount) == ("evidence", True, True)
    needs = load_selector(statistic="belief").needs
    assert (needs.statistic, needs.carry, needs.discount) == ("belief", False, False)
    assert load_selector(shipped("belief")).needs == needs
    assert load_selector(shipped("belief"), statistic="belief").needs == needs


def test_one_more_ships_that_may_idle():
    run = shipped(allow_idle=True)
    assert read_config(run)["environment"]["allow_idle"] is True
    needs = load_selector(allow_idle=True).needs
    assert (needs.statistic, needs.allow_idle) == ("evidence", True)
    assert (
        load_selector(run).needs
        == needs
        == made("ppo:idle").needs
        == made("ppo@evidence:idle").needs
    )
    assert not load_selector().needs.allow_idle
    with pytest.raises(
        ValueError, match="no selector that may idle ships for the statistic 'belief'"
    ):
        load_selector(statistic="belief", allow_idle=True)


def test_it_idles_on_most_frames_and_knows_its_place():
    source = SimulatedRoutes(population("evidence"), pool=8, seed=5)
    banks = [source.sample(np.random.default_rng(0), i)[0] for i in range(8)]
    traces = rollouts(
        load_selector(allow_idle=True), [Job(bank, 0.3) for bank in banks], name="ppo"
    )
    assert np.mean([(~trace.ran.any(axis=1)).mean() for trace in traces]) > 0.5
    assert np.mean([trace.correct.mean() for trace in traces]) > 0.6


def test_no_selector_of_another_statistic_is_given_out():
    with pytest.raises(ValueError, match="statistic 'belief', not 'evidence'; give another run"):
        load_selector(shipped("belief"), statistic="evidence")
    with pytest.raises(ValueError, match="no selector ships for the statistic 'mean'; one does"):
        load_selector(statistic="mean")
    with pytest.raises(ValueError, match="'evidance', which is no statistic"):
        shipped("evidance")


@pytest.mark.parametrize("statistic", SHIPPED)
def test_it_spends_less_where_compute_costs_more_and_finds_places(statistic):
    source = SimulatedRoutes(population(statistic), pool=4, seed=5)
    banks = [source.sample(np.random.default_rng(0), i)[0] for i in range(4)]
    jobs = [Job(bank, weight) for weight in (0.03, 3.0) for bank in banks]
    traces = rollouts(load_selector(statistic=statistic), jobs, name="ppo")
    assert {trace.statistic for trace in traces} == {statistic}
    spent = np.reshape([compute(trace) for trace in traces], (2, 4)).mean(axis=1)
    assert spent[1] < spent[0]
    assert np.mean([trace.correct.mean() for trace in traces]) > 0.2  # chance is below 0.05


@pytest.mark.slow
@pytest.mark.parametrize("statistic", SHIPPED)
def test_a_larger_compute_weight_is_never_dearer_nor_better_by_more_than_half_a_hundredth(
    statistic,
):
    selector = load_selector(statistic=statistic)
    banks = held_out_routes(population(statistic), 24)
    accuracy, spent = np.transpose(
        [
            np.mean(
                measure(selector, [Job(bank, weight) for bank in banks], statistic=statistic), 1
            )
            for weight in COMPUTE_WEIGHTS
        ]
    )[:2]
    assert (np.diff(spent) <= 0.0).all()
    assert (np.diff(accuracy) <= 0.005).all()
    assert spent[0] > 3.0 * spent[-1]


def made(spec: str, **insisted):
    (contestant,) = contestants([spec], **insisted)
    return contestant.make(Context.of(random_bank(1), statistic=SICSettings.statistic))


@pytest.mark.parametrize(
    ("spec", "statistic"),
    [("ppo", "evidence"), ("ppo@evidence", "evidence"), ("ppo@belief", "belief")],
)
def test_a_policy_names_the_one_for_its_statistic(spec, statistic):
    policy = made(spec)
    trace = rollout(policy, random_bank(1), name=spec, compute_weight=0.3)
    assert (trace.statistic, trace.carry) == (statistic, statistic == "evidence")
    assert made(spec, statistic=statistic).needs == policy.needs


@pytest.mark.parametrize(
    ("spec", "insisted", "sentence"),
    [
        ("ppo@mean", {}, "no selector ships for the statistic 'mean'"),
        ("ppo@", {}, "no selector ships for the statistic ''"),
        ("ppo@belief:runs/mine", {}, "a run brings its own statistic; name it ppo:runs/mine"),
        ("ppo", {"statistic": "belief"}, "'evidence' and takes no other; .*, name ppo@belief"),
        ("ppo", {"statistic": "mean"}, "leave out --statistic mean or compare it apart"),
        ("ppo@belief", {"statistic": "evidence"}, "'belief' and takes no other"),
        (
            "ppo",
            {"carry": False},
            "with carried candidates and takes nothing else; leave out --no-c",
        ),
        (
            "ppo",
            {"discount": False},
            "with the discount and takes nothing else; leave out --no-disc",
        ),
    ],
)
def test_it_refuses_what_it_was_not_trained_with(spec, insisted, sentence):
    with pytest.raises(ValueError, match=sentence):
        made(spec, **insisted)


def test_what_the_belief_has_no_use_for_is_no_other(tmp_path):
    made("ppo@belief", carry=False, discount=False)
    config = TrainingConfig(**{**SMALL, "carry": False, "discount": False})
    write_selector(tmp_path, SelectorNetwork(config.network), config.network)
    write_config(tmp_path, stored(config, [], None))
    made(f"ppo:{tmp_path}", carry=False, discount=False)
    made(f"ppo:{tmp_path}")


def test_in_a_study_it_is_a_learned_selector_by_its_own_name():
    lineup = Lineup(("ppo", "ppo@belief", "music@belief"), {}, False, {}, (0.3,))
    entrants = lineup.entrants(["A", "B"])
    assert [(one.name, one.family, one.statistic) for one in entrants] == [
        ("ppo", "learned", None),
        ("ppo@belief", "learned", None),
        ("music@belief", "variant", "belief"),
    ]
