"""Bounds of algorithm selection over fixed subsets: what choosing one in hindsight would give.

The rows are those of ``results.json`` (`amusic_gym.evaluation.metrics.summarise`). Both bounds need
ground truth: the *single best* is the subset that is best on average over all routes, the *virtual
best* takes on each route the one that is best there.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from amusic_gym.evaluation.metrics import mean_rows
from amusic_gym.policies.registry import FIXED, parse
from amusic_gym.utils.names import suggest

SINGLE_BEST, VIRTUAL_BEST = "single best", "virtual best"  # what their rows call the policy
QUALITIES = ("auc", "auc_vprbench", "auc_paper", "accuracy")  # columns of which more is better
ROUNDING = 1e-9  # of computes

Row = Mapping[str, Any]


def single_best(
    rows: Sequence[Row], *, by: str = "auc", most_compute: float = math.inf
) -> dict[str, Any]:
    """The mean row of the fixed subset that is best on average over all routes.

    Args:
        rows: of any policies; those of fixed subsets count.
        by: the column to be best in, one of `QUALITIES`.
        most_compute: subsets whose mean compute is higher are out.

    Returns:
        Its row of `amusic_gym.evaluation.metrics.mean_rows`, ``policy`` being "single best" and
        ``chosen`` the subset's own name. Of equally good ones the cheaper.

    Raises:
        ValueError: if no fixed subset was run on every route within that compute, the rows are of
            several statistics or cost models, or one subset has two rows on a route.
    """
    fixed = _fixed(rows)
    banks = {row["bank"] for row in fixed}
    policies = [row["policy"] for row in fixed]
    everywhere = [row for row in fixed if policies.count(row["policy"]) == len(banks)]
    best = _best(mean_rows(everywhere), by, most_compute, "on every route")
    return {**best, "policy": SINGLE_BEST, "chosen": best["policy"]}


def virtual_best(
    rows: Sequence[Row], *, by: str = "auc", most_compute: float = math.inf
) -> dict[str, Any]:
    """The mean over routes of the fixed subset that is best on each.

    Arguments and errors are those of `single_best`, but that subsets are out where their compute on
    a route is higher. So is the row that is returned, ``policy`` being "virtual best" and
    ``chosen`` the subset's name by bank.
    """
    fixed = _fixed(rows)
    chosen = {}
    for bank in dict.fromkeys(row["bank"] for row in fixed):
        there = [row for row in fixed if row["bank"] == bank]
        chosen[bank] = _best(there, by, most_compute, f"on {bank!r}")
    (mean,) = mean_rows([{**row, "policy": VIRTUAL_BEST} for row in chosen.values()])
    return {**mean, "chosen": {bank: row["policy"] for bank, row in chosen.items()}}


def gap_closed(value: float, single: float, virtual: float) -> float | None:
    """Share of the way from the single to the virtual best; below 0 or above 1 if beyond.

    None where the two are equal: there is nothing to close.
    """
    return None if virtual == single else (value - single) / (virtual - single)


def is_fixed(policy: str) -> bool:
    """Whether a policy runs the same techniques on every frame, corrected by SIC."""
    return parse(policy).policy.family == FIXED


def _fixed(rows: Sequence[Row]) -> list[Row]:
    """The rows of fixed subsets, which must be comparable."""
    fixed = [row for row in rows if is_fixed(row["policy"])]
    if not fixed:
        raise ValueError("no row of a fixed subset; compare some, for example with --all-subsets")
    for column in ("statistic", "carry", "costs"):
        found = list(dict.fromkeys(str(row[column]) for row in fixed))
        if len(found) > 1:
            raise ValueError(
                f"the rows of fixed subsets have several {column}: {', '.join(found)}; give those "
                "of one"
            )
    seen = set()
    for row in fixed:
        key = row["bank"], row["policy"]
        if key in seen:
            raise ValueError(
                f"{row['policy']} has two rows on {row['bank']!r}; give one row per route, or name "
                "the routes apart"
            )
        seen.add(key)
    return fixed


def _best(rows: Sequence[Row], by: str, most_compute: float, where: str) -> Row:
    if by not in QUALITIES:
        raise ValueError(suggest("column to be best in", by, QUALITIES))
    within = [row for row in rows if row["compute"] <= most_compute + ROUNDING]
    if not within:
        raise ValueError(
            f"no fixed subset was run {where} at a compute of at most {most_compute:g}; raise "
            "most_compute, or compare more subsets"
        )
    return max(within, key=lambda row: (row[by], -row["compute"]))
