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


def main(given: argparse.Namespace) -> None:
    """Train, say where the selector is."""
    learn(given, _config(given))
    print(f"The best selector is in {given.out}; compare it with --policy ppo:{given.out}")


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


def learn(given: argparse.Namespace, config: TrainingConfig) -> None:
    """Train with the configuration's algorithm, after choosing a teacher where it needs one."""
    from amusic_agents.training import (
        train,
    )  # here, so that Ctrl-C in its long import ends well too

    if "imitation" in config.algorithm:
        _imitate(given, config)
    elif config.algorithm == "rollouts":
        from amusic_agents.policy_iteration import iterate_policy

        iterate_policy(given.out, config, banks=given.bank, resume=given.resume)
    else:
        start = given.warm_start
        train(given.out, config, banks=given.bank, resume=given.resume, warm_start=start)


def _imitate(given: argparse.Namespace, config: TrainingConfig) -> None:
    from amusic_agents.imitation import IMITATION, imitate, imitate_then_train
    from amusic_agents.training import refuse_used

    from amusic_gym.cli.teacher import make_teacher

    alone = config.algorithm == "imitation"
    folder = given.out if alone else given.out / IMITATION
    if not given.resume:  # choosing the teacher takes a while
        refuse_used(given.out)
        refuse_used(folder)
    teacher = make_teacher(folder, config, resume=given.resume)
    run_it = imitate if alone else imitate_then_train
    run_it(given.out, config, teacher, banks=given.bank, resume=given.resume)


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    from amusic_agents.config import TrainingConfig
    from amusic_agents.learners import ALGORITHMS

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
        kind, default = type(getattr(defaults, name)), getattr(defaults, name)
        add(option(name), type=kind, help=f"{of} (default of ppo: {default})")
    for name, of in ROLLOUTS.items():
        default = getattr(defaults.rollouts, name)
        add(option(name), type=int, help=f"{of} (default: {default})")
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
    add("--warm-start", type=Path, metavar="RUN", help="let ppo begin from this run's selector")
    add(
        "--resume",
        action="store_true",
        help="go on from the last checkpoint; what is not given stays as it was",
    )


def _config(given: argparse.Namespace) -> TrainingConfig:
    """The defaults, or the configuration of the run to resume, with what was given."""
    from amusic_agents.config import WARM_START, training_config

    given_names = (
        "algorithm timesteps seed n_envs threads statistic carry discount allow_idle reward"
    )
    names = [*given_names.split(), *LEARNING]
    chosen = {name: getattr(given, name) for name in names if getattr(given, name) is not None}
    if given.simulation:
        chosen["simulation"] = ranges(given.simulation)
    algorithm = chosen.get("algorithm", "ppo")
    if given.warm_start and (given.resume or algorithm != "ppo"):
        raise ValueError(
            "--warm-start begins a training with ppo; leave it out to resume, or with another"
            " algorithm"
        )
    tried = {name: getattr(given, name) for name in ROLLOUTS if getattr(given, name) is not None}
    if not given.resume:
        if tried and algorithm != "rollouts":
            raise ValueError(
                f"{option(next(iter(tried)))} is of the algorithm rollouts; leave it out, or give"
                " --algorithm rollouts"
            )
        defaults = WARM_START if given.warm_start else {}
        config = training_config(**{"algorithm": algorithm, **defaults, **chosen})
        return replace(config, rollouts=replace(config.rollouts, **tried)) if tried else config
    base = _stored(given.out)
    own = {**vars(base.rollouts), **vars(base)}
    for name, value in {**chosen, **tried}.items():
        if name not in ("timesteps", "threads") and value != own[name]:
            raise ValueError(
                f"{name} is {value}, but {given.out} was trained with"
                f" {own[name]}; leave it out to resume, or give another folder"
            )
    return replace(base, **chosen)


def ranges(items: Sequence[str]) -> dict[str, float | str | tuple[float, ...]]:
    """``["retimed=0.5", "queries=80:100"]`` as ranges of a simulation."""
    return {name: _value(value) for name, value in pairs(items, "--simulation").items()}


def _value(text: str) -> float | str | tuple[float, ...]:
    try:
        numbers = tuple(float(part) if "." in part else int(part) for part in text.split(":"))
    except ValueError:
        return text  # a word, such as a kind of motion
    return numbers if len(numbers) > 1 else numbers[0]


def _stored(out: Path) -> TrainingConfig:
    """The configuration of a run, or of the imitation that it was stopped in."""
    from amusic_agents.config import stored_config
    from amusic_agents.imitation import IMITATION
    from amusic_agents.run_folder import CONFIG

    begun = (out / CONFIG).exists() or not (out / IMITATION / CONFIG).exists()
    return stored_config(out if begun else out / IMITATION)
