"""Train the selector that ships, from its seed, and say whether it came out as it ships.

A cascade is chosen for every part of the range of λ, imitated, and the imitation goes on learning
with PPO; all of it on simulated routes. The run folder is ``--out``; ``--ship`` puts its selector
into ``agents/pretrained``. A run that was stopped goes on where it was.
"""

from __future__ import annotations

from pathlib import Path

from _cli import Parser, run

TIMESTEPS = 2_000_000
SEED = 0


def ship(out: Path, folder: Path) -> None:
    """Copy what a selector needs to drive, and where it is from, without a machine's paths."""
    from agents.run_folder import SELECTOR, read_config, write_config
    from amusic_gym.trace import write_whole

    config = read_config(out)
    config["training"]["warm_start"] = None
    write_whole(folder / SELECTOR, (out / SELECTOR).read_bytes())
    write_config(folder, config)


def _finished(out: Path, timesteps: int) -> bool:
    """Whether the folder holds a training that has had its frames."""
    from agents.run_folder import EVALUATIONS

    file = out / EVALUATIONS
    rows = file.read_text("utf-8").split() if file.is_file() else []
    return len(rows) > 1 and int(rows[-1].split(",")[0]) >= timesteps


def main(arguments: list[str] | None = None) -> None:
    """Parse, train, compare with what ships, and ship where asked."""
    parser = Parser(description=(__doc__ or "").splitlines()[0])
    add = parser.add_argument
    add("--out", type=Path, required=True, help="run folder")
    add("--timesteps", type=int, default=TIMESTEPS, help=f"of PPO ({TIMESTEPS})")
    add("--seed", type=int, default=SEED, help=f"({SEED})")
    add("--ship", action="store_true", help="put the selector into agents/pretrained")
    given = parser.parse_args(arguments)

    from _contestants import SHIPPED
    from _train_teacher import make_teacher

    from agents.config import training_config
    from agents.imitation import IMITATION, imitate_then_train
    from agents.run_folder import CONFIG, SELECTOR

    config = training_config(algorithm="imitation+ppo", timesteps=given.timesteps, seed=given.seed)
    if not _finished(given.out, given.timesteps):
        begun = any((given.out / part / CONFIG).exists() for part in (".", IMITATION))
        teacher = make_teacher(given.out / IMITATION, config, resume=begun)
        imitate_then_train(given.out, config, teacher, resume=begun)
    same = (SHIPPED / SELECTOR).is_file() and (
        (SHIPPED / SELECTOR).read_bytes() == (given.out / SELECTOR).read_bytes()
    )
    words = "the selector that ships" if same else "not the selector that ships, bit for bit"
    print(f"The selector in {given.out} is {words}")
    if given.ship:
        ship(given.out, SHIPPED)


if __name__ == "__main__":
    run(main)
