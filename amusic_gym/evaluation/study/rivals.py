"""Selectors against rules of every kind, each with a grid of settings: the demo and the results."""

from collections.abc import Mapping, Sequence
from pathlib import Path

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.evaluation.contestants import COMPUTE_WEIGHTS
from amusic_gym.evaluation.study.findings import Findings, find
from amusic_gym.evaluation.study.lineup import Lineup
from amusic_gym.evaluation.study.plan import make_plan
from amusic_gym.evaluation.study.run import Report, run
from amusic_gym.evaluation.study.tables import write_markdown
from amusic_gym.routes.motion import RECORDED

DRAWS = 5  # of every policy that draws


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


def rivals_in_motion(techniques: Sequence[str]) -> list[str]:
    """Rules for the statistic `belief`: smaller grids, since there are more drives."""
    return [
        *("amusic", "amusic:evidence", "amusic:belief", "oracle", "voi", "voi:idle"),
        *(f"random:{p}" for p in (0.05, 0.1, 0.2, 0.3, 0.5, 0.7)),
        *(f"periodic:{n}{tail}" for n in (2, 5, 10) for tail in ("", f"/{techniques[-1]}")),
        *(
            f"cascade:{cheap}/{hold}/{doubt}"
            for cheap in (1, 2)
            for hold in (3, 20)
            for doubt in (0.3, 0.5, 0.7, 0.9)
        ),
    ]


def peers(techniques: Sequence[str]) -> list[str]:
    """Peers from the literature; of filters and graphs a grid of windows and sharpnesses."""
    windows = ("2/9", "0/4", "0/2")
    return [
        *(f"raw:{name}" for name in techniques),
        *("mpf", "hmpf", "dynmpf", "switchhit", "plurality", "borda", "hmm", "hmm:0.3/0.02"),
        *(f"xu:{window}/{delta}" for window in windows for delta in (5, 50, 500)),
        *(f"xu:{name}/0/2/50" for name in techniques),
        *(f"lazygraph:{fan_out}/0.7/6" for fan_out in (2, 5, 10)),
        *("lazygraph:5/0.9/6", *(f"lazygraph:{name}/5/0.7/6" for name in techniques)),
    ]


def study_rivals(
    banks: Sequence[ScoreBank],
    selectors: Mapping[str, Sequence[str]],
    out: Path,
    executor: str = "serial",
    *,
    policies: Sequence[str] | None = None,
    statistic: str = SICSettings.statistic,
    conditions: Sequence[str] = (RECORDED,),
    draws: int | None = None,
    report: Report = lambda line: None,
) -> Findings:
    """Selectors against all fixed subsets and rules; ``out`` keeps what is finished.

    The banks have the same techniques and cost model; selectors are given by name, with policies
    for all draws or one for each. The rules are `rivals` unless ``policies`` are given, the draws
    of policies and of motions `DRAWS`. All else is as `make_plan` and `run` take it.
    """
    lineup = Lineup(
        policies=tuple(rivals(banks[0].techniques) if policies is None else policies),
        selectors={name: tuple(runs) for name, runs in selectors.items()},
        all_subsets=True,
        insisted={},
        compute_weights=COMPUTE_WEIGHTS,
    )
    plan = make_plan(
        banks,
        lambda bank: lineup.entrants(bank.techniques),
        statistic=statistic,
        seeds=range(DRAWS if draws is None else draws),
        conditions=conditions,
    )
    findings = find(plan, run(plan, out, executor=executor, report=report))
    findings.write(out)
    write_markdown(findings, out)
    return findings
