"""Search for the settings of a training that reach the highest score on held-out routes (Optuna).

Every trial is a training in DIR/trials; those far behind are pruned. The best settings so far are
in DIR/best.json, for train --config. Options are those of train, and hold for every trial but for
what is searched: NAME=LOW:HIGH, NAME=LOW:HIGH:log or NAME=A,B,C, such as
learning_rate=1e-4:1e-2:log or network.hidden=32,64,128.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from amusic_agents.config import TrainingConfig, leaves

from amusic_gym.cli.options import MANY
from amusic_gym.cli.parser import Parser, destination, pairs
from amusic_gym.cli.settings import add_settings, given_settings, refuse_unused, settings_of
from amusic_gym.cli.train import learn
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_agents.trials import Learn
    from amusic_agents.tuning import Space


def add_arguments(parser: Parser) -> None:
    """Add the command's arguments."""
    add = parser.add_argument
    add("--out", type=destination, required=True, metavar="DIR", help="study folder")
    add("--trials", type=int, default=20, help="finished in the end (default: %(default)s)")
    about = "what is searched (default: by the algorithm, amusic_agents.tuning.SPACES)"
    add("--space", **MANY, metavar="NAME=VALUES", help=about)
    add("--bank", action="append", default=[], help="train on this bank (repeat)")
    several = (
        "trainings of a trial, from --seed on; with several the mean of their scores counts, and"
        " none is pruned (default: 1)"
    )
    add("--seeds", type=int, metavar="N", help=several)
    together = "trials that are drawn together and may be trained side by side (default: 1)"
    add("--at-once", type=int, default=1, metavar="N", help=together)
    parser.add_shared("--executor")
    resume = "go on with the folder's study, its settings, space and banks"
    add("--resume", action="store_true", help=resume)
    add_settings(parser)


def main(args: argparse.Namespace) -> None:
    """Search, say what every trial reached, and where the best settings are."""
    from amusic_agents.tuning import BEST, SPACES, tune

    config, space = None, None
    if args.resume:
        own = {"space": args.space, "config": args.config, "seeds": args.seeds}
        given = {**given_settings(args), **own}
        for name in (name for name, value in given.items() if value):
            raise ValueError(f"{name} is the study's own when it is resumed; leave it out")
    else:
        config = settings_of(args)
        space = as_space(args.space, config) if args.space else SPACES[config.algorithm]
        refuse_unused(config.algorithm, space)
    tune(
        args.out,
        config,
        trials=args.trials,
        space=space,
        banks=args.bank,
        seeds=1 if args.seeds is None else args.seeds,
        at_once=args.at_once,
        executor=args.executor,
        learn=learner,
    )
    print(f"The best settings are in {args.out / BEST}; train with --config {args.out / BEST}")


def learner(banks: Sequence[str], progress: bool) -> Learn:
    """What trains on these banks, with a teacher where the algorithm needs one."""
    return partial(learn, banks=tuple(banks), progress=progress)


def as_space(items: Sequence[str], config: TrainingConfig) -> Space:
    """``["entropy=1e-4:0.1:log", "epochs=2,4"]`` as what is searched."""
    from amusic_agents.tuning import Range

    known = leaves(config)
    space: dict[str, Range | tuple[Any, ...]] = {}
    for name, text in pairs(items, "--space").items():
        if name not in known:
            raise ValueError(suggest("setting", name, known))
        number = int if isinstance(known[name], int) else float
        ends = text.split(":")
        try:
            if len(ends) == 1:
                space[name] = tuple(map(number, text.split(",")))
            elif len(ends) == 2 or ends[2:] == ["log"]:
                space[name] = Range(number(ends[0]), number(ends[1]), log=len(ends) == 3)
            else:
                raise ValueError(text)
        except ValueError:
            raise ValueError(
                f"--space {name}={text}; give {name}=LOW:HIGH, LOW:HIGH:log or A,B,C, of"
                f" {'whole ' if number is int else ''}numbers"
            ) from None
    return space
