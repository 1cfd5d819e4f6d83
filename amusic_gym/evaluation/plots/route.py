"""Which techniques ran along the route, and which were trusted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.evaluation import metrics
from amusic_gym.evaluation.plots import labels
from amusic_gym.evaluation.plots.drawing import GREY, INK, figure_at, only, percent
from amusic_gym.policies.trace import Trace
from amusic_gym.utils.colours import (
    CORRECT_COLOUR,
    NEUTRAL_COLOUR,
    WRONG_COLOUR,
    ink_on,
    technique_colours,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

LEAST_SHARE_NAMED = 0.06  # narrower bar segments carry no number


def selections(
    traces: Sequence[Trace], path: str | Path, *, parts: Sequence[tuple[int, str]] = ()
) -> Path:
    """Which techniques ran along the route, a panel per trace.

    One lane per technique, filled where it ran on the frame, hatched where it ran after the fact;
    lines at selections; the share of frames on the right; below, where the place was wrong. Dotted
    lines part the ``parts`` of the route, given by first frame and name.
    """
    bank = only({trace.bank for trace in traces}, "bank", "traces")
    lanes = [len(trace.techniques) for trace in traces]
    heights = [0.65 + 0.26 * (count + 1) for count in lanes]
    colours = technique_colours(labels.all_techniques(t.techniques for t in traces))
    with figure_at(path, 9.0, 0.9 + sum(heights)) as figure:
        panels = figure.subplots(len(traces), 1, sharex=True, squeeze=False, height_ratios=heights)[
            :, 0
        ]
        for axes, trace in zip(panels, traces, strict=True):
            _draw_lanes(axes, trace, colours)
            axes.set_title(_headline(trace), fontsize=9.5)
            axes.set_title("share", loc="right", fontsize=8, x=1.045, color=GREY)
        figure.suptitle(f"Techniques run along {labels.bank_label(bank)}", x=0.01, ha="left")
        named = ", ".join(f"from {first}: {name}" for first, name in parts)
        panels[-1].set_xlabel(f"Frame; {named}" if parts else "Frame")
        for axes in panels:
            for first, _ in parts[1:]:
                axes.axvline(first - 0.5, color=INK, linestyle=":", linewidth=1.4)
        figure.legend(
            handles=_lane_legend(traces),
            loc="outside lower center",
            ncols=6,
            handlelength=1.6,
            columnspacing=1.4,
        )
    return Path(path)


def shares(traces: Sequence[Trace], path: str | Path) -> Path:
    """Which technique MuSIC trusted, as a share of frames, a bar per trace.

    Give MuSIC's trace on each bank; frames on which none was trusted are grey.
    """
    only({trace.policy for trace in traces}, "policy", "traces")
    names = labels.all_techniques(trace.techniques for trace in traces)
    colours = technique_colours(names)
    with figure_at(path, 8.6, max(1.0 + 0.42 * len(traces), 0.4 + 0.2 * len(names))) as figure:
        axes = figure.add_subplot()
        left = np.zeros(len(traces))
        for name in (*names, None):
            width = np.array([_share(trace, name) for trace in traces])
            if name is None and not width.any():
                continue
            colour = NEUTRAL_COLOUR if name is None else colours[name]
            bars = axes.barh(range(len(traces)), width, 0.66, left, color=colour)
            bars.set_label(labels.legend_name(name or "none"))
            named = [f"{w:.0%}" if w >= LEAST_SHARE_NAMED else "" for w in width]
            axes.bar_label(bars, named, label_type="center", color=ink_on(colour), fontsize=7.5)
            left += width
        axes.set_yticks(range(len(traces)), [labels.bank_label(trace.bank) for trace in traces])
        axes.invert_yaxis()
        axes.set(xlim=(0, 1), xlabel="Share of frames")
        axes.xaxis.set_major_formatter(percent)
        axes.spines["left"].set_visible(False)
        axes.tick_params(axis="y", length=0)
        axes.set_title(f"Which technique {labels.policy_label(traces[0].policy)} trusts")
        figure.legend(loc="outside right upper", handlelength=1.2)
    return Path(path)


def _draw_lanes(axes: Axes, trace: Trace, colours: Mapping[str, str]) -> None:
    """Lane 0 on top; below the last one, the strip of right and wrong."""
    late = trace.late_frames()  # (Q, T)
    count = len(trace.techniques)
    for lane, name in enumerate(trace.techniques):
        box, colour = (lane - 0.38, 0.76), colours[name]
        axes.broken_barh(_spans(trace.ran[:, lane]), box, facecolor=colour, linewidth=0)
        after = axes.broken_barh(_spans(late[:, lane]), box, facecolor="#F4F4F4", linewidth=0)
        after.set(hatch="//////", edgecolor=colour)
        axes.text(1.008, lane, f"{trace.ran[:, lane].mean():.0%}", **_beside(axes), color=INK)
    strip = (count - 0.3, 0.6)
    wrong = trace.has_place & ~trace.correct
    for frames, colour in (
        (trace.correct, CORRECT_COLOUR),
        (wrong, WRONG_COLOUR),
        (~trace.has_place, NEUTRAL_COLOUR),
    ):
        axes.broken_barh(_spans(frames), strip, facecolor=colour, linewidth=0)
    axes.text(1.008, count, f"{trace.correct.mean():.0%}", **_beside(axes), color=INK)
    starts = np.flatnonzero(trace.selections) - 0.5
    width = np.clip(22.0 / max(1, starts.size), 0.35, 1.1)  # many lines would hide the lanes
    axes.vlines(starts, -0.55, count - 0.42, color=INK, lw=float(width))
    axes.set(ylim=(count + 0.4, -0.6), xlim=(-0.5, trace.queries - 0.5))
    axes.set_yticks(range(count + 1), [*trace.techniques, "correct"])
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)


def _beside(axes: Axes) -> dict[str, Any]:
    """Text properties of a number to the right of its lane."""
    return {"transform": axes.get_yaxis_transform(), "va": "center", "fontsize": 8}


def _spans(frames: NDArray[np.bool_]) -> list[tuple[float, float]]:
    """(start, length) of each run of frames, frame q reaching from q - 0.5 to q + 0.5."""
    edges = np.flatnonzero(np.diff(frames, prepend=False, append=False))
    return [(a - 0.5, float(b - a)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _headline(trace: Trace) -> str:
    words = [
        f"AUC {metrics.area(*metrics.curve(trace)):.3f}",
        f"compute {metrics.compute(trace):.0%}",
        f"PTR {metrics.ptr(trace):.2f}",
    ]
    if trace.selections.any():
        words.append(f"re-selections {metrics.reselections(trace)}")
    return f"{labels.trace_label(trace)}:  " + "  ·  ".join(words)


def _lane_legend(traces: Sequence[Trace]) -> list[Artist]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Artist] = [Patch(facecolor=GREY, label="ran on the frame")]
    if any(trace.late_runs.any() for trace in traces):
        after = Patch(
            facecolor="#F4F4F4", edgecolor=GREY, hatch="//////", label="ran after the fact"
        )
        entries.append(after)
    if any(trace.selections.any() for trace in traces):
        line = Line2D([], [], color=INK, lw=1.1, marker="|", ls="", ms=11, label="(re-)selection")
        entries.append(line)
    entries.append(Patch(facecolor=CORRECT_COLOUR, label="right place"))
    entries.append(Patch(facecolor=WRONG_COLOUR, label="wrong place"))
    if not all(trace.has_place.all() for trace in traces):
        entries.append(Patch(facecolor=NEUTRAL_COLOUR, label="no true place"))
    return entries


def _share(trace: Trace, name: str | None) -> float:
    """Share of frames on which the technique of that name (None: no technique) was trusted."""
    if name is not None and name not in trace.techniques:
        return 0.0
    index = -1 if name is None else trace.techniques.index(name)
    return float((trace.chosen == index).mean())
