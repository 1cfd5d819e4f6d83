"""What a policy does on a bank, by its name."""

from amusic_baselines import make_policy

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace


def drive(spec: str, bank: ScoreBank, statistic: str, seed: int = 0) -> Trace:
    """Trace of the policy along the whole bank."""
    policy = make_policy(spec, Context.of(bank, statistic=statistic, seed=seed))
    return rollout(policy, bank, name=spec, statistic=statistic)
