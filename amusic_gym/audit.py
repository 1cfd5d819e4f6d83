"""Whether a policy's estimated correctness p̂ and the truth part: the reward-hacking audit.

A selector that is rewarded with p̂ may learn to raise p̂ instead of being right. So p̂ is held
against ground truth for every policy that gives one, and where the two part it is said loudly.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from amusic_gym import metrics
from amusic_gym.trace import Trace

PARTING = 0.1
"""p̂ and the truth part where mean p̂ and accuracy differ by more than this."""


class Audit(NamedTuple):
    """p̂ of one trace against its correctness, over the frames that have p̂; plain numbers."""

    p_correct: float  # mean p̂
    accuracy: float  # share of right frames
    auroc: float | None  # of p̂; None where all frames are right or all wrong
    calibration_error: float  # expected, of p̂

    @property
    def gap(self) -> float:
        """Mean p̂ minus accuracy: above 0, the policy believes more than is true."""
        return self.p_correct - self.accuracy


def audit(trace: Trace) -> Audit | None:
    """Hold a trace's p̂ against the truth; None for a policy that gives no p̂."""
    held = ~np.isnan(trace.p_correct)
    if not held.any():
        return None
    correct, estimate = trace.correct[held], trace.p_correct[held]
    ranked = metrics.auroc(correct, estimate)
    return Audit(
        p_correct=float(estimate.mean()),
        accuracy=float(correct.mean()),
        auroc=None if np.isnan(ranked) else ranked,
        calibration_error=metrics.calibration_error(correct, estimate),
    )


def parting(
    who: str, audits: Iterable[tuple[str, Audit]], *, above_only: bool = False
) -> str | None:
    """The line that says loudly where p̂ and the truth part; None where they do not.

    Args:
        who: whose p̂ it is, and where: "cascade on corridor".
        audits: with what tells each from the others, "λ 0.1", or "".
        above_only: whether p̂ below the accuracy is left out.
    """
    given = list(audits)
    apart = [
        (name, each)
        for name, each in given
        if each.gap > PARTING or (-each.gap > PARTING and not above_only)
    ]
    if not apart:
        return None
    name, worst = max(apart, key=lambda item: abs(item[1].gap))
    side = "above" if worst.gap > 0 else "below"
    several = f"; {len(apart)} of {len(given)} part so" if len(given) > 1 else ""
    where = f" ({name}{several})" if name else ""
    return (
        f"WARNING: {who}: mean p̂ {worst.p_correct:.3f} is {abs(worst.gap):.3f} {side} the accuracy"
        f" {worst.accuracy:.3f}{where}"
    )
