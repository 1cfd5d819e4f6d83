"""Per-frame oracle: a bound, not a policy that a robot could run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_gym.bank import ScoreBank
from amusic_gym.policy import Context, Needs
from amusic_gym.settings import SICSettings
from baselines.arguments import none


class Oracle:
    """Runs the cheapest technique whose corrected match is right, given its own history.

    Where none is right, the cheapest technique runs. It knows scores and ground truth beforehand,
    from the constructor alone.

    Args:
        bank: scores and ground truth of the route.
        settings: SIC's statistic, K, F and γ.
    """

    def __init__(self, bank: ScoreBank, settings: SICSettings) -> None:
        self.bank = bank
        self.settings = settings
        self.needs = Needs(statistic=settings.statistic)
        self._order = np.argsort(bank.seconds, kind="stable")

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Begin the route anew.

        Raises:
            ValueError: for more than one route: the oracle knows one.
        """
        from amusic_gym.sic import SIC

        if mask.size != 1:
            raise ValueError(f"the oracle knows one route, not {mask.size}; run one at a time")
        self._sics = [SIC(self.bank.references, self.settings) for _ in self.bank.techniques]

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """One bit: the cheapest technique that will be right."""
        frame = int(info["frame"][0]) + 1
        chosen = self._choose(frame)
        for technique, sic in enumerate(self._sics):
            if technique == chosen:
                sic.correct(self.bank.row(technique, frame))
            else:
                sic.skip()
        actions = np.zeros((1, len(self._sics)), np.bool_)
        actions[0, chosen] = True
        return actions

    def _choose(self, frame: int) -> int:
        for technique in self._order:
            match = self._sics[technique].preview(self.bank.row(int(technique), frame))
            if self.bank.truth.correct(np.array([match.place]), np.array([frame]))[0]:
                return int(technique)
        return int(self._order[0])


def oracle(argument: str | None, context: Context) -> Oracle:
    """``oracle``."""
    none("oracle", argument)
    return Oracle(context.bank, SICSettings(statistic=context.statistic))
