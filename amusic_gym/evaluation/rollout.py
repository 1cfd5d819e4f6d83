"""Runs policies on banks and live routes and records traces."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.envs.sources import Recording
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Correction, Localiser, Policy, Rows, Selector, highest_z
from amusic_gym.policies.trace import Trace

INFOS = {
    "predictions": "prediction",
    "confidence": "confidence",
    "similarity": "similarity",
    "p_correct": "p_correct",
    "chosen": "technique",
    "ran": "ran",
}
"""Argument of `Trace.join` -> key of the environment's infos, and attribute of a live frame."""


@dataclass(frozen=True)
class Job:
    """One episode to run: a bank or live route and, for policies that have one, the weight λ."""

    bank: Recording
    compute_weight: float | None = None


def rollout(
    policy: Policy,
    bank: Recording,
    *,
    name: str,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
    compute_weight: float | None = None,
) -> Trace:
    """Run a policy over a whole bank, or a live route of known length and ground truth.

    Args:
        policy: selector or localiser.
        bank: the route.
        name: the policy's name in the trace.
        statistic: SIC's statistic, unless the policy needs its own.
        carry: whether places are carried on as candidates, unless the policy needs its own; None:
            as the statistic has it.
        discount: whether MuSIC discounts alike rows; as `carry`.
        compute_weight: λ; None for policies that have none.
    """
    how = Correction.under(policy, statistic, carry, discount)
    return _run(policy, [Job(bank, compute_weight)], name, how)[0]


def rollouts(
    policy: Policy,
    jobs: Sequence[Job],
    *,
    name: str,
    statistic: str = SICSettings.statistic,
    carry: bool | None = None,
    discount: bool | None = None,
) -> list[Trace]:
    """Run a policy on several routes, a selector on all banks at once; live routes one by one.

    Raises:
        ValueError: if a selector was made for another statistic, a score is not finite, or the
            length or ground truth of a live route is not known.
    """
    return _run(policy, jobs, name, Correction.under(policy, statistic, carry, discount))


def _run(policy: Policy, jobs: Sequence[Job], name: str, how: Correction) -> list[Trace]:
    if isinstance(policy, Selector) and not any(isinstance(j.bank, LiveRoute) for j in jobs):
        return _select(policy, jobs, name, how)
    return [_one(policy, job, name, how) for job in jobs]


def _one(policy: Policy, job: Job, name: str, how: Correction) -> Trace:
    if isinstance(job.bank, LiveRoute):
        return _navigate(policy, job.bank, job.compute_weight, name, how)
    if isinstance(policy, Selector):
        return _select(policy, [job], name, how)[0]
    return _localise(policy, job.bank, name)


def _navigate(
    policy: Policy, route: LiveRoute, compute_weight: float | None, name: str, how: Correction
) -> Trace:
    """Drive along a live route and keep everything but the images."""
    from amusic_gym.live.navigation import navigate

    attributes = {**INFOS, "late_runs": "late_runs", "selections": "selection"}
    columns: dict[str, list[Any]] = {column: [] for column in attributes}
    options = how._asdict() if isinstance(policy, Selector) else {}
    for result in navigate(policy, route, compute_weight=compute_weight, **options):
        for column, attribute in attributes.items():
            columns[column].append(getattr(result, attribute))
    estimates = columns.pop("p_correct")
    if isinstance(policy, Selector):
        columns["p_correct"] = estimates
    else:
        compute_weight = None
    return Trace.join(
        route,
        policy=name,
        statistic=how.statistic,
        carry=how.carry,
        compute_weight=compute_weight,
        **columns,
    )


def _localise(policy: Localiser, bank: ScoreBank, name: str) -> Trace:
    """Let a localiser walk through a bank, charging the rows it asks for."""
    predictions = np.full(bank.queries, -1)
    confidence, similarity = np.zeros((2, bank.queries))
    ran = np.zeros((bank.queries, len(bank.techniques)), np.bool_)
    policy.reset(bank.references, len(bank.techniques))
    for frame in range(bank.queries):
        rows: Rows = {}

        def run(technique: int, frame: int = frame, rows: Rows = rows) -> NDArray[np.float32]:
            ran[frame, technique] = True
            rows[technique] = row = bank.row(technique, frame)
            if not (row < np.inf).all():
                raise ValueError(
                    f"score bank {bank.name!r}: NaN or infinite score of technique"
                    f" {bank.techniques[technique]!r} at frame {frame}; mend the scores and write"
                    " the bank again"
                )
            return row

        place, confidence[frame] = policy.locate(frame, run)
        predictions[frame], similarity[frame] = place, highest_z(rows.values(), place)
    return Trace.join(
        bank,
        predictions=predictions,
        confidence=confidence,
        similarity=similarity,
        ran=ran,
        policy=name,
        statistic="none",
    )


def _select(
    policy: Selector, jobs: Sequence[Job], policy_name: str, how: Correction
) -> list[Trace]:
    from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv

    needs = policy.needs
    env = TechniqueSelectionVectorEnv(
        len(jobs),
        [job.bank for job in jobs],
        slots=max(len(job.bank.techniques) for job in jobs),
        reselection=needs.reselection,
        coverage=needs.coverage,
        allow_idle=needs.allow_idle,
        **how._asdict(),
        **needs.extra,
    )
    weights = np.array([1.0 if j.compute_weight is None else j.compute_weight for j in jobs])
    options = {"bank": np.arange(len(jobs)), "start": 0, "compute_weight": weights}
    observation, info = env.reset(options=options)
    policy.reset(np.ones(len(jobs), np.bool_))
    frames: list[dict[str, Any]] = []  # (N, ...) by argument of `Trace.join`
    for _ in range(max(job.bank.queries or 0 for job in jobs)):
        observation, _, _, _, info = env.step(policy.act(observation, info))
        done = {name: info[key] for name, key in INFOS.items()}
        if selection := info.get("selection"):
            done |= {"late_runs": selection["late_runs"], "selections": selection["happened"]}
        frames.append(done)
    columns = {name: np.stack([frame[name] for frame in frames]) for name in frames[0]}
    traces = []
    for i, job in enumerate(jobs):
        own = {name: column[: job.bank.queries, i] for name, column in columns.items()}
        for name in own.keys() & {"ran", "late_runs"}:
            own[name] = own[name][:, : len(job.bank.techniques)]
        traces.append(
            Trace.join(
                job.bank,
                policy=policy_name,
                statistic=how.statistic,
                carry=how.carry,
                compute_weight=job.compute_weight,
                **own,
            )
        )
    return traces
