"""The page of a study."""

from pathlib import Path

from amusic_gym.evaluation.audit import PARTING
from amusic_gym.evaluation.figures import headline
from amusic_gym.evaluation.plots.labels import policy_label
from amusic_gym.evaluation.report import write_report
from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.figures import draw
from amusic_gym.evaluation.study.findings import Findings
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.evaluation.study.tables import audit_table
from amusic_gym.evaluation.tables import Table
from amusic_gym.policies.registry import MARK


def write_page(findings: Findings, folder: str | Path) -> Path:
    """Draw the figures, and write ``index.html``, whose script draws the fronts itself."""
    draw(findings, folder)
    rows = page_rows(findings)
    shown = sorted({row["policy"] for row in rows})
    return write_report(
        Path(folder) / "index.html",
        title=f"{len(shown)} policies on {len(findings.routes)} routes",
        sentences=[headline([row for row in rows if row["bank"] == rows[0]["bank"]])],
        rows=rows,
        below=believed(findings),
    )


def page_rows(findings: Findings) -> list[Row]:
    """The points of a study as rows of a page, the means first; a bank for each condition."""
    frames = {route["bank"]: route["queries"] for route in findings.routes}
    frames[MEAN] = sum(frames.values())
    several = len(findings.settings["conditions"]) > 1
    rows = [
        {
            **point,
            "queries": frames[point["bank"]],  # of one draw
            "label": _label(point["policy"], findings.settings["needs_truth"]),
            "bank": point["bank"] + f", {CONDITIONS[point['condition']]}" * several,
        }
        for point in findings.points
    ]
    return sorted(rows, key=lambda row: not row["bank"].startswith(MEAN))


def believed(findings: Findings) -> list[Table]:
    """The audit of p̂, where it is too high by more than `PARTING` anywhere; else no table."""
    apart = [row for row in findings.audit if row["greatest_gap"] > PARTING]
    return [audit_table(findings, apart)] if apart else []


def _label(policy: str, needs_truth: Row) -> str:
    label = policy_label(policy)
    return f"{label} {MARK}" if policy in needs_truth and MARK not in label else label
