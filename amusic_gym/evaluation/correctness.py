"""How far SIC-estimated correctness p̂ can be believed, against ground truth."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.trace import Trace

MEASURES = ("frames", "accuracy", "auroc", "brier", "brier_of_accuracy", "calibration_error")


def assess(traces: Sequence[Trace]) -> dict[str, Any]:
    """Quality of p̂ over traces, one per technique and bank, pooled and within each.

    ``brier_of_accuracy`` is the Brier score of saying each trace's own mean accuracy on all its
    frames, which an estimate must beat. ``within`` is the mean of the traces' AUROC, of those that
    have right and wrong frames. AUROC is None where there is none.

    Returns:
        ``{"pooled": measures, "within": {...}, "techniques": [{"bank", "technique", measures}]}``,
        plain values that ``json.dump`` takes.

    Raises:
        ValueError: for no trace, or one without p̂.
    """
    if not traces:
        raise ValueError("no trace to assess; give at least one")
    for trace in traces:
        if np.isnan(trace.p_correct).any():
            raise ValueError(
                f"the trace of {trace.policy} on bank {trace.bank!r} has no estimated correctness; "
                "give traces of policies that drive the environment"
            )
    techniques = [
        {"bank": trace.bank, "technique": trace.policy.partition(":")[2], **_measures([trace])}
        for trace in traces
    ]
    ranked = [part["auroc"] for part in techniques if part["auroc"] is not None]
    within = {
        "auroc": float(np.mean(ranked)) if ranked else None,
        "least_auroc": min(ranked, default=None),
        "techniques": len(ranked),
    }
    return {"pooled": _measures(traces), "within": within, "techniques": techniques}


def _measures(traces: Sequence[Trace]) -> dict[str, Any]:
    correct = np.concatenate([trace.correct for trace in traces])
    estimate = np.concatenate([trace.p_correct for trace in traces])
    accuracy = np.concatenate([np.full(t.queries, t.correct.mean()) for t in traces])
    auroc = metrics.auroc(correct, estimate)
    return {
        "frames": int(correct.size),
        "accuracy": float(correct.mean()),
        "auroc": None if np.isnan(auroc) else auroc,
        "brier": metrics.brier(correct, estimate),
        "brier_of_accuracy": metrics.brier(correct, accuracy),
        "calibration_error": metrics.calibration_error(correct, estimate),
    }


def table(report: Mapping[str, Any]) -> str:
    """The report of :func:`assess` as text."""
    heads = ["bank", "technique", *(name.replace("_", " ") for name in MEASURES)]
    parts = [*report["techniques"], {"bank": "pooled", "technique": "", **report["pooled"]}]
    return Table("", heads, [_cells(part) for part in parts], words=2).text()


def _cells(part: Mapping[str, Any]) -> list[str]:
    values = [part[name] for name in MEASURES[1:]]
    numbers = ["-" if value is None else f"{value:.4f}" for value in values]
    return [part["bank"], part["technique"], str(part["frames"]), *numbers]
