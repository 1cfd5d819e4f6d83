"""Learning to select from a teacher (DAgger): the student drives, the teacher says what to do.

Ross, Gordon and Bagnell, "A reduction of imitation learning and structured prediction to no-regret
online learning", AISTATS 2011. Here a route is driven by one of the two from its beginning to its
end, because SIC profits from techniques that run many frames in a row.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from amusic_agents.config import TrainingConfig, stored_config
from amusic_agents.dagger import DAgger
from amusic_agents.run_folder import CHECKPOINT
from amusic_agents.selector import load_selector
from amusic_agents.training import bank_folders, begun, refuse_used, train, training_source
from amusic_gym.envs.sources import BankLike, RouteSource
from amusic_gym.policies.protocol import Correction, Needs, Selector

IMITATION = "imitation"
"""Folder of the imitation within a run that goes on with PPO."""


def imitate(
    out: str | Path,
    config: TrainingConfig,
    teacher: Selector,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Selector:
    """Train a selector to do what a teacher does, and keep the best in a run folder.

    Args:
        out: the run folder.
        config: how; ``config.imitation`` above all.
        teacher: says what to do, also on routes that the student drives; one that reads
            ``info["compute_weight"]``, as :class:`amusic_agents.teachers.ByWeight` does, teaches
            every λ.
        banks: banks to drive on; none: simulated routes.
        source: routes to drive on, instead of banks or the default simulation.
        resume: go on after the folder's last whole round, with its configuration and banks, and
            with the same result as without a stop. A finished one is returned as it is.
        progress: whether to show a progress bar.

    Returns:
        The best selector by evaluation on held-out simulated routes.

    Raises:
        FileNotFoundError: if there is nothing to resume, or a bank is missing.
        ValueError: if the folder holds another training or is damaged, or the teacher needs
            another environment.
    """
    out = Path(out)
    with begun(out, config, banks, source, resume) as (config, banks):
        _check_teacher(teacher, config)
        dagger = DAgger(out, config, teacher, source or training_source(config, banks))
        dagger.records.banks = bank_folders(source, banks)
        if resume:
            dagger.restore()
        dagger.write()
        dagger.run(progress)
        return load_selector(out)


def imitate_then_train(
    out: str | Path,
    config: TrainingConfig,
    teacher: Selector,
    *,
    banks: Sequence[BankLike] = (),
    source: RouteSource | None = None,
    resume: bool = False,
    progress: bool = True,
) -> Selector:
    """Imitate a teacher, then train on with PPO from there.

    The imitation's own run folder is ``out/imitation``. The arguments are those of
    :func:`imitate`; good values of ``config`` are those of
    ``amusic_agents.config.training_config("imitation+ppo")``.

    Raises:
        FileNotFoundError: as :func:`imitate` does.
        ValueError: as :func:`imitate` and :func:`amusic_agents.training.train` do.
        KeyboardInterrupt: after saving a checkpoint, if PPO has begun.
    """
    out = Path(out)
    first = out / IMITATION
    if not resume:
        refuse_used(out)
    routes = {"banks": banks, "source": source, "progress": progress}
    imitate(first, config, teacher, resume=resume, **routes)  # type: ignore[arg-type]
    if resume and (out / CHECKPOINT).is_file():
        return train(out, config, resume=True, **routes)  # type: ignore[arg-type]
    if resume:
        config = replace(stored_config(first), timesteps=config.timesteps)
    return train(out, config, warm_start=first, **routes)  # type: ignore[arg-type]


def _check_teacher(teacher: Selector, config: TrainingConfig) -> None:
    needs = teacher.needs
    if needs != Needs(statistic=needs.statistic, carry=needs.carry, discount=needs.discount):
        raise ValueError(
            "the teacher needs more of the environment than a statistic (the re-select bit, idling"
            " or other arguments), which the network cannot learn; give one that does not"
        )
    if needs.statistic not in (None, config.statistic):
        raise ValueError(
            f"the teacher needs the statistic {needs.statistic!r}, the training uses"
            f" {config.statistic!r}; give the same"
        )
    own = Correction.under(teacher, config.statistic, config.carry, config.discount)._asdict()
    for name, value in config.environment().items():
        if own[name] != value:
            raise ValueError(
                f"the teacher needs {name} {own[name]}, the training uses {value}; give the same"
            )
