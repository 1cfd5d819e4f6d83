"""Reference rewards are those that the environment gives, and true."""

from __future__ import annotations

from dataclasses import replace

import gymnasium as gym
import numpy as np
import pytest
from amusic_agents.evaluation import held_out_routes
from env_cases import ENV_NAME

from amusic_gym.cli.rewards import reference_rewards, tables
from amusic_gym.envs.sources import ordinary

WEIGHTS = (0.1, 1.0)


@pytest.fixture(scope="module")
def routes():
    short = replace(ordinary("evidence"), queries=(20, 30))
    return held_out_routes(short, 3)


def driven(bank, weight, action):
    """Mean reward and truth of an action that never changes, from the environment itself."""
    env = gym.make(ENV_NAME, bank=bank, compute_weight=weight)
    env.reset()
    steps = [env.step(action) for _ in range(bank.queries)]
    truth = [bank.truth.is_true(info["prediction"], n) for n, (*_, info) in enumerate(steps)]
    price = sum(info["reward_terms"]["compute"] for *_, info in steps)
    return np.mean([reward for _, reward, *_ in steps]), (sum(truth) + price) / bank.queries


@pytest.mark.parametrize(("policy", "bit"), [("random:0", 0), ("music", 1)])
def test_rewards_are_those_of_the_environment(routes, policy, bit):
    found = reference_rewards([policy], routes, WEIGHTS, statistic="evidence", progress=False)
    action = np.full(4, bit, np.int8)
    for b, bank in enumerate(routes):
        for w, weight in enumerate(WEIGHTS):
            wanted = driven(bank, weight, action)
            np.testing.assert_allclose(found[policy][:, b, w], wanted, atol=1e-9)


def test_tables_hold_means_over_the_routes():
    found = {"one": np.arange(8.0).reshape(2, 2, 2), "other": np.zeros((2, 2, 2))}
    reward, true = tables(found, WEIGHTS, 25.0)
    assert reward.heads == ["policy", "λ 0.1", "λ 1"]
    assert reward.rows == [["one", "1.000", "2.000"], ["other", "0.000", "0.000"]]
    assert true.rows[0] == ["one", "5.000", "6.000"]
    assert "2 routes, of 25 frames" in reward.note
    assert "error is 1.000" in reward.note  # 0 and 2: deviation √2, of two


def test_policies_see_the_same_routes_and_only_those_that_choose_are_taken(routes):
    names = ["random:0.5", "cascade", "random:0.5"]
    found = reference_rewards(names, routes, WEIGHTS, statistic="evidence", progress=False)
    assert list(found) == ["random:0.5", "cascade"]
    assert all(each.shape == (2, 3, 2) for each in found.values())
    with pytest.raises(ValueError, match="plurality gives places itself"):
        reference_rewards(["random:0", "plurality"], routes, WEIGHTS, statistic="evidence")
    with pytest.raises(ValueError, match="cascade"):
        reference_rewards(["cascad"], routes, WEIGHTS, statistic="evidence")


def test_the_command_prints_and_writes_both_tables(amusic, tmp_path):
    out = tmp_path / "rewards.md"
    words = ("--routes", 2, "--policy", "random:0", "--compute-weight", 0.3, "--out", out)
    status, said, _ = amusic("rewards", *words)
    assert status == 0
    assert said.count("random:0") == 2
    text = out.read_text("utf-8")
    assert text.count("| random:0 |") == 2
    assert text.startswith("### Reward per frame")
    number = said.splitlines()[2].split()[-1]
    assert f"| random:0 | {number} |" in text


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--routes", "1"], "--routes is 1; give a whole number >= 2"),
        (["--policy", "nothing"], "nothing"),
        (["--policy", "hmm"], "hmm gives places itself"),
        (["--compute-weight", "-1"], "-1"),
    ],
)
def test_bad_arguments_are_refused_in_a_line(amusic, words, sentence):
    status, _, said = amusic("rewards", *words)
    assert status == 2
    assert sentence in said.splitlines()[-1]


def test_ctrl_c_ends_with_130(amusic, monkeypatch):
    def stop(*arguments, **keywords):
        raise KeyboardInterrupt

    monkeypatch.setattr("amusic_agents.evaluation.measure", stop)
    assert amusic("rewards", "--routes", 2, "--policy", "random:0")[0] == 130
