"""What the policies around trained networks share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from torch import nn

from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Needs

Network = TypeVar("Network", bound=nn.Module)


class NetworkSelector(ABC, Generic[Network]):
    """A policy that acts as a trained network says.

    Args:
        network: the network.
        statistic: SIC's statistic that it was trained on.
        environment: other arguments of the environment that it was trained on; ``carry`` and
            ``discount`` are as the statistic has them where they are not among these.
        reselection: M of the environment's re-select bit; None: it has none.
    """

    def __init__(
        self,
        network: Network,
        statistic: str,
        environment: Mapping[str, Any] | None = None,
        *,
        reselection: int | None = None,
    ) -> None:
        self.network = network
        extra = dict(environment or {})
        own = SICSettings(
            statistic, carry=extra.pop("carry", None), discount=extra.pop("discount", None)
        )
        self.needs = Needs(
            statistic=statistic,
            carry=own.carry,
            discount=own.discount,
            reselection=reselection,
            allow_idle=extra.pop("allow_idle", False),
            extra=extra,
        )

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget: what it knows is in the observation and the infos."""

    @abstractmethod
    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Actions (N, A) from observations (N, D)."""
