"""Hidden-Markov filter over places, fed by all techniques.

The likelihood of a place is exp(β Σ z) over the techniques' standardised scores. Between frames
the robot moves 0, 1 or 2 places forward, or is carried to any place (the jump rate). Our reading:
a move beyond the map's last place may end anywhere; before the first frame every place is as
likely. β and the jump rate were chosen on simulated routes, as they are and re-timed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_baselines.arguments import number, parts
from amusic_baselines.scores import rows_of, standardised
from amusic_gym.policies.protocol import Context, Run
from amusic_gym.policies.registry import PEER, RegisteredPolicy

MOVES = (0.08, 0.80, 0.12)  # chances of 0, 1 and 2 places per frame
BETA = 0.6
MOST_BETA = 100.0
LEAST_JUMP = 1e-9  # else the belief may vanish everywhere
JUMP = 0.01
REACH = 2  # places to either side of the best one whose mass is the confidence


def advance(belief: NDArray[np.float64], jump: float) -> NDArray[np.float64]:
    """Belief (R,) one frame later, before the frame is seen."""
    moved = np.zeros_like(belief)
    for step, chance in enumerate(MOVES):
        moved[step:] += chance * belief[: max(0, belief.size - step)]
    lost = 1.0 - moved.sum()
    return (1.0 - jump) * (moved + lost / belief.size) + jump / belief.size


@dataclass(eq=False)
class MarkovFilter:
    """Runs everything; the place is the likeliest given all frames so far."""

    beta: float = BETA  # β, weight of a z-score in the logarithm of the likelihood
    jump: float = JUMP  # chance per frame of being carried to any place

    def reset(self, references: int, techniques: int) -> None:
        """Know nothing of the place."""
        self._techniques = techniques
        self._belief = np.full(references, 1.0 / references)  # (R,)

    def locate(self, frame: int, run: Run) -> tuple[int, float]:
        """The likeliest place, and the mass within `REACH` of it."""
        evidence = self.beta * standardised(rows_of(run, range(self._techniques))).sum(axis=0)
        before = self._belief if frame == 0 else advance(self._belief, self.jump)
        belief = before * np.exp(evidence - evidence.max())
        self._belief = belief / belief.sum()
        place = int(self._belief.argmax())
        near = self._belief[max(0, place - REACH) : place + REACH + 1]
        return place, float(near.sum())


def hmm(argument: str | None, context: Context) -> MarkovFilter:
    """``hmm`` or ``hmm:BETA/JUMP``."""
    if argument is None:
        return MarkovFilter()
    beta, jump = parts("hmm", argument, "BETA/JUMP")
    return MarkovFilter(
        number("hmm", argument, "BETA", beta, 0.0, MOST_BETA),
        number("hmm", argument, "JUMP", jump, LEAST_JUMP, 1.0),
    )


POLICY = RegisteredPolicy(
    "hmm", hmm, PEER, "Markov filter", colour="#004488", marker="d", constant=True
)
