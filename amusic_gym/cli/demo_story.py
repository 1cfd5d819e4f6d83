"""What the demo's numbers say, in plain sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from amusic_gym.evaluation.audit import PARTING
from amusic_gym.evaluation.plots.labels import policy_label
from amusic_gym.evaluation.study import Findings
from amusic_gym.evaluation.study.findings import ahead
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.policies.registry import FRONTS, MAY_IDLE


def best_within(rows: Sequence[Row], compute: float) -> Row:
    """The row of highest AUC at no more compute, of equal ones the cheapest; or just the cheapest.

    AUCs are equal that three digits do not tell apart.
    """
    fitting = [row for row in rows if row["compute"] <= compute]
    if not fitting:
        return min(rows, key=lambda row: row["compute"])
    return max(fitting, key=lambda row: (round(row["auc"], 3), -row["compute"]))


def on_tours(findings: Findings, selectors: Mapping[str, str]) -> list[str]:
    """Every selector against the best of each kind of rival on the tours.

    Args:
        findings: of the study of the tours.
        selectors: name in the study → how a sentence begins.
    """
    points = [row for row in findings.points if row["bank"] == MEAN]
    of = {row["policy"]: row for row in points}
    amusic, same, music = of["amusic"], of["amusic:evidence"], of["music"]
    lines = []
    for name, words in selectors.items():
        own = best_within([row for row in points if row["policy"] == name], same["compute"])
        lines.append(
            f"{words} reaches AUC {own['auc']:.3f} ({_span(own['auc_interval'])}) at"
            f" {own['compute']:.0%} of the compute of all techniques (λ"
            f" {own['compute_weight']:g}). {_standing(findings, own)}"
        )
    lines.append(
        f"A-MuSIC as in the paper: {amusic['auc']:.3f} at {amusic['compute']:.0%}; the same rule on"
        f" the selector's statistic: {same['auc']:.3f} at {same['compute']:.0%}; every technique on"
        f" every frame: {music['auc']:.3f}. In brackets 95 % intervals over {len(findings.routes)}"
        f" tours and {len(findings.settings['seeds'])} draws, of one training; each rival is the"
        " best of its kind on these very tours, which no one would know beforehand."
    )
    if parted := dict.fromkeys(r["front"] for r in findings.audit if r["greatest_gap"] > PARTING):
        lines.append(
            f"Estimated correctness is too high by more than {PARTING:g} on some tour for"
            f" {', '.join(parted)} (study/tables.md)."
        )
    return lines


def _standing(findings: Findings, own: Row) -> str:
    """How a point of a selector stands to the best rival of each kind at no more compute."""
    key = ("bank", "policy", "compute_weight")
    matches = [
        row
        for row in findings.matches
        if all(row[name] == own[name] for name in key) and row["rival"] is not None
    ]
    idle = [row for row in matches if row["kind"] == FRONTS[MAY_IDLE]]
    others = [row for row in matches if row["kind"] != FRONTS[MAY_IDLE]]
    said = f"At no more compute it is {_verdicts(others)}." if others else "Nothing is so cheap."
    if idle:
        said += f" Of rules under which nothing may run on a frame it is {_verdicts(idle)}."
    return said


def _verdicts(matches: Sequence[Row]) -> str:
    groups = {True: "ahead of", None: "level with", False: "behind"}
    parts = []
    for verdict, words in groups.items():
        if named := [_named(row) for row in matches if ahead(row) is verdict]:
            parts.append(f"{words} {', '.join(named)}")
    return "; ".join(parts)


def _named(match: Row) -> str:
    """A rival and what it reaches: "HOG (0.676 at 3%; difference +0.110 to +0.310)"."""
    weight = "" if match["rival_weight"] is None else f", λ {match['rival_weight']:g}"
    spread = match["difference_interval"]
    difference = "" if spread is None else f"; difference {_span(spread, '+')}"
    return (
        f"{policy_label(match['rival'])}{weight} ({match['rival_auc']:.3f} at"
        f" {match['rival_compute']:.0%}{difference})"
    )


def _span(ends: Sequence[float], sign: str = "") -> str:
    return " to ".join(f"{end:{sign}.3f}" for end in ends)


def other(bank: str, rows: Sequence[Row], selector: str) -> str:
    """One sentence on a recording: the trained selector against A-MuSIC."""
    amusic = next(row for row in rows if row["policy"] == "amusic")
    own = best_within([row for row in rows if row["policy"] == selector], amusic["compute"])
    return (
        f"On {bank}, which no training saw, the selector trained here reaches AUC {own['auc']:.3f}"
        f" at {own['compute']:.1%} compute (λ {own['compute_weight']:g}); A-MuSIC"
        f" {amusic['auc']:.3f} at {amusic['compute']:.0%}."
    )
