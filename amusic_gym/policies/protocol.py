"""The two protocols for policies, and what a policy may ask of its environment."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from amusic_gym.estimation.settings import COVERAGE, SICSettings
from amusic_gym.utils.names import suggest

if TYPE_CHECKING:
    from amusic_gym.banks.bank import ScoreBank
    from amusic_gym.envs.live_route import LiveRoute


@dataclass(frozen=True)
class Needs:
    """Arguments of the environment that a selector was made for; None: whatever the user chose."""

    statistic: str | None = None  # SIC's statistic
    carry: bool | None = None  # whether places are carried on as candidates
    discount: bool | None = None  # whether MuSIC discounts alike rows
    reselection: int | None = None  # M of the re-select bit; None: no such bit
    coverage: float = COVERAGE  # E of the re-selection
    allow_idle: bool = False  # whether an empty action runs nothing
    # any other arguments of :class:`amusic_gym.envs.task.Task`
    extra: Mapping[str, Any] = field(default_factory=dict)


@runtime_checkable
class Selector(Protocol):
    """Decides which techniques run; the environment does the rest."""

    @property
    def needs(self) -> Needs:
        """What the environment must be like."""
        ...

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Forget the routes of ``mask`` (N,): new episodes begin there."""
        ...

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[Any]:
        """Choose actions (N, A) from observations (N, D) and the vector environment's infos."""
        ...


@runtime_checkable
class Rater(Protocol):
    """A selector that can rate every subset of techniques: under a limit, the next best counts."""

    def rate(
        self, observation: NDArray[np.float32]
    ) -> tuple[NDArray[np.bool_], NDArray[np.floating[Any]]]:
        """Subsets (A, S) and, higher is better, their ratings (A,) for an observation (1, D)."""
        ...


Run = Callable[[int], NDArray[np.float32]]
"""Runs a technique on the current frame: index → score row (R,). Every first call is charged."""


Rows = dict[int, NDArray[np.float32]]
"""Index of a technique → the score row (R,) that it gave to a frame."""


def highest_z(rows: Iterable[NDArray[np.float32]], place: int) -> float:
    """The largest z-score that score rows (R,) give to a place: a localiser's ``similarity``.

    σ is the population's, and a constant row gives 0, as everywhere (A-MuSIC, III-B). 0 without a
    row, or where the place is none of theirs (−1) or no candidate (−∞).
    """
    found = []
    for row in rows:
        wide = row[row > -np.inf].astype(np.float64)  # the candidates
        if not 0 <= place < row.size or row[int(place)] == -np.inf or wide.min() == wide.max():
            found.append(0.0)
            continue
        found.append(float((row[int(place)] - wide.mean()) / wide.std()))
    return max(found, default=0.0)


@runtime_checkable
class Localiser(Protocol):
    """Gives places itself, straight from score rows."""

    def reset(self, references: int, techniques: int) -> None:
        """Begin a route through a map of R places."""
        ...

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """Place and confidence of a frame; ``run`` gives the rows it asks for."""
        ...


Policy = Selector | Localiser


class Correction(NamedTuple):
    """How SIC and MuSIC work under a policy."""

    statistic: str  # SIC's; "none" for a localiser, which does without
    carry: bool  # whether places are carried on as candidates
    discount: bool  # whether MuSIC discounts alike rows

    @classmethod
    def under(
        cls, policy: Policy, statistic: str, carry: bool | None = None, discount: bool | None = None
    ) -> Correction:
        """The policy's own, or what the user chose.

        Args:
            policy: the policy.
            statistic: that the user chose.
            carry: that the user chose; None: as the statistic has it.
            discount: as `carry`.

        Raises:
            ValueError: for an unknown statistic, or what it has no use for.
        """
        if not isinstance(policy, Selector):
            return cls("none", False, False)
        needs = policy.needs
        settings = SICSettings(
            needs.statistic or statistic,
            carry=carry if needs.carry is None else needs.carry,
            discount=discount if needs.discount is None else needs.discount,
        )
        return cls(settings.statistic, bool(settings.carry), bool(settings.discount))


@dataclass(frozen=True)
class Context:
    """What a policy may be built from."""

    techniques: tuple[str, ...]  # (T,) names, in the bank's order
    seconds: NDArray[np.float64]  # (T,) cost of one run
    statistic: str  # SIC's statistic that the user chose
    seed: int  # for policies that draw
    route: ScoreBank | LiveRoute  # the bank or live route
    # whether places are carried on as candidates; None: as the statistic has it
    carry: bool | None = None
    # whether MuSIC discounts alike rows; None: as the statistic has it
    discount: bool | None = None
    # whether the user insists on the statistic: a selector trained with another is refused then,
    # and else brings its own
    insists: bool = False

    @classmethod
    def of(
        cls,
        route: ScoreBank | LiveRoute,
        *,
        statistic: str,
        seed: int = 0,
        carry: bool | None = None,
        discount: bool | None = None,
    ) -> Context:
        """Context of a bank or live route."""
        return cls(route.techniques, route.seconds, statistic, seed, route, carry, discount)

    @property
    def bank(self) -> ScoreBank:
        """The whole bank: for bounds that need scores and ground truth; no honest policy does.

        Raises:
            ValueError: for a live route, which has no scores yet.
        """
        from amusic_gym.banks.bank import ScoreBank

        if not isinstance(self.route, ScoreBank):
            raise ValueError(
                f"live route {self.route.name!r}: a policy that needs all scores and the ground"
                " truth beforehand runs on a score bank only; extract one, or take another policy"
            )
        return self.route

    def index(self, name: str) -> int:
        """Index of a technique.

        Raises:
            ValueError: for an unknown one, with the nearest suggested.
        """
        if name not in self.techniques:
            raise ValueError(suggest("technique", name, self.techniques))
        return self.techniques.index(name)
