"""Where an environment's routes come from: given banks, or simulated ones."""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np

from amusic_gym.bank import ScoreBank
from amusic_gym.names import suggest

if TYPE_CHECKING:
    from amusic_gym.routes.simulate import Simulation

BankLike = str | os.PathLike[str] | ScoreBank

COST_MODELS = ("measured", "paper", "runs")


@runtime_checkable
class RouteSource(Protocol):
    """Gives an environment the bank of its next episode.

    Attributes:
        techniques: names of the slots, or None when banks may differ in their techniques.
        slots: largest number of techniques of any bank.
    """

    @property
    def techniques(self) -> tuple[str, ...] | None:
        """Names of the slots, or None."""
        ...

    @property
    def slots(self) -> int:
        """Largest number of techniques."""
        ...

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[ScoreBank, int]:
        """Draw a bank and its number, or take the bank of number ``index``."""
        ...


class Banks:
    """A fixed list of banks, drawn uniformly.

    Args:
        banks: folders or banks.
        costs: cost model, see :meth:`amusic_gym.bank.ScoreBank.with_costs`.
        aligned: whether all banks must hold the same techniques.

    Raises:
        ValueError: for an empty list.
        FileNotFoundError: for a folder that is not there.
    """

    def __init__(
        self, banks: Sequence[BankLike], *, costs: str = "measured", aligned: bool = True
    ) -> None:
        if not banks:
            raise ValueError("no score bank given; give at least one folder or ScoreBank")
        if costs not in COST_MODELS:
            raise ValueError(suggest("cost model", costs, COST_MODELS))
        loaded = [b if isinstance(b, ScoreBank) else ScoreBank.load(b) for b in banks]
        self.banks = loaded if costs == "measured" else [b.with_costs(costs) for b in loaded]
        self._aligned = aligned

    @property
    def techniques(self) -> tuple[str, ...] | None:
        """Names of the first bank, when all must be the same."""
        return self.banks[0].techniques if self._aligned else None

    @property
    def slots(self) -> int:
        """Largest number of techniques."""
        return max(len(bank.techniques) for bank in self.banks)

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[ScoreBank, int]:
        """Draw a bank, or take number ``index``.

        Raises:
            ValueError: if there is no such number.
        """
        if index is None:
            index = int(rng.integers(len(self.banks))) if len(self.banks) > 1 else 0
        if not 0 <= index < len(self.banks):
            raise ValueError(f"bank {index}: there are {len(self.banks)}, numbered from 0")
        return self.banks[index], index


class SimulatedRoutes:
    """Endless simulated routes, or a pool of them that is drawn from again and again.

    Args:
        simulation: what is drawn; None: the defaults.
        pool: how many different routes; None: every episode's is new.
        seed: first seed of the pool, so that training and held-out routes can be kept apart.
        keep: how many routes are held in memory.
    """

    def __init__(
        self,
        simulation: Simulation | None = None,
        *,
        pool: int | None = None,
        seed: int = 0,
        keep: int = 256,
    ) -> None:
        from amusic_gym.routes.simulate import Simulation as Default

        if pool is not None and pool < 1:
            raise ValueError(f"pool is {pool}; give None for endless routes, or at least 1")
        self.simulation = simulation or Default()
        self.pool = pool
        self.seed = seed
        self._keep = keep
        self._routes: OrderedDict[int, ScoreBank] = OrderedDict()

    @property
    def techniques(self) -> tuple[str, ...] | None:
        """None: simulated techniques have no lasting names."""
        return None

    @property
    def slots(self) -> int:
        """Largest number of techniques that a route may have."""
        return self.simulation.most_techniques

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[ScoreBank, int]:
        """Draw a route; its number is its seed counted from the first."""
        if index is None:
            index = int(rng.integers(self.pool if self.pool is not None else 2**31))
        if index not in self._routes:
            generator = np.random.default_rng([self.seed, index])
            self._routes[index] = self.simulation.route(generator)
            if len(self._routes) > self._keep:
                self._routes.popitem(last=False)
        self._routes.move_to_end(index)
        return self._routes[index], index

    def __getstate__(self) -> dict[str, object]:
        """Copies redraw their routes from the seeds instead of carrying them."""
        return {**self.__dict__, "_routes": OrderedDict()}


def as_source(
    bank: BankLike | Sequence[BankLike] | RouteSource | None, *, costs: str, aligned: bool
) -> RouteSource:
    """Turn what a user may give as ``bank`` into a source of routes."""
    if bank is None:
        return SimulatedRoutes()
    if isinstance(bank, ScoreBank | str | os.PathLike):
        return Banks([bank], costs=costs, aligned=aligned)
    if isinstance(bank, RouteSource):
        return bank
    return Banks(list(bank), costs=costs, aligned=aligned)
