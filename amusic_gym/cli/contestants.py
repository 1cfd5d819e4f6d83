"""The policies a script can be asked for: the baselines, and trained selectors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import amusic_baselines
from amusic_agents.shipped import PRETRAINED, SHIPPED, shipped
from amusic_baselines import NEEDS_GROUND_TRUTH, READS_COMPUTE_WEIGHT, make_policy
from amusic_baselines.arguments import IDLE

from amusic_gym.evaluation.comparison import COMPUTE_WEIGHTS, Contestant
from amusic_gym.evaluation.comparison_files import code_digest, file_digest
from amusic_gym.policies.protocol import Context, Correction, Policy

BASELINES = Path(amusic_baselines.__file__).parent

OF_TRAINING = "of the routes that it was trained on"
"""What a selector needs ground truth of whose reward was the true correctness."""


def contestants(
    specs: Sequence[str],
    *,
    statistic: str | None = None,
    carry: bool | None = None,
    discount: bool | None = None,
    compute_weights: Sequence[float] = COMPUTE_WEIGHTS,
) -> list[Contestant]:
    """The policies of ``NAME:ARGUMENT`` specs, each once.

    Args:
        specs: as on the command line of compare.py.
        statistic: the one that the user insists on; a trained selector refuses another.
        carry: as `statistic`, whether places are carried on as candidates.
        discount: as `statistic`, whether MuSIC discounts alike rows.
        compute_weights: λ of the trained selectors, and of baselines that read it.

    Raises:
        FileNotFoundError: for a run folder that is not there.
        ValueError: for a folder that is no run's, or a statistic that no selector ships for.
    """
    wanted = _Wanted(statistic, carry, discount)
    return [_contestant(spec, wanted, tuple(compute_weights)) for spec in dict.fromkeys(specs)]


class _Wanted(NamedTuple):
    """What the user insists on."""

    statistic: str | None
    carry: bool | None
    discount: bool | None


def _contestant(spec: str, wanted: _Wanted, weights: tuple[float, ...]) -> Contestant:
    name, _, folder = spec.partition(":")
    kind, at, statistic = name.partition("@")
    if kind != "ppo":
        return Contestant(
            spec,
            partial(make_policy, spec),
            weights if spec in READS_COMPUTE_WEIGHT else (None,),
            version=code_digest(BASELINES),
            needs_truth=NEEDS_GROUND_TRUTH.get(name, ""),
        )
    if at and folder not in ("", IDLE):
        raise ValueError(f"{spec}: a run brings its own statistic; name it ppo:{folder}")
    run = Path(folder)
    if folder in ("", IDLE):
        run = shipped(*[statistic] if at else [], allow_idle=folder == IDLE)
    return _learned(spec, run, wanted, weights)


def _learned(spec: str, folder: Path, wanted: _Wanted, weights: tuple[float, ...]) -> Contestant:
    import amusic_agents  # these need PyTorch
    from amusic_agents.run_folder import SELECTOR
    from amusic_agents.selector import learned_from_truth, load_selector

    load_selector(folder)  # refuses what is no run folder

    def make(context: Context) -> Policy:
        selector = load_selector(folder)
        _refuse_another(folder, Correction.under(selector, context.statistic), wanted)
        return selector

    version = f"{file_digest(folder / SELECTOR)} {code_digest(Path(amusic_agents.__file__).parent)}"
    needs_truth = OF_TRAINING if learned_from_truth(folder) else ""
    return Contestant(spec, make, weights, version, needs_truth)


def _refuse_another(folder: Path, own: Correction, wanted: _Wanted) -> None:
    """Refuse what the user insists on where a selector was trained with something else."""
    if wanted.statistic not in (None, own.statistic):
        ships = folder.parent == PRETRAINED and wanted.statistic in SHIPPED
        other = f", name ppo@{wanted.statistic}" if ships else ""
        raise ValueError(
            f"{folder} was trained with the statistic {own.statistic!r} and takes no other; leave"
            f" out --statistic {wanted.statistic}{other} or compare it apart"
        )
    for name, what in (("carry", "carried candidates"), ("discount", "the discount")):
        if getattr(wanted, name) not in (None, getattr(own, name)):
            raise ValueError(
                f"{folder} was trained with {what} and takes nothing else; leave out --no-{name} or"
                " compare it apart"
            )
