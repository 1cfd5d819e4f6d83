"""Train a selector that ships, from its seed, and say whether it came out as it ships.

By policy iteration with rollouts, on simulated routes and by their ground truth. The run folder is
``--out``; ``--ship`` puts its selector into its folder in ``agents/amusic_agents/pretrained``,
unless the one that is there does better. A run that was stopped goes on where it was.
"""

import math
from pathlib import Path

from _cli import Parser, destination, run
from amusic_agents.config import TrainingConfig, training_config
from amusic_agents.evaluation import HeldOut
from amusic_agents.run_folder import CONFIG, SELECTOR, read_config, stored_config, write_config
from amusic_agents.selector import load_selector
from amusic_agents.shipped import SHIPPED, shipped

from amusic_gym.cli.train import learn
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.utils.storage import write_whole

SEED = 0
REWARD = "ground_truth"
"""Of the simulated routes: a selector that is rewarded with p̂ learns to exploit its errors."""
IDLING = {"compute_weights": (0.02, 0.5), "highest_weight": 0.3}
"""Of the one that may idle: at λ 0.3 it costs a few hundredths; beyond it is lost too often."""


def is_same(out: Path, folder: Path) -> bool:
    """Whether a run's selector is the one in a folder, bit for bit."""
    there = folder / SELECTOR
    return there.is_file() and there.read_bytes() == (out / SELECTOR).read_bytes()


def ship(out: Path, folder: Path) -> None:
    """Copy what a selector needs to drive, and where it is from.

    A selector that does better on the held-out routes is not replaced: a ValueError.
    """
    if not is_same(out, folder):
        config = stored_config(out)
        routes = config.held_out
        ours, theirs = score(out, config), -math.inf
        try:
            theirs = score(folder, config)
        except (FileNotFoundError, ValueError) as error:  # of another version, say
            print(f"No selector to compare with in {folder}: {error}")
        if ours < theirs:
            raise ValueError(
                f"the selector in {folder} reaches a score of {theirs:.4f} on {routes} held-out"
                f" routes, that in {out} only {ours:.4f}; leave out --ship, or delete"
                f" {folder / SELECTOR} first"
            )
    write_whole(folder / SELECTOR, (out / SELECTOR).read_bytes())
    write_config(folder, read_config(out))


def score(run: Path, config: TrainingConfig) -> float:
    """Score of a run's selector on a training's held-out routes, and at λ of its range.

    True places − λ · compute, per frame.

    Raises:
        FileNotFoundError: if there is no selector.
        ValueError: if it was trained with another version, or is damaged.
    """
    selector = load_selector(run)
    held_out = HeldOut(config.held_out, config.statistic, config.acting_weights)
    return held_out.evaluate(selector, 0).score


def main(arguments: list[str] | None = None) -> None:
    """Parse, train, compare with what ships, and ship where asked."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=destination, required=True, help="run folder")
    add("--seed", type=int, default=SEED, help=f"({SEED})")
    add("--threads", type=int, default=2, help="that drive; the result is the same (%(default)s)")
    which = "that it ships for (default: %(default)s)"
    add("--statistic", choices=SHIPPED, default=SICSettings.statistic, help=which)
    add("--allow-idle", action="store_true", help="the one that may run nothing on a frame")
    add("--ship", action="store_true", help="put the selector into agents/amusic_agents/pretrained")
    given = parser.parse_args(arguments)

    folder = shipped(given.statistic, allow_idle=given.allow_idle)
    config = training_config(
        algorithm="rollouts",
        seed=given.seed,
        statistic=given.statistic,
        reward=REWARD,
        threads=given.threads,
        allow_idle=given.allow_idle,
        **(IDLING if given.allow_idle else {}),
    )
    learn(given.out, config, resume=(given.out / CONFIG).exists())
    idles = " and may idle" if given.allow_idle else ""
    words = f"the selector that ships for {given.statistic!r}{idles}"
    if not is_same(given.out, folder):
        words = f"not {words}, bit for bit"
    print(f"The selector in {given.out} is {words}")
    if given.ship:
        ship(given.out, folder)


if __name__ == "__main__":
    run(main)
