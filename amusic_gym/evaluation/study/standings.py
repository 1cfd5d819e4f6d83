"""What a study's tables say in short: a leaderboard, and sentences on who is ahead where."""

from collections.abc import Callable, Iterable, Sequence

from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.findings import SHOWN_COMPUTES, Findings, ahead
from amusic_gym.evaluation.study.fronts import ROUNDING
from amusic_gym.evaluation.study.plan import MEAN
from amusic_gym.evaluation.study.run import Row
from amusic_gym.evaluation.study.tables import front_cells, noted, percent, three
from amusic_gym.evaluation.tables import Table, marked
from amusic_gym.policies.registry import BOUND, FRONTS, MAY_IDLE, PEER


def leaderboard(findings: Findings, condition: str, title: str) -> Table:
    """The mean of every front, the best first: by hypervolume, then by AUC at any compute."""
    shown = sorted(_fronts(findings, condition, MEAN), key=_rank)
    rows = [
        [marked(row["front"], findings.settings["needs_truth"]), *front_cells(row)] for row in shown
    ]
    heads = ["policy", "area", "95 %", "begins at", *(f"≤ {share:.0%}" for share in SHOWN_COMPUTES)]
    note = (
        f"Mean over {len(findings.routes)} routes, {findings.settings['costs']} costs: the best AUC"
        " at no more than that compute, of every setting of a policy or kind of rule. Area:"
        " hypervolume, by which the table is sorted; 0 for what always runs everything."
    )
    return Table(title, heads, rows, noted(findings, note, [row["front"] for row in shown]))


def where_ahead(findings: Findings, condition: str) -> list[str]:
    """Two sentences: who has the highest AUC at which compute, and where peers are ahead of all."""
    fronts = [row for row in _fronts(findings, condition, MEAN) if row["family"] != BOUND]
    led = []
    for at, compute in enumerate(SHOWN_COMPUTES):
        reached = [(row["front"], row["auc_at"][at] or 0.0) for row in fronts]
        best = three(max(auc for _, auc in reached))
        names = [_bold(name) for name, auc in reached if three(auc) == best]
        led.append(f"≤ {compute:.0%} {_listed(names)} ({best})")
    peers: dict[str, list[str]] = {}
    for route in findings.routes:
        here = [r for r in _fronts(findings, condition, route["bank"]) if r["family"] != BOUND]
        others = max((row["auc_at"][-1] for row in here if row["family"] != PEER), default=0.0)
        for row in here:
            if row["family"] == PEER and row["auc_at"][-1] > others:
                aucs = f"{three(row['auc_at'][-1])}, the best other {three(others)}"
                peers.setdefault(row["front"], []).append(f"{route['bank']} ({aucs})")
    wins = "; ".join(f"{_bold(name)} on {_listed(places)}" for name, places in peers.items())
    return [
        f"Highest mean AUC at no more compute, {CONDITIONS[condition]}: {'; '.join(led)}.",
        f"Peers that are ahead of every rule and selector at any compute: {wins or 'none'}.",
    ]


def standing(findings: Findings, condition: str) -> list[str]:
    """A sentence for each learned selector: at which computes it is ahead of all, and behind."""
    of: dict[str, dict[float, list[Row]]] = {}
    for row in findings.matches:
        if (row["condition"], row["bank"]) == (condition, MEAN) and row["rival"] is not None:
            of.setdefault(row["policy"], {}).setdefault(row["compute"], []).append(row)
    return [_stands(name, points) for name, points in of.items()]


def _stands(name: str, points: dict[float, list[Row]]) -> str:
    idle = FRONTS[MAY_IDLE]
    computes = sorted(points)

    def where(holds: Callable[[Sequence[Row]], bool]) -> str:
        return _listed(percent(compute) for compute in computes if holds(points[compute]))

    def ahead_of_all(rows: Sequence[Row]) -> bool:
        return bool(rows) and all(ahead(row) for row in rows)

    running = where(lambda rows: ahead_of_all([row for row in rows if row["kind"] != idle]))
    idling = where(lambda rows: ahead_of_all([row for row in rows if row["kind"] == idle]))
    parts = [
        f"{_bold(name)} is ahead of every kind of rule that always runs something at"
        f" {running or 'none'}, of those that may idle at {idling or 'none'}"
    ]
    kinds = dict.fromkeys(row["kind"] for rows in points.values() for row in rows)
    for kind in kinds:
        if behind := where(
            lambda rows, kind=kind: any(  # type: ignore[misc]
                ahead(row) is False for row in rows if row["kind"] == kind
            )
        ):
            parts.append(f"behind {kind} at {behind}")
    return "; ".join(parts) + "; else level with the best."


def _fronts(findings: Findings, condition: str, bank: str) -> list[Row]:
    """The fronts under one condition, on one route or their mean."""
    return [row for row in findings.fronts if (row["condition"], row["bank"]) == (condition, bank)]


def _rank(row: Row) -> tuple[float, float]:
    volume = row["hypervolume"] if row["begins"] < 1.0 - ROUNDING else 0.0
    return -(volume or 0.0), -row["auc_at"][-1]


def _bold(name: str) -> str:
    return f"**{name}**"


def _listed(words: Iterable[str]) -> str:
    *first, last = [*words] or [""]
    return f"{', '.join(first)} and {last}" if first else last
