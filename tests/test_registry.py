"""Every registered policy can be named, drawn, built and driven; others can register theirs."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys

import matplotlib.colors
import matplotlib.markers
import numpy as np
import pytest
from amusic_baselines import POLICIES
from amusic_baselines.subset import Subset
from env_cases import random_bank

from amusic_gym.evaluation.contestants import contestants
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies import registry
from amusic_gym.policies.protocol import Context, Selector
from amusic_gym.policies.registry import (
    CASCADE,
    FAMILIES,
    FIXED,
    IDLE,
    LEARNED,
    MARK,
    PEER,
    VARIANT,
    RegisteredPolicy,
    front_of,
    make_policy,
    parse,
    policies,
    register,
)

ARGUMENTS = {
    "raw": "T0",
    "single": "T0",
    "subset": "T0+T1",
    "random": "0.5",
    "periodic": "3",
    "ppo@": "evidence",
}
"""Of the policies that need one."""


def spec_of(name: str) -> str:
    colon = "" if name.endswith("@") else ":"
    return f"{name}{colon}{ARGUMENTS[name]}" if name in ARGUMENTS else name


@pytest.mark.parametrize("name", policies())
def test_every_policy_is_known_named_coloured_built_and_driven(name):
    spec, bank = spec_of(name), random_bank(1, queries=12)
    policy, argument = parsed = parse(spec)
    assert policy.name == name
    assert policy.family in FAMILIES
    assert parsed.label.strip() == parsed.label != ""
    assert (MARK in parsed.label) == bool(policy.needs_truth)
    assert policy.colour is None or matplotlib.colors.is_color_like(policy.colour)
    assert policy.marker in matplotlib.markers.MarkerStyle.markers
    assert not parsed.idles
    assert policy.reads_weight(argument or "") == (policy.family == LEARNED or name == "voi")
    (contestant,) = contestants([spec])
    assert contestant.version
    assert pickle.loads(pickle.dumps(contestant.make)).func is contestant.make.func
    made = contestant.make(Context.of(bank, statistic="evidence"))
    traces = [
        rollout(each, bank, name=spec, compute_weight=0.3)
        for each in (made, make_policy(spec, Context.of(bank, statistic="evidence")))
    ]
    assert np.array_equal(traces[0].ran, traces[1].ran)
    if policy.constant:
        other = random_bank(2, queries=12)
        made = make_policy(spec, Context.of(other, statistic="evidence"))
        assert np.array_equal(rollout(made, other, name=spec).ran, traces[0].ran)
    if policy.family == FIXED:
        assert policy.constant
        assert (traces[0].ran == traces[0].ran[0]).all()


@pytest.mark.parametrize("name", [name for name, each in policies().items() if each.draws])
def test_what_draws_does_so_by_its_seed(name):
    bank = random_bank(1, queries=40)
    first, same, other = (
        rollout(
            make_policy(spec_of(name), Context.of(bank, statistic="evidence", seed=seed)),
            bank,
            name=name,
        ).ran
        for seed in (0, 0, 1)
    )
    assert (first == same).all()
    assert (first != other).any()


@pytest.mark.parametrize("spec", ["random:0.1/idle", "periodic:4/T0/idle", "voi:idle"])
def test_what_may_idle_says_so(spec):
    assert parse(spec).idles
    assert parse(spec).is_variant
    assert spec.endswith(IDLE)
    policy = make_policy(spec, Context.of(random_bank(1), statistic="evidence"))
    assert isinstance(policy, Selector)
    assert policy.needs.allow_idle


def test_no_two_that_a_figure_shows_apart_look_alike():
    looks = [(each.colour, each.marker) for each in POLICIES.values() if each.colour]
    assert len(set(looks)) == len(looks)


def test_a_family_s_front_looks_like_nothing_else_there():
    fronts = [each for each in FAMILIES.values() if each.best]
    assert len({each.colour for each in fronts}) == len(fronts)
    assert all(each.front for each in fronts)


def test_the_settings_of_a_peer_make_one_front_and_a_selector_stands_alone():
    assert front_of("xu:0/2/50", PEER) == front_of("xu", PEER) == "xu"
    assert front_of("ppo:runs/a", LEARNED) == "ppo:runs/a"
    assert front_of("cascade:1/3/0.5", CASCADE) == "cascade"
    assert front_of("music@mean", VARIANT) is None


def first_alone(argument, context):
    return Subset([0])


@pytest.fixture
def mine(monkeypatch):
    """A policy of one's own, for the length of a test."""
    known = dict(policies())
    monkeypatch.setattr(registry, "policies", lambda: known)
    return register(RegisteredPolicy("mine", first_alone, PEER, "my own", colour="#123456"))


def test_a_policy_of_one_s_own_is_one_like_the_others(mine):
    assert parse("mine").label == "my own"
    assert parse("mine:3").label == "my own (3)"
    bank = random_bank(1)
    (contestant,) = contestants(["mine"])
    assert contestant.version.strip()  # its file's
    assert contestant.compute_weights == (None,)
    trace = rollout(contestant.make(Context.of(bank, statistic="mean")), bank, name="mine")
    assert trace.ran[:, 0].all()
    assert not trace.ran[:, 1:].any()
    with pytest.raises(ValueError, match="there is a policy 'mine'; give yours another name"):
        register(mine)


def test_a_wrong_family_is_refused():
    with pytest.raises(ValueError, match="unknown family 'fixd': did you mean 'fixed'"):
        RegisteredPolicy("x", first_alone, "fixd")


THEIRS = """
from amusic_baselines.subset import Subset
from amusic_gym.policies.registry import PEER, RegisteredPolicy
POLICIES = {"theirs": RegisteredPolicy("theirs", lambda argument, context: Subset([0]), PEER)}
"""


def test_an_installed_package_brings_policies_by_an_entry_point(tmp_path):
    (tmp_path / "their_policies.py").write_text(THEIRS)
    about = tmp_path / "theirs-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(
        "[amusic_gym.policies]\ntheirs = their_policies:POLICIES\n"
    )
    code = (
        "import sys\nfrom amusic_gym.policies.registry import parse\n"
        "assert parse('theirs').policy.family == 'peer'\n"
        "assert parse('ppo').label == 'selector (ppo)'\n"
        "assert 'torch' not in sys.modules and 'matplotlib' not in sys.modules\n"
    )
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    environment = {**os.environ, "PYTHONPATH": path}
    subprocess.run([sys.executable, "-W", "error", "-c", code], env=environment, check=True)
