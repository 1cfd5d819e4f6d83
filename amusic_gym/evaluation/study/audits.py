"""The audit of a study: p̂ of every policy against the truth, and where the two part."""

from collections.abc import Sequence

import numpy as np

from amusic_gym.evaluation.audit import Audit, parting
from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.run import Row
from amusic_gym.policies.registry import BOUND, LEARNED, front_of


def audit_rows(cells: Sequence[Row]) -> list[tuple[Row, str | None]]:
    """For every front, condition and route a row and, where p̂ is far too high, a warning.

    Learned selectors come first: they are those that were rewarded with p̂.
    """
    groups: dict[tuple[str, str, str], list[tuple[str, Audit]]] = {}
    for cell in sorted(cells, key=lambda cell: cell["family"] != LEARNED):
        name = front_of(cell["policy"], cell["family"])
        if name is None or cell["family"] == BOUND or cell["p_correct"] is None:
            continue
        key = name, cell["condition"], cell["bank"]
        values = {field: cell[field] for field in ("p_correct", "auroc", "calibration_error")}
        held = Audit(accuracy=cell["p_correct"] - cell["gap"], **values)
        groups.setdefault(key, []).append((_which(cell, name), held))
    names = list(dict.fromkeys(name for name, _, _ in groups))
    ordered = sorted(groups, key=lambda key: names.index(key[0]))
    return [_audited(*key, groups[key]) for key in ordered]


def _audited(
    name: str, condition: str, route: str, audits: Sequence[tuple[str, Audit]]
) -> tuple[Row, str | None]:
    values = [held for _, held in audits]
    which, worst = max(audits, key=lambda item: item[1].gap)
    ranked = [held.auroc for held in values if held.auroc is not None]
    errors = [held.calibration_error for held in values]
    row = {
        "front": name,
        "condition": condition,
        "bank": route,
        "cells": len(values),
        "p_correct": float(np.mean([held.p_correct for held in values])),
        "accuracy": float(np.mean([held.accuracy for held in values])),
        "gap": float(np.mean([held.gap for held in values])),
        "greatest_gap": worst.gap,
        "greatest_gap_of": which,
        "auroc": float(np.mean(ranked)) if ranked else None,
        "least_auroc": min(ranked, default=None),
        "calibration_error": float(np.mean(errors)),
        "greatest_calibration_error": max(errors),
    }
    return row, parting(f"{name} on {route}, {CONDITIONS[condition]}", audits, above_only=True)


def _which(cell: Row, name: str) -> str:
    """What tells a cell from the others of its front, condition and route."""
    parts = [] if cell["policy"] == name else [cell["policy"]]
    if cell["compute_weight"] is not None:
        parts.append(f"λ {cell['compute_weight']:g}")
    if cell["seed"] is not None:
        parts.append(f"seed {cell['seed']}")
    return ", ".join(parts)
