"""The measures of a results row as explicit loops, by their definitions; see `oracle.py`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oracle import Route

Numbers = Any


def correctness(predictions: Sequence[int], ground_truth: Numbers) -> list[bool]:
    """Whether each prediction is a true place of its query; -1 never is."""
    return [
        int(place) >= 0 and bool(ground_truth[q][int(place)]) for q, place in enumerate(predictions)
    ]


def positives(ground_truth: Numbers) -> int:
    """How many queries have a true place."""
    return sum(any(bool(true) for true in row) for row in ground_truth)


def accuracy(correct: Sequence[bool]) -> float:
    """Share of frames whose prediction is a true place."""
    return sum(bool(c) for c in correct) / len(correct)


def operating_points(correct: Sequence[bool], confidence: Sequence[float]) -> list[tuple[int, int]]:
    """(true positives, retrieved) at each distinct confidence, the highest threshold first."""
    points = []
    for threshold in sorted({float(value) for value in confidence}, reverse=True):
        retrieved = [bool(c) for c, v in zip(correct, confidence, strict=True) if v >= threshold]
        points.append((sum(retrieved), len(retrieved)))
    return points


def area(recall: Sequence[float], precision: Sequence[float]) -> float:
    """Trapezoid rule, recall rising."""
    total = 0.0
    for i in range(1, len(recall)):
        total += (recall[i] - recall[i - 1]) * (precision[i] + precision[i - 1]) / 2
    return total


def auc(correct: Sequence[bool], confidence: Sequence[float], true_queries: int) -> float:
    """Area under the precision-recall curve; recall relative to queries with a true place.

    The curve starts at recall 0 with the precision of the highest threshold.
    """
    if not any(correct):
        return 0.0
    points = operating_points(correct, confidence)
    recall = [0.0] + [hits / true_queries for hits, _ in points]
    precision = [hits / retrieved for hits, retrieved in points]
    return area(recall, [precision[0], *precision])


def auc_vprbench(correct: Sequence[bool], confidence: Sequence[float]) -> float:
    """Area as VPR-Bench has it: recall relative to the correct matches, (0, 1) added."""
    total = sum(bool(c) for c in correct)
    if total == 0:
        return 0.0
    points = operating_points(correct, confidence)
    recall = [0.0] + [hits / total for hits, _ in points]
    precision = [1.0] + [hits / retrieved for hits, retrieved in points]
    return area(recall, precision)


def ptr(route: Route) -> float:
    """Proportion of technique runs, after-the-fact runs included ("A-MuSIC", IV-B)."""
    return sum(route.runs()) / (len(route.ran) * len(route.ran[0]))


def compute(route: Route, seconds: Sequence[float]) -> float:
    """Seconds of all runs relative to running everything on every frame."""
    spent = math.fsum(n * float(s) for n, s in zip(route.runs(), seconds, strict=True))
    return spent / (len(route.ran) * math.fsum(float(s) for s in seconds))
