"""A selector that no longer looks: the same use of every technique, at random.

What it loses against the selector it was made from is what looking was worth.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from amusic_gym.policy import Needs


class Frozen:
    """Runs each technique with the share of frames that a selector ran it, whatever is seen.

    Args:
        use: (T,) share of frames on which the selector ran each technique.
        statistic: SIC's statistic that the selector needs.
        carry: whether it needs carried candidates; None: as the statistic has it.
        discount: whether it needs MuSIC's discount; None: as the statistic has it.
        seed: of the draws.
    """

    def __init__(
        self,
        use: ArrayLike,
        statistic: str,
        seed: int = 0,
        *,
        carry: bool | None = None,
        discount: bool | None = None,
    ) -> None:
        self.use = np.asarray(use, np.float64)
        self.needs = Needs(statistic=statistic, carry=carry, discount=discount)
        self._rng = np.random.default_rng(seed)

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Nothing to forget."""

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """Fresh draws (N, S) at the frozen shares."""
        actions = np.zeros(info["present"].shape, np.bool_)
        actions[:, : self.use.size] = self._rng.random((len(actions), self.use.size)) < self.use
        return actions
