"""Whether a policy's estimated correctness p̂ and the truth part: the reward-hacking audit.

A selector that is rewarded with p̂ may learn to raise p̂ instead of being right. So p̂ is held
against ground truth for every policy that gives one, and where the two part it is said loudly.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from amusic_gym.evaluation import metrics
from amusic_gym.policies.trace import Trace

PARTING = 0.1  # p̂ and the truth part where mean p̂ and accuracy differ by more than this


class Audit(NamedTuple):
    """p̂ against correctness, over the frames that have p̂; plain numbers."""

    p_correct: float  # mean p̂
    accuracy: float  # share of right frames
    auroc: float | None  # of p̂; None where all frames are right or all wrong
    calibration_error: float  # expected, of p̂

    @property
    def gap(self) -> float:
        """Mean p̂ minus accuracy: above 0, the policy believes more than is true."""
        return self.p_correct - self.accuracy


def held(*traces: Trace) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Correctness and p̂, both (n,), of the frames that have p̂, of all traces in their order."""
    correct = np.concatenate([trace.correct for trace in traces])
    estimate = np.concatenate([trace.p_correct for trace in traces])
    given = ~np.isnan(estimate)
    return correct[given], estimate[given]


def audit(*traces: Trace, bins: int = metrics.CALIBRATION_BINS) -> Audit | None:
    """Hold p̂ of one trace, or of several pooled, against the truth; None where there is no p̂."""
    correct, estimate = held(*traces)
    if not correct.size:
        return None
    ranked = metrics.auroc(correct, estimate)
    return Audit(
        p_correct=float(estimate.mean()),
        accuracy=float(correct.mean()),
        auroc=None if np.isnan(ranked) else ranked,
        calibration_error=metrics.calibration_error(correct, estimate, bins),
    )


def parting(
    who: str, audits: Iterable[tuple[str, Audit]], *, above_only: bool = False
) -> str | None:
    """The line that says loudly where p̂ and the truth part; None where they do not.

    ``who`` is as in "cascade on corridor", what comes with an audit as in "λ 0.1", or "". With
    ``above_only`` p̂ below the accuracy is left out.
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
