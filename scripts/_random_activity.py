"""Drives under random activity, and how well p̂ and the techniques' statistics did on them."""

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain
from typing import Any, NamedTuple

import numpy as np
from amusic_baselines import make_policy
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.audit import audit, held, ranking
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.protocol import Context
from amusic_gym.policies.trace import Trace
from amusic_gym.routes.retime import retime

RATES = (0.1, 0.3, 0.6, 1.0)
"""With one of these chances, drawn for the whole drive, each technique runs on each frame."""

BINS = 10  # of the calibration error and of the figure
SURE = 0.9  # a place of this p̂ or more is one that somebody may act on

TRACED = ("confidence", "similarity", "p_correct", "ran")
RECORDED, RETIMED = "as recorded", "re-timed"
POOLED = "pooled"

Row = dict[str, Any]


class Drive(NamedTuple):
    """One drive of Q frames with T techniques."""

    bank: str  # name of the recording
    timing: str  # RECORDED or RETIMED
    trace: Trace  # of the fused prediction
    right: NDArray[np.bool_]  # (Q, T) the technique's own place is a true one
    statistic: NDArray[np.float64]  # (Q, T) its own; both mean something where it ran only


def random_drives(bank: ScoreBank, statistic: str, retimed: int) -> Iterator[Drive]:
    """A bank as recorded, then re-timed with the seeds from 0, so many of each, at least one.

    A re-timed drive has the activity of the recorded one of the same number.
    """
    for seed in range(max(1, retimed)):
        yield _drive(bank, bank.name, RECORDED, statistic, seed)
    for seed in range(retimed):
        yield _drive(retime(bank, seed), bank.name, RETIMED, statistic, seed)


def _drive(bank: ScoreBank, name: str, timing: str, statistic: str, seed: int) -> Drive:
    rate = np.random.default_rng([seed, 1]).choice(RATES)  # apart from the stream of the runs
    policy_name = f"random:{rate}"
    policy: Any = make_policy(policy_name, Context.of(bank, statistic=statistic, seed=seed))
    # An empty action runs the cheapest technique, so that at least one always runs.
    env = TechniqueSelectionVectorEnv(1, bank, statistic=statistic)
    observation, info = env.reset(options={"start": 0})
    infos = []
    for _ in range(bank.queries):
        observation, _, _, _, info = env.step(policy.act(observation, info))
        infos.append(info)
    seen: dict[str, Any] = {
        key: np.stack([info[key][0] for info in infos])
        for key in ("prediction", *TRACED, "place", "statistic")
    }
    trace = Trace.join(
        bank,
        predictions=seen["prediction"],
        **{key: seen[key] for key in TRACED},
        policy=policy_name,
        statistic=statistic,
    )
    right = np.stack([bank.truth.correct(places) for places in seen["place"].T], axis=1)
    return Drive(name, timing, trace, right, seen["statistic"])


def held_against_truth(banks: Sequence[Sequence[Drive]]) -> dict[str, Any]:
    """What the drives show, per bank and pooled, as recorded and re-timed.

    Returns:
        ``{"fused": [...], "techniques": [...], "reliability": {timing: ...}}``, plain values that
        ``json.dump`` takes; the reliability is that of all banks, None in empty bins.
    """
    fused: list[Row] = []
    techniques: list[Row] = []
    for drives in banks:
        for timing, group in by_timing(drives).items():
            which = {"bank": group[0].bank, "timing": timing}
            fused.append({**which, **_fused(group)})
            techniques += [{**which, **row} for row in _own(group)]
    pooled = by_timing(chain.from_iterable(banks))
    fused += [{"bank": POOLED, "timing": timing, **_fused(g)} for timing, g in pooled.items()]
    curves = {timing: _curve(group) for timing, group in pooled.items()}
    return {"fused": fused, "techniques": techniques, "reliability": curves}


def by_timing(drives: Iterable[Drive]) -> dict[str, list[Drive]]:
    """The drives as recorded, and those re-timed."""
    groups: dict[str, list[Drive]] = {}
    for drive in drives:
        groups.setdefault(drive.timing, []).append(drive)
    return groups


def _fused(drives: Sequence[Drive]) -> Row:
    traces = [drive.trace for drive in drives]
    correct, estimate = held(*traces)
    sure = estimate >= SURE
    away = ~np.concatenate([trace.has_place for trace in traces])
    measured = audit(*traces, bins=BINS)
    assert measured is not None  # every drive gives p̂
    return {
        "drives": len(traces),
        "frames": int(correct.size),
        **measured._asdict(),
        "brier": metrics.brier(correct, estimate),
        "right_of_sure": float(correct[sure].mean()) if sure.any() else None,
        "sure_of_away": float(sure[away].mean()) if away.any() else None,
    }


def _own(drives: Sequence[Drive]) -> Iterator[Row]:
    """A row per technique that ran, its frames of several drives of a bank taken together."""
    ran = np.concatenate([drive.trace.ran for drive in drives])
    right = np.concatenate([drive.right for drive in drives])
    statistic = np.concatenate([drive.statistic for drive in drives])
    for t, name in enumerate(drives[0].trace.techniques):
        on = ran[:, t]
        if on.any():
            yield {"technique": name, **ranking(right[on, t], statistic[on, t])._asdict()}


def _curve(drives: Sequence[Drive]) -> dict[str, list[Any]]:
    curve = metrics.reliability(*held(*(drive.trace for drive in drives)), BINS)
    return {
        name: [None if v != v else v for v in values.tolist()]  # v != v: nan
        for name, values in curve._asdict().items()
    }


def tables(report: dict[str, Any]) -> list[Table]:
    """The report of :func:`held_against_truth` as tables."""
    heads = {
        "frames": "frames",
        "accuracy": "right",
        "p_correct": "mean p̂",
        "auroc": "AUROC",
        "calibration_error": f"calibration error, {BINS} bins",
        "brier": "Brier",
        "right_of_sure": f"right where p̂ ≥ {SURE}",
        "sure_of_away": f"p̂ ≥ {SURE} where no place is true",
    }
    fused = [
        [row["bank"], row["timing"], *(_cell(row[name]) for name in heads)]
        for row in report["fused"]
    ]
    own = [
        [row["bank"], row["timing"], row["technique"]]
        + [_cell(row[name]) for name in ("frames", "wrong", "auroc")]
        for row in report["techniques"]
    ]
    chances = ", ".join(f"{rate:g}" for rate in RATES)
    return [
        Table(
            "p̂ of the fused prediction under random activity",
            ["bank", "drive", *heads.values()],
            fused,
            f"On each frame each technique runs with a chance drawn for the drive: {chances}; at "
            "least the cheapest. A frame counts once in each drive; as recorded, all drives at "
            "chance 1 are the same.",
            words=2,
        ),
        Table(
            "Each technique's own statistic, for its own place being right",
            ["bank", "drive", "technique", "frames it ran on", "wrong", "AUROC"],
            own,
            words=3,
        ),
    ]


def _cell(value: float | None) -> str:
    return "-" if value is None else str(value) if isinstance(value, int) else f"{value:.3f}"
