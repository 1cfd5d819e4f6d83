"""Train a selector with PPO on simulated routes or given banks."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from _cli import Parser, run

if TYPE_CHECKING:
    from agents.config import TrainingConfig


def main(arguments: list[str] | None = None) -> None:
    """Parse, train, say where the selector is."""
    from agents.training import train  # here, so that Ctrl-C in its long import ends well too

    given = _parser().parse_args(arguments)
    train(given.out, _config(given), banks=given.bank, resume=given.resume)
    print(f"The best selector is in {given.out}; compare it with --policy ppo:{given.out}")


def _parser() -> Parser:
    from agents.config import TrainingConfig

    defaults = TrainingConfig()
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=Path, required=True, help="run folder")
    add("--bank", action="append", default=[], help="train on this bank (repeat)")
    add("--timesteps", type=int, help=f"frames in all (default: {defaults.timesteps})")
    add("--seed", type=int, help=f"of routes, weights and draws (default: {defaults.seed})")
    add("--n-envs", type=int, help=f"routes side by side (default: {defaults.n_envs})")
    add("--statistic", help=f"mean or evidence (default: {defaults.statistic})")
    add(
        "--resume",
        action="store_true",
        help="go on from the last checkpoint; what is not given stays as it was",
    )
    return parser


def _config(given: argparse.Namespace) -> TrainingConfig:
    """The defaults, or the configuration of the run to resume, with what was given."""
    from agents.config import TrainingConfig, stored_config

    base = stored_config(given.out) if given.resume else TrainingConfig()
    names = ("timesteps", "seed", "n_envs", "statistic")
    chosen = {name: getattr(given, name) for name in names if getattr(given, name) is not None}
    for name in chosen.keys() - {"timesteps"} if given.resume else ():
        if chosen[name] != getattr(base, name):
            raise ValueError(
                f"{name} is {chosen[name]}, but {given.out} was trained with"
                f" {getattr(base, name)}; leave it out to resume, or give another folder"
            )
    return replace(base, **chosen)


if __name__ == "__main__":
    run(main)
