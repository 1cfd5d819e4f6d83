"""Per-frame oracle: a bound, not a policy that a robot could run."""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import none
from amusic_gym.banks.bank import ScoreBank
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.policies.protocol import Context, Needs
from amusic_gym.policies.registry import BOUND, RegisteredPolicy


class Oracle:
    """Runs the cheapest technique after which the fused prediction is right, given what ran so far.

    Where none is right, the cheapest technique runs. It knows scores and ground truth beforehand,
    from the bank that it is made with.
    """

    def __init__(self, bank: ScoreBank, settings: SICSettings) -> None:
        self.bank = bank
        self.settings = settings
        self.needs = Needs(settings.statistic, settings.carry, settings.discount)
        self._order = np.argsort(bank.seconds, kind="stable").tolist()

    def reset(self, mask: NDArray[np.bool_]) -> None:
        """Begin the route anew; a ValueError for several routes: the oracle knows one."""
        if mask.size != 1:
            raise ValueError(f"the oracle knows one route, not {mask.size}; run one at a time")
        foresight = _Belief if self.settings.statistic == "belief" else _Diagonals
        self._foresight = foresight(self.bank, self.settings)

    def act(self, observation: NDArray[np.float32], info: Mapping[str, Any]) -> NDArray[np.bool_]:
        """One bit: the cheapest technique that will be right."""
        frame = int(info["frame"][0]) + 1
        right = (
            technique
            for technique in self._order
            if self.bank.truth.is_true(self._foresight.place(technique, frame), frame)
        )
        chosen = next(right, self._order[0])
        self._foresight.take(chosen, frame)
        actions = np.zeros((1, len(self._order)), np.bool_)
        actions[0, chosen] = True
        return actions


class _Diagonals:
    """Each technique's own SIC: where one technique runs per frame, MuSIC takes its match.

    As :class:`_Belief`, it tells the `place` if only one technique ran on the next frame, and
    lets it run there, `take`.
    """

    def __init__(self, bank: ScoreBank, settings: SICSettings) -> None:
        from amusic_gym.estimation.sic.correction import SIC

        self.bank = bank
        self.sics = [SIC(bank.references, settings) for _ in bank.techniques]
        self.fused = -1  # the last match, moved on

    def place(self, technique: int, frame: int) -> int:
        return self.sics[technique].preview(self.bank.row(technique, frame), self.fused).place

    def take(self, technique: int, frame: int) -> None:
        for other, sic in enumerate(self.sics):
            if other == technique:
                place = sic.correct(self.bank.row(technique, frame), self.fused).place
            else:
                sic.skip()
        self.fused = place + 1 if place + 1 < self.bank.references else -1


class _Belief:
    """The route itself, driven a second time: all techniques feed one belief."""

    def __init__(self, bank: ScoreBank, settings: SICSettings) -> None:
        from amusic_gym.envs.episode import Episodes
        from amusic_gym.envs.memory import Route

        columns = np.arange(len(bank.techniques))
        self.episodes = Episodes(1, columns.size, settings)
        self.episodes.begin(0, Route(bank, 0, bank.queries, columns, 1.0, 0))

    def place(self, technique: int, frame: int) -> int:
        return self._step(copy.deepcopy(self.episodes), technique)

    def take(self, technique: int, frame: int) -> None:
        self._step(self.episodes, technique)

    @staticmethod
    def _step(episodes: Any, technique: int) -> int:
        actions = np.zeros((1, episodes.slots), np.bool_)
        actions[0, technique] = True
        return int(episodes.step(actions).routes["prediction"][0])


def oracle(argument: str | None, context: Context) -> Oracle:
    """``oracle``."""
    none("oracle", argument)
    settings = SICSettings(context.statistic, carry=context.carry, discount=context.discount)
    return Oracle(context.bank, settings)


POLICY = RegisteredPolicy(
    "oracle", oracle, BOUND, needs_truth="of the route itself", colour="#999933", marker="*"
)
