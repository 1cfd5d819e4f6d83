"""Train a selector on simulated routes or given banks.

ALGORITHM: ppo (default), imitation (of a cascade chosen on simulated routes), imitation+ppo,
rollouts (tries subsets of techniques from many states and learns what each leads to), reselect
(PPO on when to select again).
"""

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from amusic_agents.config import TrainingConfig

from amusic_gym.cli.parser import Parser, destination
from amusic_gym.cli.settings import FREE, add_settings, given_settings, refuse_others, settings_of


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("--out", type=destination, required=True, help="run folder")
    add("--bank", action="append", default=[], help="train on this bank (repeat)")
    resume = "go on from the last checkpoint; what is not given stays as it was"
    add("--resume", action="store_true", help=resume)
    add_settings(parser)


def main(args: argparse.Namespace) -> None:
    """Train, say where the selector is."""
    learn(args.out, _config(args), args.resume, banks=args.bank)
    print(f"The best selector is in {args.out}; compare it with --policy ppo:{args.out}")


def learn(
    out: Path,
    config: TrainingConfig,
    resume: bool = False,
    evaluated: Callable[..., object] | None = None,
    *,
    banks: Sequence[str] = (),
    progress: bool = True,
) -> None:
    """Train with the configuration's algorithm, after choosing a teacher where it needs one."""
    from amusic_agents.training import IMITATION, refuse_used, train

    from amusic_gym.cli.teacher import make_teacher

    teacher = None
    if "imitation" in config.algorithm:
        if not resume:  # choosing the teacher takes a while
            refuse_used(out)
        folder = out if config.algorithm == "imitation" else out / IMITATION
        teacher = make_teacher(folder, config, resume=resume, progress=progress)
    train(
        out,
        config,
        banks=banks,
        teacher=teacher,
        evaluated=evaluated,
        resume=resume,
        progress=progress,
    )


def _config(args: argparse.Namespace) -> TrainingConfig:
    """The configuration of the arguments, or of the run to resume, with what may change."""
    from amusic_agents.run_folder import stored_config

    if not args.resume:
        return settings_of(args)
    if args.config is not None:
        raise ValueError(f"--config {args.config}: a run is resumed with its own; leave it out")
    base, given = stored_config(args.out), given_settings(args)
    refuse_others(given, base, args.out)
    return replace(base, **{name: given[name] for name in FREE if name in given})
