"""How a robot moves along a map: one place per frame, or with stops, other speeds and jumps.

The one walk of simulated routes (`amusic_gym.routes.simulate`) and of re-timed recordings
(`amusic_gym.routes.retime`).
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

Motion = Literal["recorded", "paced", "kidnapped"]
"""``recorded``: one place per frame; ``paced``: stops, half, one-and-a-half and double speed;
``kidnapped``: paced, and jumps to any place."""

MOTIONS: tuple[str, ...] = get_args(Motion)
RECORDED, PACED, KIDNAPPED = MOTIONS

SPEEDS = (1.0, 1.0, 1.0, 1.0, 0.5, 1.5, 0.0, 2.0)  # places per frame
SPEED_CHANGE = 0.03  # chance per frame of drawing a new speed out of SPEEDS
JUMP = 0.02  # chance per frame of a jump to a uniform place


def walk(
    rng: np.random.Generator,
    frames: int,
    size: int,
    *,
    jump: float,
    speed_change: float = SPEED_CHANGE,
    start: float = 0.0,
    between: bool = False,
) -> NDArray[np.float64]:
    """Positions of a robot that changes its speed and may be carried away.

    The position p begins at ``start`` and the speed v at 1. Then, in each frame:

    1. take p;
    2. with probability ``speed_change``, v is drawn from `SPEEDS`;
    3. p ← p + v;
    4. where p is ``size`` or more, it becomes 0;
    5. with probability ``jump``, p becomes a uniform place.

    With the same generator, a walk with jumps draws the same speeds as one without.

    Args:
        rng: the only source of chance.
        frames: n.
        size: places; p stays below it.
        jump: chance per frame of a jump.
        speed_change: chance per frame of drawing a speed.
        start: p of the first frame, in [0, size).
        between: whether a jump may end between two places; else p stays a multiple of a half
            where ``start`` is one.

    Returns:
        (n,) float64 positions in [0, size), in places.
    """
    changes = (rng.random(frames) < speed_change).tolist()
    speeds = rng.choice(SPEEDS, frames).tolist()
    jumps = (rng.random(frames) < jump).tolist()
    targets = rng.random(frames) * size
    places = (targets if between else np.floor(targets)).tolist()
    position, speed, taken = start, 1.0, [0.0] * frames
    for frame in range(frames):  # scalars only: tens of nanoseconds per frame
        taken[frame] = position
        if changes[frame]:
            speed = speeds[frame]
        position += speed
        if position >= size:
            position = 0.0
        if jumps[frame]:
            position = places[frame]
    return np.asarray(taken, np.float64)
