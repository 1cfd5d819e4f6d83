"""Plurality voting: the place that most techniques have first.

Our reading: votes for places within the bank's tolerance of each other are votes for the same one.
A technique whose row is constant has no vote.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import none
from amusic_baselines.scores import rows_of, standardised
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy


def count_votes(rows: NDArray[np.float64], tolerance: int) -> tuple[int, float]:
    """The place with the most votes of rows (T, R) and its votes, as a share of T.

    Of equally many the place whose voters are surer wins: to the number of votes is added their
    mean z / (1 + z), less than one vote, of the z-scores of the places they vote for.
    """
    z = standardised(rows)
    place = z.argmax(axis=1)  # (T,)
    sure = z.max(axis=1)
    agree = (np.abs(place[:, None] - place) <= tolerance) & (sure > 0)  # (T, T) voters of each
    votes = agree.sum(axis=1)
    strength = votes + agree @ (sure / (1.0 + sure)) / np.maximum(votes, 1)
    winner = int(strength.argmax())
    return int(place[winner]), float(strength[winner]) / len(rows)


@dataclass(eq=False)
class Plurality:
    """Runs everything; each technique votes for its best place."""

    tolerance: int  # places to either side that count as the same

    def reset(self, references: int, techniques: int) -> None:
        """Nothing to forget; T may be another."""
        self._techniques = techniques

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """The place with the most votes, and their share."""
        return count_votes(rows_of(run, range(self._techniques)), self.tolerance)


def plurality(argument: str | None, context: Context) -> Plurality:
    """``plurality``."""
    none("plurality", argument)
    return Plurality(context.route.tolerance)


POLICY = RegisteredPolicy("plurality", plurality, PEER, colour="#6699CC", marker="h", constant=True)
