"""A study: policies × routes × motions × seeds × λ, cell by cell, resumable.

`cells` says what a cell is and computes it, `plan` and `run` make them, serially, in processes or
on a Ray cluster. From their numbers `fronts` and `field` reckon
points, fronts, hypervolume and intervals, `findings` puts them together, `tables` and `figures`
show them.
"""

from amusic_gym.evaluation.study.cells import CONDITIONS
from amusic_gym.evaluation.study.findings import Findings, find
from amusic_gym.evaluation.study.plan import MOST_WEIGHTS, SEED_COUNT, Entrant, Plan, make_plan
from amusic_gym.evaluation.study.run import Finished, count_finished, run

__all__ = [
    "CONDITIONS",
    "MOST_WEIGHTS",
    "SEED_COUNT",
    "Entrant",
    "Findings",
    "Finished",
    "Plan",
    "count_finished",
    "find",
    "make_plan",
    "run",
]
