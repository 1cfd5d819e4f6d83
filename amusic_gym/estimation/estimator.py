"""What an estimator is: from the score rows of what ran to a place, and how sure it is."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Protocol

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.settings import ESTIMATORS, SICSettings
from amusic_gym.kernels.tables import Table


class Estimator(Protocol):
    """Estimates places for a batch of N routes, frame by frame.

    The batch says which routes are active and which techniques ran on their next frame; the
    estimator writes predictions, confidences, p̂ and what each technique came to into its ``routes``
    and ``slots``, and moves ``routes["frame"]`` on.

    Attributes:
        state: what it remembers of all routes, or None before :meth:`allocate`.
    """

    state: Table

    def allocate(self, batch: Batch, sizes: Mapping[str, int]) -> None:
        """Make room for maps and routes of these sizes, keeping what is remembered.

        Args:
            batch: the routes, in arrays of that room.
            sizes: ``references`` R, ``frames`` Q and ``candidates`` K at most, and the batch's.
        """
        ...

    def begin(self, i: int, references: int) -> None:
        """Forget route ``i``: a new episode begins on a map of that many places."""
        ...

    def update(self) -> None:
        """Take the next frame of every active route."""
        ...

    def look_back(self) -> None:
        """Run all techniques on the last block of the routes that want it, after the fact.

        Writes the statistics that MuSIC compares, −∞ where there is no technique, and the
        corrections to the batch, and counts the late runs of every slot.
        """
        ...

    def link(self, batch: Batch) -> None:
        """Write the addresses of all arrays anew: they were replaced or copied."""
        ...

    def repeated(self, batch: Batch, copies: int) -> Estimator:
        """An estimator of a batch in which every route stands ``copies`` times in a row."""
        ...


def make_estimator(settings: SICSettings, *, block: int, threads: int) -> Estimator:
    """The estimator of a statistic.

    Args:
        settings: the statistic and its parameters.
        block: M of the re-selection, 0 without.
        threads: of this process that share the routes, where the estimator can use them.
    """
    module, _, name = ESTIMATORS[settings.statistic].partition(":")
    made: Estimator = getattr(import_module(module), name)(settings, block=block, threads=threads)
    return made
