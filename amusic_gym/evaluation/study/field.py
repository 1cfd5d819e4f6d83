"""All points of a study under one condition as arrays, and what resampling makes of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.evaluation.study.fronts import Numbers

REPLICATES = 1000  # of a bootstrap

LEVEL = 0.95

SEEDS, BOTH = "seeds", "seeds and routes"


class Point(NamedTuple):
    """A policy with one λ: a mean over seeds, on one route or over all."""

    policy: str
    family: str
    compute_weight: float | None
    statistic: str
    carry: bool


@dataclass(frozen=True)
class Field:
    """P points on R routes with S seeds; nan where a point is not on a route."""

    points: tuple[Point, ...]  # P
    routes: tuple[str, ...]  # R names
    auc: Numbers  # (P, R, S)
    compute: Numbers  # (P, R, S)
    varied: NDArray[np.bool_]  # (P,) whether seeds make a difference

    @classmethod
    def of(cls, cells: Sequence[Mapping[str, Any]], routes: Sequence[str], seeds: int) -> Field:
        """The field of the cells of one condition, those of a point and route by seed, S of them.

        A cell that no seed changes stands for all of them.
        """
        groups: dict[Point, dict[str, list[Mapping[str, Any]]]] = {}
        for cell in cells:
            point = Point(*(cell[name] for name in Point._fields))
            groups.setdefault(point, {}).setdefault(cell["bank"], []).append(cell)
        auc, compute = np.full((2, len(groups), len(routes), seeds), np.nan)
        for p, by_route in enumerate(groups.values()):
            for r, route in enumerate(routes):
                if found := by_route.get(route):
                    auc[p, r] = [cell["auc"] for cell in found]
                    compute[p, r] = [cell["compute"] for cell in found]
        counts = [max(map(len, by_route.values())) for by_route in groups.values()]
        varied = np.array(counts, np.int64) > 1
        return cls(tuple(groups), tuple(routes), auc, compute, varied)

    def at(self, route: str | None) -> Field:
        """One route only, or all of them; with the points that are there, on all routes."""
        chosen = [r for r, name in enumerate(self.routes) if route in (None, name)]
        auc, compute = self.auc[:, chosen], self.compute[:, chosen]
        there = [p for p in range(len(self.points)) if not np.isnan(auc[p]).any()]
        return Field(
            tuple(self.points[p] for p in there),
            tuple(self.routes[r] for r in chosen),
            auc[there],
            compute[there],
            self.varied[there],
        )

    def where(self, wanted: Callable[[Point], bool]) -> Field:
        """Some of the points."""
        keep = [p for p, point in enumerate(self.points) if wanted(point)]
        return replace(
            self,
            points=tuple(self.points[p] for p in keep),
            auc=self.auc[keep],
            compute=self.compute[keep],
            varied=self.varied[keep],
        )

    def means(self) -> tuple[Numbers, Numbers]:
        """Compute and AUC (P,), over seeds and routes, every route weighing the same."""
        return self.compute.mean(axis=(1, 2)), self.auc.mean(axis=(1, 2))

    def resampled(self, over: str) -> NDArray[np.bool_]:
        """(P,) which points resampling can change: an interval of others would say nothing."""
        return self.varied | (over == BOTH and len(self.routes) > 1)

    def replicates(self, over: str) -> tuple[Numbers, Numbers]:
        """Compute and AUC (B, P) of bootstrap replicates.

        Every replicate takes S of the seeds with replacement, the same on all routes and for all
        policies, since seed i means one training. With `BOTH` it takes R of the routes likewise.
        All fields of as many seeds and routes are resampled alike, so differences are paired.
        """
        _, routes, seeds = self.auc.shape
        rng = np.random.default_rng(0)
        by_seed = _weights(rng, seeds)  # (B, S)
        by_route = _weights(rng, routes) if over == BOTH else np.full((1, routes), 1.0 / routes)
        weights = by_route[:, :, None] * by_seed[:, None, :]  # (B, R, S)
        compute, auc = (
            np.tensordot(weights, values, axes=([1, 2], [1, 2]))
            for values in (self.compute, self.auc)
        )
        return compute, auc


def interval(values: ArrayLike) -> list[Any] | None:
    """Percentiles that hold `LEVEL` of B replicates, for each column: [low, high].

    None where a replicate is nan: what is not defined in all has no interval.
    """
    array = np.asarray(values, np.float64)
    if np.isnan(array).any():
        return None
    ends = np.quantile(array, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
    return list(ends.T.tolist())


def _weights(rng: np.random.Generator, count: int) -> NDArray[np.float64]:
    """(B, count): how often each of so many is drawn, as a share."""
    return rng.multinomial(count, np.full(count, 1.0 / count), REPLICATES) / count
