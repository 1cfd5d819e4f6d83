"""The policies a script can be asked for: the baselines, and trained selectors."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import baselines
from amusic_gym.comparison import COMPUTE_WEIGHTS, Contestant
from amusic_gym.comparison_files import code_digest, file_digest
from amusic_gym.policy import Context, Policy
from baselines import NEEDS_GROUND_TRUTH, READS_COMPUTE_WEIGHT, make_policy

BASELINES = Path(baselines.__file__).parent

SHIPPED = BASELINES.parent / "agents" / "pretrained"
"""Run folder of the selector that ships; named without loading PyTorch."""

OF_TRAINING = "of the routes that it was trained on"
"""What a selector needs ground truth of whose reward was the true correctness."""


def contestants(
    specs: Sequence[str],
    *,
    statistic: str | None = None,
    compute_weights: Sequence[float] = COMPUTE_WEIGHTS,
) -> list[Contestant]:
    """The policies of ``NAME:ARGUMENT`` specs, each once.

    Args:
        specs: as on the command line of compare.py.
        statistic: the one that the user insists on; a trained selector refuses another.
        compute_weights: λ of the trained selectors, and of baselines that read it.

    Raises:
        FileNotFoundError: for a run folder that is not there.
    """
    return [_contestant(spec, statistic, tuple(compute_weights)) for spec in dict.fromkeys(specs)]


def _contestant(spec: str, statistic: str | None, weights: tuple[float, ...]) -> Contestant:
    name, _, folder = spec.partition(":")
    if name != "ppo":
        return Contestant(
            spec,
            partial(make_policy, spec),
            weights if spec in READS_COMPUTE_WEIGHT else (None,),
            version=code_digest(BASELINES),
            needs_truth=NEEDS_GROUND_TRUTH.get(name, ""),
        )
    return _learned(spec, Path(folder) if folder else SHIPPED, statistic, weights)


def _learned(
    spec: str, folder: Path, statistic: str | None, weights: tuple[float, ...]
) -> Contestant:
    import agents  # these need PyTorch
    from agents.run_folder import SELECTOR
    from agents.selector import learned_from_truth, load_selector

    load_selector(folder)  # refuses what is no run folder

    def make(context: Context) -> Policy:
        selector = load_selector(folder)
        own = selector.needs.statistic
        if statistic not in (None, own):
            raise ValueError(
                f"{folder} was trained with the statistic {own!r} and takes no other; leave out "
                f"--statistic {statistic} or compare it apart"
            )
        return selector

    version = f"{file_digest(folder / SELECTOR)} {code_digest(Path(agents.__file__).parent)}"
    needs_truth = OF_TRAINING if learned_from_truth(folder) else ""
    return Contestant(spec, make, weights, version, needs_truth)
