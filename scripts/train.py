"""Train a selector with PPO on simulated routes or given banks."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from _cli import Parser, run

from agents.training import TrainingConfig, train


def main(arguments: list[str] | None = None) -> None:
    """Parse, train, say where the selector is."""
    defaults = TrainingConfig()
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="run folder")
    parser.add_argument("--bank", action="append", default=[], help="train on this bank (repeat)")
    parser.add_argument("--timesteps", type=int, default=defaults.timesteps, help="frames in all")
    parser.add_argument("--seed", type=int, default=defaults.seed)
    parser.add_argument("--n-envs", type=int, default=defaults.n_envs, help="routes side by side")
    parser.add_argument("--statistic", default=defaults.statistic, help="mean or evidence")
    parser.add_argument("--resume", action="store_true", help="go on from the last checkpoint")
    given = parser.parse_args(arguments)
    config = replace(
        defaults,
        timesteps=given.timesteps,
        seed=given.seed,
        n_envs=given.n_envs,
        statistic=given.statistic,
    )
    train(given.out, config, banks=given.bank, resume=given.resume)
    print(f"The best selector is in {given.out}; compare it with --policy ppo:{given.out}")


if __name__ == "__main__":
    run(main)
