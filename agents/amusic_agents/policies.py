"""Trained selectors as registered policies, ``ppo`` and its kin; PyTorch loads with the first."""

from pathlib import Path

from amusic_agents.shipped import PRETRAINED, SHIPPED, shipped
from amusic_gym.policies.protocol import Context, Correction, Policy
from amusic_gym.policies.registry import IDLE, LEARNED, Facts, RegisteredPolicy
from amusic_gym.utils.imports import digest_of

OF_TRAINING = "of the routes that it was trained on"
"""What a selector needs ground truth of whose reward was the true correctness."""


def run_of(argument: str | None) -> Path:
    """Run folder of ``ppo``, ``ppo:idle`` (those that ship) or ``ppo:RUN``."""
    return (
        Path(argument) if argument not in (None, "", IDLE) else shipped(allow_idle=bool(argument))
    )


def run_of_statistic(argument: str | None) -> Path:
    """Run folder of ``ppo@STATISTIC`` or ``ppo@STATISTIC:idle``; refuses what does not ship."""
    statistic, _, rest = (argument or "").partition(":")
    if rest not in ("", IDLE):
        raise ValueError(f"ppo@{argument}: a run brings its own statistic; name it ppo:{rest}")
    return shipped(statistic, allow_idle=rest == IDLE)


def ppo(argument: str | None, context: Context) -> Policy:
    """The selector of `run_of`, by a name that other processes find."""
    return _load(run_of(argument), context)


def ppo_of_statistic(argument: str | None, context: Context) -> Policy:
    """The selector of `run_of_statistic`."""
    return _load(run_of_statistic(argument), context)


def _load(run: Path, context: Context) -> Policy:
    from amusic_agents.selector import load_selector

    selector = load_selector(run)
    own = Correction.under(selector, context.statistic)
    if context.insists and context.statistic != own.statistic:
        ships = run.parent == PRETRAINED and context.statistic in SHIPPED
        other = f", name ppo@{context.statistic}" if ships else ""
        raise ValueError(
            f"{run} was trained with the statistic {own.statistic!r} and takes no other; leave"
            f" out --statistic {context.statistic}{other} or compare it apart"
        )
    for name, what in (("carry", "carried candidates"), ("discount", "the discount")):
        if getattr(context, name) not in (None, getattr(own, name)):
            raise ValueError(
                f"{run} was trained with {what} and takes nothing else; leave out --no-{name} or"
                " compare it apart"
            )
    return selector


def _facts(run: Path) -> Facts:
    """What a run folder tells; refuses what is none."""
    from amusic_agents.run_folder import SELECTOR
    from amusic_agents.selector import learned_from_truth, load_selector

    load_selector(run)
    truth = OF_TRAINING if learned_from_truth(run) else ""
    return Facts(digest_of(run / SELECTOR), truth)


POLICIES = {
    "ppo": RegisteredPolicy(
        "ppo",
        ppo,
        LEARNED,
        "selector (ppo)",
        label_of=lambda argument: f"selector (ppo:{Path(argument).name})",
        reads_weight=lambda argument: True,
        facts=lambda argument: _facts(run_of(argument)),
    ),
    "ppo@": RegisteredPolicy(
        "ppo@",
        ppo_of_statistic,
        LEARNED,
        label_of="selector (ppo@{})".format,
        reads_weight=lambda argument: True,
        facts=lambda argument: _facts(run_of_statistic(argument)),
    ),
}
