"""What the demo's numbers say, in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

Row = Mapping[str, Any]


def best_within(rows: Sequence[Row], policy: str, compute: float) -> Row | None:
    """The row of highest AUC of the policies that start so, at no more compute."""
    fitting = [r for r in rows if r["policy"].startswith(policy) and r["compute"] <= compute]
    return max(fitting, key=lambda row: row["auc"], default=None)


def find(rows: Sequence[Row], policy: str) -> Row:
    """The row of a policy without compute weight."""
    return next(row for row in rows if row["policy"] == policy)


def held_out(mean: Sequence[Row], routes: int) -> list[str]:
    """The selector against A-MuSIC, MuSIC and the fixed subsets on the rendered routes."""
    amusic, music = find(mean, "amusic"), find(mean, "music")
    cheap = best_within(mean, "ppo:", amusic["compute"])
    lines = []
    if cheap is not None:
        subset = best_within(mean, "s", amusic["compute"])  # single: and subset:
        rival = "no fixed subset is that cheap" if subset is None else _against(subset)
        lines.append(
            f"At no more compute than A-MuSIC, on {routes} rendered routes that no training saw:"
            f" the trained selector, at the best of its compute weights, reaches AUC"
            f" {cheap['auc']:.3f} at {cheap['compute']:.0%} of the compute of all techniques;"
            f" {rival}; A-MuSIC itself {amusic['auc']:.3f} at {amusic['compute']:.0%}."
        )
    best = best_within(mean, "ppo:", 1.0)
    if best is not None:
        lines.append(
            f"Running every technique on every frame (MuSIC) gives AUC {music['auc']:.3f}; the"
            f" selector's best is {best['auc']:.3f}, at {best['compute']:.0%} of that compute."
        )
    return lines


def _against(subset: Row) -> str:
    return (
        f"the best fixed subset ({subset['policy']}) {subset['auc']:.3f} at {subset['compute']:.0%}"
    )


def planted(rows: Sequence[Row], frozen: Row, selector: Row) -> str:
    """The selector where the good technique changes, with and without looking."""
    subset = best_within(rows, "s", selector["compute"])
    rest = "no fixed subset is that cheap" if subset is None else f"{subset['auc']:.3f}"
    return (
        f"Where the one good technique changes every 100 frames, the selector reaches AUC"
        f" {selector['auc']:.3f} at {selector['compute']:.0%} compute (λ"
        f" {selector['compute_weight']:g}); the best fixed subset of no more compute: {rest}; the"
        f" selector with its actions frozen to their mean: {frozen['auc']:.3f}."
    )


def other(bank: str, rows: Sequence[Row]) -> str:
    """One sentence on a real or a user's own recording."""
    amusic = find(rows, "amusic")
    cheap = best_within(rows, "ppo:", 0.10)
    if cheap is None:
        cheap = min((r for r in rows if r["policy"].startswith("ppo:")), key=lambda r: r["compute"])
    return (
        f"On {bank}, which no training saw, the selector reaches AUC {cheap['auc']:.3f} at"
        f" {cheap['compute']:.1%} compute (λ {cheap['compute_weight']:g}); A-MuSIC"
        f" {amusic['auc']:.3f} at {amusic['compute']:.0%}."
    )
