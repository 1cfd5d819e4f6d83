"""What a study found: points, fronts, margins and the audit of p̂, as plain rows."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym import __version__
from amusic_gym.evaluation import bounds, metrics
from amusic_gym.evaluation.study.audits import audit_rows
from amusic_gym.evaluation.study.cells import AUDITED
from amusic_gym.evaluation.study.field import BOTH, LEVEL, REPLICATES, SEEDS, Field, Point, interval
from amusic_gym.evaluation.study.fronts import (
    BAND,
    GRID,
    REFERENCE_AUC,
    ROUNDING,
    Numbers,
    front_at,
    hypervolume,
)
from amusic_gym.evaluation.study.plan import MEAN, Plan
from amusic_gym.evaluation.study.run import Finished, Row
from amusic_gym.policies.registry import FIXED, FRONTS, LEARNED, front_of
from amusic_gym.utils.storage import write_whole

RESULTS = "study.json"
FORMAT_VERSION = 3

SHOWN_COMPUTES = (0.05, 0.1, 0.2, 0.4, 1.0)  # computes at which tables show a front
LEAST_GAP = 0.02  # where single and virtual best are closer than this, there is no gap to speak of
EVERYONE = "all of these"  # the rivals of a learned selector together


@dataclass(frozen=True)
class Findings:
    """What came out of a study; rows of plain values."""

    settings: Row  # what was run, and how the numbers were reckoned
    routes: list[Row]  # as in the plan
    cells: list[Row]  # labels and numbers of every cell
    points: list[Row]  # a policy with one λ under one condition, on one route or their ``mean``
    fronts: list[Row]  # of the fixed subsets, of every family of rules, of every other policy
    margins: list[Row]  # of every learned selector over its rivals
    # of every point of a learned selector with the best point of each kind of rival at no
    # more compute
    matches: list[Row]
    audit: list[Row]  # p̂ against the truth, of every policy or family that gives p̂
    warnings: list[str]  # what must not be overlooked

    def write(self, folder: str | Path) -> Path:
        """Write `RESULTS`, whole or not at all."""
        body = {"format": FORMAT_VERSION, "version": __version__, **asdict(self)}
        text = json.dumps(body, indent=1, allow_nan=False)
        return write_whole(Path(folder) / RESULTS, text.encode() + b"\n")


def find(plan: Plan, finished: Finished, *, rivals: Iterable[str] = ()) -> Findings:
    """Reckon everything from all cells of a study.

    ``rivals`` are names of learned selectors that the others must beat, for example an imitation
    of the cascade; the families of `FRONTS` are rivals anyway.
    """
    rivals = tuple(rivals)
    names = [route["bank"] for route in plan.routes]
    scopes = []
    for condition in plan.settings["conditions"]:
        here = [cell for cell in finished if cell["condition"] == condition]
        field = Field.of(here, names, len(plan.settings["seeds"]))
        left_out = ("seed", "member", *AUDITED)
        plain = [{key: cell[key] for key in cell if key not in left_out} for cell in here]
        rows = metrics.mean_rows(plain, key=("bank", *metrics.MEAN_KEY))  # over seeds
        for route in [*names, *([MEAN] if len(names) > 1 else [])]:
            scopes.append(_Scope(condition, route, field, rows, plan.routes, rivals))
    audits = audit_rows(finished)
    return Findings(
        settings={
            **plan.settings,
            "rivals": list(rivals),
            "interval": {"level": LEVEL, "replicates": REPLICATES},
            "hypervolume": {"auc": REFERENCE_AUC, "compute": 1.0},
            "grid": GRID.tolist(),
            "band": list(BAND),
        },
        routes=list(plan.routes),
        cells=finished,
        points=[row for scope in scopes for row in scope.points()],
        fronts=[row for scope in scopes for row in scope.fronts()],
        margins=[row for scope in scopes for row in scope.margins()],
        matches=[row for scope in scopes for row in scope.matches()],
        audit=[row for row, _ in audits],
        warnings=[line for _, line in audits if line is not None],
    )


class _Scope:
    """The field of one condition, on one route or over all, and the rows of that condition."""

    def __init__(
        self,
        condition: str,
        route: str,
        field: Field,
        rows: Sequence[Row],
        routes: Sequence[Row],
        rivals: Sequence[str],
    ) -> None:
        self.labels = {"condition": condition, "bank": route}
        self.field = field.at(None if route == MEAN else route)
        self.rows = rows
        self.standing = (*FRONTS.values(), *rivals)  # fronts to beat
        shares = [each["cheapest"] for each in routes if route in (MEAN, each["bank"])]
        self.cheapest = float(np.mean(shares))
        self.over = BOTH if route == MEAN else SEEDS

    def points(self) -> list[Row]:
        """A row for every point: means, intervals, and for the mean the gap that it closes."""
        names = self.field.routes
        there = [
            row for row in self.rows if row["bank"] in names and _point(row) in self.field.points
        ]
        means = {_point(row): row for row in metrics.mean_rows(there)}
        fixed = [row for row in there if row["family"] == FIXED]
        intervals = self._intervals(self.over)
        by_seed = self._intervals(SEEDS)
        return [
            {
                **means[point],
                **self.labels,
                "routes": len(names),
                "auc_interval": intervals["auc"][p],
                "compute_interval": intervals["compute"][p],
                "interval_over": self.over,
                "auc_interval_seeds": by_seed["auc"][p],
                "gap_closed": None if point.family == FIXED else _gap(means[point], fixed),
            }
            for p, point in enumerate(self.field.points)
        ]

    def _intervals(self, over: str) -> dict[str, list[Any]]:
        """Of every point's AUC and compute; None where there is nothing to resample."""
        can = self.field.resampled(over)
        compute, auc = (interval(values) for values in self.field.replicates(over))
        return {
            name: [ends if on else None for ends, on in zip(found or [], can, strict=True)]
            for name, found in (("compute", compute), ("auc", auc))
        }

    def sides(self) -> list[str]:
        """The fronts that there are, in the order of the policies."""
        names = (front_of(point.policy, point.family) for point in self.field.points)
        return list(dict.fromkeys(name for name in names if name is not None))

    def of(self, *sides: str) -> Field:
        """The points of some fronts."""
        return self.field.where(lambda point: front_of(point.policy, point.family) in sides)

    def fronts(self) -> list[Row]:
        """A row for every front: where it begins, what it reaches, and its hypervolume."""
        rows = []
        for name in self.sides():
            own = self.of(name)
            compute, auc = own.means()
            volumes = hypervolume(*own.replicates(self.over), self.cheapest)
            varied = own.resampled(self.over).any()
            rows.append(
                {
                    **self.labels,
                    "front": name,
                    "family": own.points[0].family,
                    "points": len(own.points),
                    "begins": float(compute.min()),
                    "auc_at": [_number(v) for v in front_at(compute, auc, SHOWN_COMPUTES)],
                    "cheapest": self.cheapest,
                    "hypervolume": _number(hypervolume(compute, auc, self.cheapest)),
                    "hypervolume_interval": interval(volumes) if varied else None,
                    "interval_over": self.over,
                }
            )
        return rows

    def margins(self) -> list[Row]:
        """Rows for every learned selector: its front minus that of each rival, and of all."""
        learned = [p.policy for p in self.field.points if p.family == LEARNED]
        standing = [name for name in self.sides() if name in self.standing]
        rows = []
        for name in dict.fromkeys(learned):
            others = [other for other in standing if other != name]
            groups = {other: [other] for other in others}
            if len(others) > 1:
                groups[EVERYONE] = others
            rows += [self._margin(name, rival, group) for rival, group in groups.items()]
        return rows

    def matches(self) -> list[Row]:
        """Rows for every point of a learned selector, one for each kind of rival in the field.

        The rival is chosen as if one had known beforehand which is best here: a head start for it.
        Of those that three digits do not tell apart it is the cheapest. What costs the same to
        within `ROUNDING` is no dearer.
        """
        points = self.field.points
        fronts = [front_of(point.policy, point.family) for point in points]
        compute, auc = self.field.means()
        varied, copies = self.field.resampled(self.over), self.field.replicates(self.over)[1]
        rows = []
        for p, point in enumerate(points):
            if point.family != LEARNED:
                continue
            cheap = compute <= compute[p] * (1.0 + ROUNDING)
            for name in dict.fromkeys(name for name in fronts if name in self.standing):
                if name == fronts[p]:
                    continue
                affordable = cheap & np.array([front == name for front in fronts])
                best = _place(auc.round(3) - 1e-4 * compute, affordable)  # which is at most 1
                row: Row = {
                    **self.labels,
                    **{"policy": point.policy, "compute_weight": point.compute_weight},
                    **{"auc": float(auc[p]), "compute": float(compute[p]), "kind": name},
                    **dict.fromkeys(("rival", "rival_weight", "rival_auc", "rival_compute")),
                    **{"difference": None, "difference_interval": None},
                    "interval_over": self.over,
                }
                if best is not None:
                    row |= {
                        "rival": points[best].policy,
                        "rival_weight": points[best].compute_weight,
                        "rival_auc": float(auc[best]),
                        "rival_compute": float(compute[best]),
                        "difference": float(auc[p] - auc[best]),
                    }
                    if varied[p] or varied[best]:
                        row["difference_interval"] = interval(copies[:, p] - copies[:, best])
                rows.append(row)
        return rows

    def _margin(self, name: str, rival: str, group: Sequence[str]) -> Row:
        ours, theirs = self.of(name), self.of(*group)
        difference = _difference(ours, theirs)
        least = _place(-difference, np.ones(GRID.size, bool))
        greatest = _place(difference, (GRID >= BAND[0] - ROUNDING) & (GRID <= BAND[1] + ROUNDING))
        spread = None
        if greatest is not None and any(own.resampled(self.over).any() for own in (ours, theirs)):
            spread = interval(_difference(ours, theirs, self.over)[:, greatest])
        return {
            **self.labels,
            "policy": name,
            "rival": rival,
            "begins": float(ours.means()[0].min()),
            "rival_begins": float(theirs.means()[0].min()),
            "least": None if least is None else float(difference[least]),
            "least_at": None if least is None else float(GRID[least]),
            "greatest": None if greatest is None else float(difference[greatest]),
            "greatest_at": None if greatest is None else float(GRID[greatest]),
            "greatest_interval": spread,
            "interval_over": self.over,
        }


def ahead(match: Row) -> bool | None:
    """Whether the selector of a row of `Findings.matches` is ahead; None: too close to say.

    Too close is an interval that holds 0; without one, a difference that three digits hide.
    """
    low, high = match["difference_interval"] or [match["difference"]] * 2
    least = 0.0 if match["difference_interval"] else 5e-4
    return True if low > least else False if high < -least else None


def _point(row: Row) -> Point:
    return Point(*(row[name] for name in Point._fields))


def _difference(ours: Field, theirs: Field, over: str | None = None) -> Numbers:
    """Our front's AUC minus theirs on `GRID`; nan where either has not begun.

    With ``over`` of bootstrap replicates, of the AUC only: at which compute a point stands is taken
    from the means, else a replicate's front might not have begun where they are compared.
    """
    fronts = []
    for field in (ours, theirs):
        compute, auc = field.means()
        if over is not None:
            auc = field.replicates(over)[1]
            compute = np.broadcast_to(compute, auc.shape)
        fronts.append(front_at(compute, auc, GRID))
    return np.asarray(fronts[0] - fronts[1])


def _place(values: Numbers, allowed: Any) -> int | None:
    """Where the greatest value is, of those that are allowed and defined."""
    usable = np.where(allowed & ~np.isnan(values), values, -np.inf)
    best = int(np.argmax(usable))
    return None if np.isneginf(usable[best]) else best


def _gap(row: Row, fixed: Sequence[Row]) -> float | None:
    """Share of the way from single to virtual best among the fixed subsets of that compute."""
    most = row["compute"] * (1.0 + ROUNDING)
    try:
        single, virtual = (
            best(fixed, most_compute=most)["auc"]
            for best in (bounds.single_best, bounds.virtual_best)
        )
    except ValueError:  # no subset that is so cheap on every route
        return None
    if virtual - single < LEAST_GAP:
        return None
    return bounds.gap_closed(row["auc"], single, virtual)


def _number(value: Any) -> float | None:
    return None if np.isnan(value) else float(value)
