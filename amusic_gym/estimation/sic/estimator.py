"""SIC and MuSIC as the estimator of an environment (A-MuSIC, III-A and III-B)."""

from __future__ import annotations

import copy
from collections.abc import Mapping
from typing import Any

from amusic_gym.estimation.batch import Batch
from amusic_gym.estimation.calibration import coefficients
from amusic_gym.estimation.settings import SICSettings
from amusic_gym.estimation.sic.look_back import look_back
from amusic_gym.estimation.sic.state import CARRIED, SLACK, SICState, begin_sums
from amusic_gym.estimation.sic.statistics import factors_of
from amusic_gym.estimation.sic.update import update_routes


class SICEstimator:
    """See :class:`~amusic_gym.estimation.estimator.Estimator`.

    Args:
        settings: statistic, K, F and γ.
        block: M, 0 without re-selection.
        threads: not used: a frame is too short to share.

    Attributes:
        address: of the words that the kernels read.
    """

    state: SICState

    def __init__(self, settings: SICSettings, *, block: int, threads: int = 1) -> None:
        self.settings = settings
        self._block = block

    def allocate(self, batch: Batch, sizes: Mapping[str, int]) -> None:
        """Make room."""
        settings, evidence = self.settings, self.settings.statistic == "evidence"
        factors = factors_of(min(settings.history, sizes["references"]) + 1, evidence)
        calibration = coefficients(settings.statistic).copy()
        sizes = {
            **sizes,
            "coefficients": len(calibration),
            "factors": len(factors),
            "sets": 2 if self._block else 1,
            "sums": sizes["references"] + SLACK,
            "counts": sizes["frames"] + 1,
            "prefix": 0 if settings.gamma == 1.0 else sizes["frames"] + 1,
            "replayed": sizes["frames"] if self._block else 0,
            "values": sizes["candidates"] + CARRIED,
            "carried": CARRIED,
        }
        given = {"batch": batch, "factors": factors, "calibration": calibration}
        if hasattr(self, "state"):
            self.state = self.state.grown(sizes, **given)
        else:
            self.state = SICState(
                sizes,
                history=settings.history,
                gamma=settings.gamma,
                evidence=evidence,
                carry=settings.carry,
                **given,
            )
        self.link(batch)

    def begin(self, i: int, references: int) -> None:
        """Forget route ``i``."""
        state = self.state
        for array in (state.sums[:, i], state.counts[i], state.prefix[i]):
            array.fill(0)
        begin_sums(state.marks[:, i], references, state.sums.shape[-1], self.settings)

    def update(self) -> None:
        """Take the next frame of every active route."""
        update_routes(self.address)

    def look_back(self) -> None:
        """Run all techniques on the last block of the routes that want it."""
        look_back(self.address)

    def link(self, batch: Batch) -> None:
        """Write the addresses of all arrays anew."""
        self.state.batch = batch
        self._words = self.state.write()
        self.address: int = self._words.ctypes.data

    def repeated(self, batch: Batch, copies: int) -> SICEstimator:
        """For a batch in which every route stands ``copies`` times in a row."""
        twin = copy.copy(self)
        twin.state = self.state.repeated(copies, batch=batch)
        twin.link(batch)
        return twin

    def __getstate__(self) -> dict[str, Any]:
        """All but the addresses, which :meth:`link` writes again."""
        return {k: v for k, v in self.__dict__.items() if k not in ("_words", "address")}
