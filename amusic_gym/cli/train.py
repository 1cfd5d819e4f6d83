"""Train a selector on simulated routes or given banks.

ALGORITHM: ppo (default), imitation (of a cascade chosen on simulated routes), imitation+ppo,
rollouts (tries subsets of techniques from many states and learns what each leads to), reselect
(PPO on when to select again).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from amusic_gym.cli.parser import Parser, add_correction, destination, pairs

if TYPE_CHECKING:
    from amusic_agents.config import TrainingConfig

LEARNING = {
    "n_steps": "frames per route between two updates",
    "batch_size": "frames per gradient step, at most",
    "epochs": "passes over the frames of an update",
    "learning_rate": "at the start; falls linearly to zero",
}
"""Options that decide how fast, and how well, an algorithm learns from its frames."""

ROLLOUTS = {
    "iterations": "of rollouts: each collects and learns",
    "states": "from which each iteration tries subsets of techniques",
}
"""Options of the algorithm ``rollouts``."""


def option(name: str) -> str:
    """The option of a setting: ``--n-steps`` of ``n_steps``."""
    return "--" + name.replace("_", "-")


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    from amusic_agents.config import ALGORITHMS, TrainingConfig

    defaults = TrainingConfig()
    add = parser.add_argument
    add("--out", type=destination, required=True, help="run folder")
    add("--algorithm", choices=list(ALGORITHMS), help=f"see above (default: {defaults.algorithm})")
    add("--bank", action="append", default=[], help="train on this bank (repeat)")
    add("--timesteps", type=int, help=f"frames in all (default: {defaults.timesteps})")
    add("--seed", type=int, help=f"of routes, weights and draws (default: {defaults.seed})")
    add("--n-envs", type=int, help=f"routes side by side (default of ppo: {defaults.n_envs})")
    add(
        "--threads",
        type=int,
        help="that step the routes, with rollouts processes: sooner, the same result (default: 1)",
    )
    for name, of in LEARNING.items():
        default = getattr(defaults, name)
        add(option(name), type=type(default), help=f"{of} (default of ppo: {default})")
    for name, of in ROLLOUTS.items():
        add(option(name), type=int, help=f"{of} (default: {getattr(defaults.rollouts, name)})")
    add("--statistic", help=f"of SIC (default: {defaults.statistic})")
    add_correction(parser, "in training and ever after")
    add("--reward", help=f"estimated or ground_truth (default: {defaults.reward})")
    add(
        "--simulation",
        nargs="+",
        metavar="NAME=VALUE",
        help="draw training routes from other ranges, for example retimed=0 wander=0:0 "
        "(names: amusic_gym.routes.simulate.Simulation)",
    )
    add(
        "--allow-idle",
        action="store_const",
        const=True,
        help="with rollouts: the selector may run nothing on a frame",
    )
    add(
        "--resume",
        action="store_true",
        help="go on from the last checkpoint; what is not given stays as it was",
    )


def main(args: argparse.Namespace) -> None:
    """Train, say where the selector is."""
    learn(args.out, _config(args), args.bank, args.resume)
    print(f"The best selector is in {args.out}; compare it with --policy ppo:{args.out}")


def learn(
    out: Path, config: TrainingConfig, banks: Sequence[str] = (), resume: bool = False
) -> None:
    """Train with the configuration's algorithm, after choosing a teacher where it needs one.

    Args:
        out: the run folder.
        config: how.
        banks: folders of banks to train on; none: simulated routes.
        resume: go on from the folder's last checkpoint.
    """
    from amusic_agents.training import IMITATION, refuse_used, train

    from amusic_gym.cli.teacher import make_teacher

    teacher = None
    if "imitation" in config.algorithm:
        if not resume:  # choosing the teacher takes a while
            refuse_used(out)
        folder = out if config.algorithm == "imitation" else out / IMITATION
        teacher = make_teacher(folder, config, resume=resume)
    train(out, config, banks=banks, teacher=teacher, resume=resume)


def _config(args: argparse.Namespace) -> TrainingConfig:
    """The defaults, or the configuration of the run to resume, with what was given."""
    from amusic_agents.config import training_config
    from amusic_agents.run_folder import stored_config

    given = {name: value for name, value in vars(args).items() if value is not None}
    for name in ("out", "bank", "resume", "parser"):
        given.pop(name, None)
    if args.simulation:
        given["simulation"] = ranges(args.simulation)
    tried = {name: given.pop(name) for name in ROLLOUTS if name in given}
    if not args.resume:
        config = training_config(given.pop("algorithm", "ppo"), **given)
        if tried and config.algorithm != "rollouts":
            raise ValueError(
                f"{option(next(iter(tried)))} is of the algorithm rollouts; leave it out, or give"
                " --algorithm rollouts"
            )
        return replace(config, rollouts=replace(config.rollouts, **tried)) if tried else config
    base = stored_config(args.out)
    own = {**vars(base.rollouts), **vars(base)}
    for name, value in {**given, **tried}.items():
        if name not in ("timesteps", "threads") and value != own[name]:
            raise ValueError(
                f"{name} is {value}, but {args.out} was trained with"
                f" {own[name]}; leave it out to resume, or give another folder"
            )
    return replace(base, **given)


def ranges(items: Sequence[str]) -> dict[str, float | str | tuple[float, ...]]:
    """``["retimed=0.5", "queries=80:100"]`` as ranges of a simulation."""
    return {name: _value(value) for name, value in pairs(items, "--simulation").items()}


def _value(text: str) -> float | str | tuple[float, ...]:
    try:
        numbers = tuple(float(part) if "." in part else int(part) for part in text.split(":"))
    except ValueError:
        return text  # a word, such as a kind of motion
    return numbers if len(numbers) > 1 else numbers[0]
