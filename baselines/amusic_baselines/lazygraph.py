"""Lazy-graph-style matching: best-first search for a path through frames and places.

Vysotska, Stachniss: Lazy Data Association for Image Sequences Matching Under Substantial Appearance
Changes, RA-L 1(1), 2016, and the program its authors published: nodes are pairs of a frame and a
place, and a node's children are the places around its own on the next frame. On a frame the
cheapest nodes are expanded, those that cannot win dropped, until one of the frame before was.
Our reading where a route here differs from theirs:

 - They take 1 / cosine for a node's cost. Techniques here have scores of any scale, so a row is
   scaled to [0, 1], its mean over techniques is the similarity, and the cost its inverse, at most
   the cost of a node that does not match (theirs are only marked as such).
 - They report a path; the confidence is the mean similarity along its last `RECENT` nodes.
"""

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from amusic_baselines.arguments import number, technique_parts, whole
from amusic_baselines.scores import rows_of, scaled
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

FAN_OUT = 5  # places to either side on the next frame
RATE = 0.7  # share of the path's mean cost that a frame is hoped to cost
NON_MATCH = 6.0
MOST_COST = 1e6
RECENT = 10  # nodes
FORM = "FANOUT/RATE/NONMATCH"


@dataclass(eq=False)
class LazyGraph:
    """Runs the same techniques on every frame; the place is the end of the best path so far."""

    columns: Sequence[int]  # indices of the techniques that run
    fan_out: int = FAN_OUT  # places to either side that a child may be away from its parent
    rate: float = RATE  # share of the best path's mean cost that each frame is hoped to cost
    non_match: float = NON_MATCH  # the highest cost of a node

    def reset(self, references: int, techniques: int) -> None:
        """Forget the graph."""
        self._costs: list[list[float]] = []  # of every frame, (R,) each
        self._paths: list[dict[int, tuple[float, int]]] = []  # frame: place → path's cost, parent
        self._frontier: list[tuple[float, int, int]] = []  # path's cost, frame, place
        self._best = (0.0, -1, -1)

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """End of the best path, and the mean similarity along its last nodes."""
        similarity = scaled(rows_of(run, self.columns)).mean(axis=0)  # (R,)
        self._costs.append((1.0 / np.maximum(similarity, 1.0 / self.non_match)).tolist())
        self._paths.append({})
        if frame == 0:
            self._expand(0.0, -1, -1, range(similarity.size))
        else:
            self._search(frame)
        return self._best[2], self._confidence()

    def _search(self, frame: int) -> None:
        """Expand the cheapest nodes until one of the frame before was."""
        row = -1
        while row != frame - 1:
            node = heapq.heappop(self._frontier)
            if not self._worth(node):
                continue
            cost, row, place = node
            first, last = place - self.fan_out, place + self.fan_out
            near = range(max(0, first), min(len(self._costs[0]) - 1, last) + 1)
            self._expand(cost, row, place, near)

    def _worth(self, node: tuple[float, int, int]) -> bool:
        """Whether a path through the node may become cheaper than the best one."""
        if node == self._best:
            return True
        best, row = self._best[:2]
        return node[0] + (row - node[1]) * self.rate * best / (row + 1) < best

    def _expand(self, cost: float, row: int, place: int, near: range) -> None:
        """Add a node's children, unless a cheaper parent has had them, and see which is best."""
        costs, paths = self._costs[row + 1], self._paths[row + 1]
        for child in near:
            if child not in paths:
                paths[child] = cost + costs[child], place
                heapq.heappush(self._frontier, (paths[child][0], row + 1, child))
        child = min(near, key=costs.__getitem__)
        total = paths[child][0]
        if row + 1 > self._best[1] or (row + 1 == self._best[1] and total < self._best[0]):
            self._best = total, row + 1, child

    def _confidence(self) -> float:
        _, row, place = self._best
        similarities: list[float] = []
        while row >= 0 and len(similarities) < RECENT:
            similarities.append(1.0 / self._costs[row][place])
            row, place = row - 1, self._paths[row][place][1]
        return float(np.mean(similarities))


def lazygraph(argument: str | None, context: Context) -> LazyGraph:
    """``lazygraph``, ``…:FANOUT/RATE/NONMATCH`` or ``…:A+B/FANOUT/RATE/NONMATCH``; else all run."""
    if argument is None:
        return LazyGraph(range(len(context.techniques)))
    columns, (fan_out, rate, cost) = technique_parts("lazygraph", argument, FORM, context)
    return LazyGraph(
        columns,
        whole("lazygraph", argument, "FANOUT", fan_out, 1, 10_000),
        number("lazygraph", argument, "RATE", rate, 0.0, 1.0),
        number("lazygraph", argument, "NONMATCH", cost, 1.0, MOST_COST),
    )


POLICY = RegisteredPolicy(
    "lazygraph", lazygraph, PEER, "lazy graph", colour="#AA3377", marker="v", constant=True
)
