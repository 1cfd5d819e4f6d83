"""One technique without correction: the best score of every row."""

from dataclasses import dataclass

import numpy as np

from amusic_baselines.arguments import required
from amusic_gym.banks.scores import floored
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy


@dataclass(eq=False)
class Raw:
    """Uncorrected matches of one technique; the raw score is the confidence."""

    technique: int  # its index

    def reset(self, references: int, techniques: int) -> None:
        """Nothing to forget."""

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """Place of the best score, ties to the lower."""
        row = floored(run(self.technique))
        place = int(np.argmax(row))
        return place, float(row[place])


def raw(argument: str | None, context: Context) -> Raw:
    """``raw:NAME``."""
    return Raw(context.index(required("raw", argument, "NAME")))


POLICY = RegisteredPolicy(
    "raw",
    raw,
    PEER,
    label_of="{}, no SIC".format,
    colour=None,
    line=":",
    charted=False,
    constant=True,
)
