"""Where an environment's routes come from: given banks, live routes, or simulated ones."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.costs import COST_MODELS
from amusic_gym.envs.live_route import LiveRoute
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.routes.simulate import Simulation

TECHNIQUES = 4
"""Of every simulated route of an environment without a bank."""

Recording = ScoreBank | LiveRoute
"""What a route is driven on: scores that are there, or that are computed when asked for."""

BankLike = str | os.PathLike[str] | Recording


@runtime_checkable
class RouteSource(Protocol):
    """Gives an environment the bank, or the live route, of its next episode.

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

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[Recording, int]:
        """Draw a bank and its number, or take the bank of number ``index``."""
        ...


def columns_for(bank: Recording, techniques: Sequence[str] | None, slots: int) -> NDArray[np.int64]:
    """Technique of ``bank`` for each slot: aligned by name, or the bank's own order.

    Args:
        bank: the bank.
        techniques: names of the slots; None: the bank's techniques fill the first slots.
        slots: S.

    Raises:
        ValueError: if the bank's names are not those, or there are more than S.
    """
    if techniques is None:
        if len(bank.techniques) > slots:
            raise ValueError(
                f"bank {bank.name!r} has {len(bank.techniques)} techniques for {slots} slots;"
                f" give slots={len(bank.techniques)} or more"
            )
        columns = np.full(slots, -1, np.int64)
        columns[: len(bank.techniques)] = np.arange(len(bank.techniques))
        return columns
    if sorted(bank.techniques) != sorted(techniques):
        raise ValueError(
            f"bank {bank.name!r} has the techniques {', '.join(bank.techniques)}, the first bank"
            f" {', '.join(techniques)}; give banks of the same techniques, or slots=S for any"
        )
    return np.array([bank.techniques.index(name) for name in techniques], np.int64)


class Banks:
    """A fixed list of banks, drawn uniformly.

    Args:
        banks: folders of banks, banks or live routes.
        costs: cost model, see :meth:`amusic_gym.banks.bank.ScoreBank.with_costs`.
        aligned: whether all banks must hold the same techniques.

    Raises:
        ValueError: for an empty list, or banks of different techniques that must be the same.
        FileNotFoundError: for a folder that is not there.
    """

    def __init__(
        self, banks: Sequence[BankLike], *, costs: str = "measured", aligned: bool = True
    ) -> None:
        if not banks:
            raise ValueError("no score bank given; give at least one folder or ScoreBank")
        if costs not in COST_MODELS:
            raise ValueError(suggest("cost model", costs, COST_MODELS))
        loaded = [b if isinstance(b, Recording) else ScoreBank.load(b) for b in banks]
        self.banks: list[Recording] = (
            loaded if costs == "measured" else [b.with_costs(costs) for b in loaded]
        )
        self._aligned = aligned
        if aligned:
            for bank in self.banks:
                columns_for(bank, self.banks[0].techniques, self.slots)

    @property
    def techniques(self) -> tuple[str, ...] | None:
        """Names of the first bank, when all must be the same."""
        return self.banks[0].techniques if self._aligned else None

    @property
    def slots(self) -> int:
        """Largest number of techniques."""
        return max(len(bank.techniques) for bank in self.banks)

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[Recording, int]:
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
        simulation: what is drawn; None: what an environment without a bank drives on, the routes
            of the default statistic's :func:`~amusic_gym.routes.simulate.population` with
            `TECHNIQUES` techniques each.
        pool: how many different routes; None: every episode's is new.
        seed: routes of another seed are other routes: training and held-out ones, for example.
        keep: how many routes are held in memory, of a pool and of those that were asked for by
            number; no other is drawn a second time.
    """

    def __init__(
        self,
        simulation: Simulation | None = None,
        *,
        pool: int | None = None,
        seed: int = 0,
        keep: int = 256,
    ) -> None:
        if pool is not None and pool < 1:
            raise ValueError(f"pool is {pool}; give None for endless routes, or at least 1")
        self.simulation = simulation or ordinary(SICSettings.statistic)
        self.pool = pool
        self.seed = seed
        self._keep = keep
        self._routes: dict[int, ScoreBank] = {}

    @property
    def techniques(self) -> tuple[str, ...] | None:
        """None: simulated techniques have no lasting names."""
        return None

    @property
    def slots(self) -> int:
        """Largest number of techniques that a route may have."""
        return self.simulation.techniques[1]

    def sample(self, rng: np.random.Generator, index: int | None) -> tuple[ScoreBank, int]:
        """Draw a route, or take the one of number ``index``.

        Raises:
            ValueError: if there is no such number.
        """
        routes = self.pool if self.pool is not None else 2**31
        needed_again = self.pool is not None or index is not None
        if index is None:
            index = int(rng.integers(routes))
        if not 0 <= index < routes:
            raise ValueError(f"route {index}: there are {routes}, numbered from 0")
        route = self._routes.pop(index, None)
        if route is None:
            route = self.simulation.route(np.random.default_rng([self.seed, index]))
        if needed_again:
            self._routes[index] = route  # the last one in order
            if len(self._routes) > self._keep:
                self._routes.pop(next(iter(self._routes)))
        return route, index

    def __getstate__(self) -> dict[str, object]:
        """Copies redraw their routes from the seeds instead of carrying them."""
        return {**self.__dict__, "_routes": {}}


def ordinary(statistic: str) -> Simulation:
    """What an environment without a bank drives on: the statistic's routes, all of one size."""
    from amusic_gym.routes.simulate import population

    return replace(population(statistic), techniques=(TECHNIQUES, TECHNIQUES))


def as_source(
    bank: BankLike | Sequence[BankLike] | RouteSource | None,
    *,
    costs: str,
    aligned: bool,
    statistic: str = SICSettings.statistic,
) -> RouteSource:
    """Turn what a user may give as ``bank`` into a source of routes.

    Args:
        bank: what the user gave.
        costs: cost model of given banks.
        aligned: whether all banks must hold the same techniques.
        statistic: SIC's, which decides what simulated routes are like.

    Raises:
        ValueError: for anything else, or a cost model that would have no effect.
    """
    if costs not in COST_MODELS:
        raise ValueError(suggest("cost model", costs, COST_MODELS))
    if isinstance(bank, Recording | str | os.PathLike):
        bank = [bank]
    if isinstance(bank, Sequence):
        return Banks(bank, costs=costs, aligned=aligned)
    if bank is not None and not isinstance(bank, RouteSource):
        raise ValueError(f"bank is {bank!r}; give a folder, a ScoreBank, a list of these, or None")
    if costs != "measured":
        raise ValueError(f"costs is {costs!r}, but simulated routes have their own; leave it out")
    return SimulatedRoutes(ordinary(statistic)) if bank is None else bank
