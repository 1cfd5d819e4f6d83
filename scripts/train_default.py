"""Train a selector that ships, from its seed, and say whether it came out as it ships.

For ``evidence`` by policy iteration with rollouts. For ``belief`` a cascade is chosen for every
part of the range of λ, imitated, and the imitation goes on learning with PPO. All of it on
simulated routes, by their ground truth. The run folder is ``--out``; ``--ship`` puts its selector
into its folder in ``agents/amusic_agents/pretrained``, unless the one that is there does better. A
run that was stopped goes on where it was.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from _cli import Parser, destination, run
from amusic_agents.shipped import SHIPPED, shipped

from amusic_gym.estimation.settings import SICSettings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from amusic_agents.config import TrainingConfig

    from amusic_gym.cli.teacher import Parameters

ALGORITHM = {"evidence": "rollouts", "belief": "imitation+ppo"}
"""Statistic → how what ships for it was trained."""

TIMESTEPS = 2_000_000
SEED = 0
REWARD = "ground_truth"
"""Of the simulated routes: a selector that is rewarded with p̂ learns to please it."""


def learn(
    out: Path,
    config: TrainingConfig,
    *,
    routes: int | None = None,
    grid: Sequence[Parameters] | None = None,
) -> None:
    """Train as the configuration's algorithm does, from where the folder is.

    Args:
        out: the run folder; nothing is done if its training is finished.
        config: of the training.
        routes: simulated routes to choose the teacher on; None: as many as for what ships.
        grid: cascades to choose from; None: those for what ships.
    """
    from amusic_agents.imitation import IMITATION, imitate_then_train
    from amusic_agents.policy_iteration import iterate_policy
    from amusic_agents.run_folder import CONFIG

    from amusic_gym.cli.teacher import GRID, ROUTES, make_teacher

    if config.algorithm == "rollouts":
        iterate_policy(out, config, resume=(out / CONFIG).exists())
        return
    if _finished(out, config.timesteps):
        return
    begun = any((out / part / CONFIG).exists() for part in (".", IMITATION))
    teacher = make_teacher(
        out / IMITATION, config, resume=begun, routes=routes or ROUTES, grid=grid or GRID
    )
    imitate_then_train(out, config, teacher, resume=begun)


def _finished(out: Path, timesteps: int) -> bool:
    """Whether the folder holds a training that has had its frames."""
    from amusic_agents.run_folder import EVALUATIONS

    file = out / EVALUATIONS
    rows = file.read_text("utf-8", "replace").split() if file.is_file() else []
    done = rows[-1].split(",")[0] if len(rows) > 1 else "0"
    if not done.isdecimal():
        raise ValueError(f"{file} is damaged; delete {out} to train again")
    return int(done) >= timesteps


def is_same(out: Path, folder: Path) -> bool:
    """Whether a run's selector is the one in a folder, bit for bit."""
    from amusic_agents.run_folder import SELECTOR

    there = folder / SELECTOR
    return there.is_file() and there.read_bytes() == (out / SELECTOR).read_bytes()


def ship(out: Path, folder: Path) -> None:
    """Copy what a selector needs to drive, and where it is from, without a machine's paths.

    Raises:
        ValueError: if the selector in ``folder`` does better on the held-out routes.
    """
    from amusic_agents.run_folder import SELECTOR, read_config, write_config

    from amusic_gym.utils.storage import write_whole

    if not is_same(out, folder):
        _refuse_worse(out, folder)
    config = read_config(out)
    config["training"]["warm_start"] = None
    write_whole(folder / SELECTOR, (out / SELECTOR).read_bytes())
    write_config(folder, config)


def _refuse_worse(out: Path, folder: Path) -> None:
    from amusic_agents.config import stored_config
    from amusic_agents.run_folder import SELECTOR

    routes = stored_config(out).held_out
    ours = score(out, routes)
    try:
        theirs = score(folder, routes)
    except (FileNotFoundError, ValueError) as error:  # of another version, say: of no use to anyone
        print(f"No selector to compare with in {folder}: {error}")
        return
    if ours < theirs:
        raise ValueError(
            f"the selector in {folder} reaches a score of {theirs:.4f} on {routes} held-out routes,"
            f" that in {out} only {ours:.4f}; leave out --ship, or delete {folder / SELECTOR} first"
        )


def score(run: Path, routes: int) -> float:
    """Score of a run's selector on held-out routes: true places − λ · compute, per frame.

    Raises:
        FileNotFoundError: if there is no selector.
        ValueError: if it was trained with another version, or is damaged.
    """
    from amusic_agents.evaluation import HeldOut
    from amusic_agents.selector import load_selector

    selector = load_selector(run)
    assert selector.needs.statistic is not None
    return HeldOut(routes, selector.needs.statistic).evaluate(selector, 0).score


def main(arguments: list[str] | None = None) -> None:
    """Parse, train, compare with what ships, and ship where asked."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=destination, required=True, help="run folder")
    add("--timesteps", type=int, default=TIMESTEPS, help=f"of PPO, for belief ({TIMESTEPS})")
    add("--seed", type=int, default=SEED, help=f"({SEED})")
    add("--threads", type=int, default=2, help="that drive; the result is the same (%(default)s)")
    add(
        "--statistic",
        choices=SHIPPED,
        default=SICSettings.statistic,
        help="that it ships for (default: %(default)s)",
    )
    add("--allow-idle", action="store_true", help="the one that may run nothing on a frame")
    add("--ship", action="store_true", help="put the selector into agents/amusic_agents/pretrained")
    given = parser.parse_args(arguments)

    from amusic_agents.config import training_config

    folder = shipped(given.statistic, allow_idle=given.allow_idle)
    config = training_config(
        algorithm=ALGORITHM[given.statistic],
        timesteps=given.timesteps,
        seed=given.seed,
        statistic=given.statistic,
        reward=REWARD,
        threads=given.threads,
        allow_idle=given.allow_idle,
    )
    learn(given.out, config)
    idles = " and may idle" if given.allow_idle else ""
    words = f"the selector that ships for {given.statistic!r}{idles}"
    if not is_same(given.out, folder):
        words = f"not {words}, bit for bit"
    print(f"The selector in {given.out} is {words}")
    if given.ship:
        ship(given.out, folder)


if __name__ == "__main__":
    run(main)
