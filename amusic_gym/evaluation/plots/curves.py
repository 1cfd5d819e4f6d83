"""Precision-recall curves, and how far estimated correctness can be believed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.audit import held
from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.plots.drawing import GREY, figure_at, only
from amusic_gym.policies.registry import parse
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.colours import technique_colours, tint

GOOD, FIRST_RECALL = 0.5, 0.1
"""AUC of the curves that the axis is fitted to, and the recall from which on."""

SHADES: tuple[Any, ...] = ((0, (1.2, 1.2)), (0, (5, 1.5)), "-")
"""Lines of a selector's least, middle and greatest compute weights."""

BELIEVED, MARKS = ("#0072B2", "#D55E00"), ("o", "s")
"""Colour and mark of the curves of a figure of reliability."""

LEAST = 0.7  # frames at which its bars begin, on a logarithmic scale
FEW = 30  # bins of fewer frames are hollow: their share says little


def precision_recall(traces: Sequence[Trace], path: str | Path) -> Path:
    """Precision-recall curves of several traces of one bank, ordered by AUC.

    Each curve ends in a dot: every frame accepted. A technique keeps its colour, dotted without
    SIC; a selector's curves go from light to dark, and from dots to a line, with its compute
    weight. The axis of precision begins below the curves of at least `GOOD`; others may leave it.
    """
    bank = only({trace.bank for trace in traces}, "bank", "traces")
    colours = _curve_colours(traces)
    with figure_at(path, 7.6, max(4.2, 1.4 + 0.21 * len(traces))) as figure:
        axes = figure.add_subplot()
        drawn, lows = [], [1.0]
        for trace in traces:
            precision, recall = metrics.curve(trace)
            named = parse(trace.policy)
            plain = named.policy.colour is None
            (line,) = axes.plot(
                recall,
                precision,
                color=colours[_identity(trace)],
                linestyle=_line(trace, traces) or ("--" if named.is_variant else named.policy.line),
                linewidth=1.3 if plain else 2.2,
                zorder=2.5 if plain else 3.0,
                marker="o",
                markersize=4.5,
                markevery=[recall.size - 1],
            )
            area = metrics.area(precision, recall)
            drawn.append((area, line, labels.trace_label(trace)))
            if area >= GOOD:  # the first few matches swing to and fro
                lows.append(precision[recall >= FIRST_RECALL].min())
        drawn.sort(key=lambda entry: -entry[0])
        low = min(lows) if drawn[0][0] >= GOOD else 0.0
        margin = max(0.04 * (1.0 - low), 0.002)
        axes.set(xlim=(0, 1.015), ylim=(max(0.0, low - margin), 1.0 + margin))
        axes.set(xlabel="Recall", ylabel="Precision")
        axes.set_title(f"Precision and recall on {labels.bank_label(bank)}")
        axes.grid()
        figure.legend(
            [line for _, line, _ in drawn],
            [f"{area:.3f}  {name}" for area, _, name in drawn],
            title="AUC",
            alignment="left",
            loc="outside right upper",
        )
    return Path(path)


def reliability(
    groups: Mapping[str, Sequence[Trace]],
    path: str | Path,
    *,
    title: str = "Estimated correctness against the truth",
    bins: int = metrics.CALIBRATION_BINS,
) -> Path:
    """Share of right frames against mean p̂, pooled over each group of traces, above a histogram.

    ``groups``, two at most: name → traces. Frames without an estimate are left out, and it is a
    ValueError where a group has none. No intervals: frames of one drive are not independent.
    """
    with figure_at(path, 6.4, 7.0) as figure:
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.4, 1])
        upper.plot([0, 1], [0, 1], color=GREY, linestyle="--", linewidth=1, label="perfect")
        most = 10
        for i, (name, traces) in enumerate(groups.items()):
            correct, estimate = held(*traces)
            if not estimate.size:
                raise ValueError(
                    "no trace holds an estimate of correctness; give traces with p_correct"
                )
            predicted, observed, counts = metrics.reliability(correct, estimate, bins)
            look: dict[str, Any] = {"color": BELIEVED[i], "marker": MARKS[i]}
            for shown, more in (
                (counts > 0, {"label": f"{name}: {_quality(correct, estimate, bins)}"}),
                ((counts > 0) & (counts < FEW), {"linestyle": "none", "markerfacecolor": "white"}),
            ):
                upper.plot(predicted[shown], observed[shown], **look, **more)
            width = 0.8 / bins / len(groups)
            aside = (i - (len(groups) - 1) / 2.0) * width
            middles = (np.arange(bins) + 0.5) / bins
            bars = lower.bar(middles + aside, counts, width, color=BELIEVED[i])
            words = [str(count or "") for count in counts]
            lower.bar_label(bars, words, padding=2, rotation=90, fontsize=7.5)
            most = max(most, counts.max())
        upper.plot([], [], "o", color=GREY, markerfacecolor="white", label=f"under {FEW} frames")
        upper.set(ylabel="Share of frames that are right", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02))
        upper.set_title(title)
        upper.grid()
        lower.set_yscale("log")
        lower.set_ylim(LEAST, most * (most / LEAST) ** 0.4)  # room for the numbers over the bars
        lower.yaxis.set_major_formatter("{x:g}")
        lower.set(xlabel="Estimated correctness p̂", ylabel="Frames in the bin")
        figure.legend(loc="outside lower left", fontsize=8)
    return Path(path)


def _identity(trace: Trace) -> tuple[str, float | None]:
    return trace.policy, trace.compute_weight


def _place(trace: Trace, traces: Sequence[Trace]) -> float | None:
    """Where its λ stands among those of the policy, in [0, 1]; None where it is the only one."""
    weights = sorted(w for p, w in map(_identity, traces) if p == trace.policy and w is not None)
    if trace.compute_weight is None or len(weights) < 2:
        return None
    return weights.index(trace.compute_weight) / (len(weights) - 1)


def _line(trace: Trace, traces: Sequence[Trace]) -> Any:
    """The line of a selector's curve by its compute weight; None for other policies."""
    place = _place(trace, traces)
    return None if place is None else SHADES[round(place * (len(SHADES) - 1))]


def _curve_colours(traces: Sequence[Trace]) -> dict[tuple[str, float | None], Any]:
    """A colour per trace: the technique's, the policy's, or a shade of the selector's."""
    techniques = technique_colours(labels.all_techniques(t.techniques for t in traces))
    swept = dict.fromkeys(t.policy for t in traces if t.compute_weight is not None)
    sweeps = {policy: labels.sweep_colour(i) for i, policy in enumerate(swept)}
    colours: dict[tuple[str, float | None], Any] = {}
    for trace in traces:
        policy, argument = parse(trace.policy)
        if trace.compute_weight is not None:
            place = _place(trace, traces) or 0.0
            colours[_identity(trace)] = tint(sweeps[trace.policy], 0.45 + 0.55 * place)
        else:
            colours[_identity(trace)] = policy.colour or techniques.get(argument or "", GREY)
    return colours


def _quality(correct: NDArray[np.bool_], estimate: NDArray[np.float64], bins: int) -> str:
    ranked = metrics.auroc(correct, estimate)
    words = (
        f"AUROC {'undefined' if np.isnan(ranked) else f'{ranked:.3f}'}",
        f"Brier {metrics.brier(correct, estimate):.3f}",
        f"calibration error {metrics.calibration_error(correct, estimate, bins):.3f}",
        f"{correct.size} frames",
    )
    return "  ·  ".join(words)
