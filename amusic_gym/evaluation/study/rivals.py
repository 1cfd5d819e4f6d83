"""Selectors against rules of every kind, each with a grid of settings: the demo and the results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.evaluation.contestants import COMPUTE_WEIGHTS
from amusic_gym.evaluation.study.findings import Findings, find
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.evaluation.study.plan import make_plan
from amusic_gym.evaluation.study.run import run
from amusic_gym.evaluation.study.tables import write_markdown

DRAWS = 5
"""Of every policy that draws."""


def rivals(techniques: Sequence[str]) -> list[str]:
    """Rules of every kind, each with a small grid of settings."""
    grid = [f"{cheap}/{hold}" for cheap in (1, 2) for hold in (3, 10, 20, 40)]
    random = [f"random:{p}" for p in (0.05, 0.1, 0.2, 0.3, 0.5, 0.7)]
    periodic = [
        f"periodic:{n}{tail}"
        for n in (2, 3, 5, 10, 20)
        for tail in ("", *(f"/{name}{end}" for name in techniques for end in ("", "/idle")))
    ]
    return [
        *("amusic", "amusic:evidence", "oracle", "voi", "voi:idle"),
        *random,
        *(f"{each}/idle" for each in random),
        *periodic,
        *(f"cascade:{of}/{doubt}" for of in grid for doubt in (0.3, 0.5, 0.7, 0.9)),
    ]


def study_rivals(
    banks: Sequence[ScoreBank],
    selectors: Mapping[str, Sequence[str]],
    out: Path,
    executor: str = "serial",
) -> Findings:
    """Selectors against all fixed subsets and `rivals`; ``out`` keeps what is finished.

    Args:
        banks: with the same techniques and cost model.
        selectors: name → policies, one for all draws or one for each.
        out: the folder.
        executor: as `run` takes it.
    """
    lineup = Lineup(
        policies=tuple(rivals(banks[0].techniques)),
        selectors={name: tuple(runs) for name, runs in selectors.items()},
        all_subsets=True,
        insisted={},
        compute_weights=COMPUTE_WEIGHTS,
    )
    plan = make_plan(
        banks,
        lambda bank: lineup.entrants(bank.techniques),
        seeds=range(DRAWS),
        conditions=("recorded",),
    )
    findings = find(plan, run(plan, out, executor=executor, report=lambda _: None))
    findings.write(out)
    write_markdown(findings, out)
    return findings
