"""Policies that are not learned: the paper's rule, fixed subsets, simple rules and bounds.

Adding one: a file with its class and its registration, one line in ``POLICIES``, one test.
"""

from amusic_baselines import (
    amusic,
    borda,
    cascade,
    dynmpf,
    hmm,
    hmpf,
    lazygraph,
    mpf,
    oracle,
    periodic,
    plurality,
    raw,
    subset,
    switchhit,
    uniform,
    voi,
    xu,
)
from amusic_gym.policies.registry import RegisteredPolicy, make_policy

POLICIES: dict[str, RegisteredPolicy] = {
    policy.name: policy
    for policy in (
        raw.POLICY,
        subset.SINGLE,
        subset.SUBSET,
        subset.MUSIC,
        amusic.POLICY,
        uniform.POLICY,
        periodic.POLICY,
        cascade.POLICY,
        voi.POLICY,
        oracle.POLICY,
        mpf.POLICY,
        hmpf.POLICY,
        dynmpf.POLICY,
        switchhit.POLICY,
        plurality.POLICY,
        borda.POLICY,
        hmm.POLICY,
        xu.POLICY,
        lazygraph.POLICY,
    )
}

__all__ = ["POLICIES", "make_policy"]
