"""The model of a simulated route: the drive, the conditions, repeated and bland places, decoys."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_gym.routes.ranges import draw_integer

Floats = NDArray[np.float32]
Ints = NDArray[np.int64]


@dataclass(frozen=True)
class RouteModel:
    """What all techniques share on one route."""

    place: NDArray[np.float64]  # (Q,) position of each frame, in places, may lie between two
    seen: NDArray[np.float64]  # (Q,) position that its image looks like
    condition: Ints  # (Q,) which condition each frame is in
    competence: NDArray[np.float64]  # (T, C) 0 useless .. 1 noiseless
    source: Ints  # (R,) the place that each place repeats; itself where none
    bland: Floats  # (R,) +1 hub, -1 void, 0 neither
    decoy: NDArray[np.float64] | None = None  # (T, Q) a wrong position that images look like, too
    lure: NDArray[np.float64] | None = None  # (T, Q) how much of the noise looks like it, 0 .. 1
    leaves: int | None = None  # frame from which on the robot is off the map


def decoys(
    rng: np.random.Generator,
    place: NDArray[np.float64],
    spell: Ints,
    references: int,
    techniques: int,
    *,
    chance: float,
    shared: float,
    strength: tuple[float, float],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Wrong positions that images look like for a spell, one that techniques share among them.

    In each spell a technique has a decoy with a ``chance``; it is the spell's shared one, by the
    chance ``shared``, or its own. A decoy moves along with the robot, or stays where it is.
    ``place`` (Q,) are the true positions, ``spell`` (Q,) numbers each frame's; ``strength`` is the
    range of how much of a technique's noise looks like its decoy.

    Returns:
        (T, Q) positions and (T, Q) strengths, 0 where there is none.
    """
    position: NDArray[np.float64] = np.zeros((techniques, place.size))
    lure: NDArray[np.float64] = np.zeros((techniques, place.size))
    last = references - 1.0
    for number in np.unique(spell):
        frames = np.flatnonzero(spell == number)
        starts = rng.uniform(0.0, last, techniques + 1)  # the last one is shared
        moves = rng.random(techniques + 1) < 0.5
        took = rng.random(techniques) < chance
        which = np.where(rng.random(techniques) < shared, techniques, np.arange(techniques))
        strengths = rng.uniform(*strength, techniques)
        for t in np.flatnonzero(took):
            along = place[frames] - place[frames[0]] if moves[which[t]] else 0.0
            position[t, frames] = np.clip(starts[which[t]] + along, 0.0, last)
            lure[t, frames] = strengths[t]
    return position, lure


def repeated_places(
    rng: np.random.Generator, references: int, density: float, length: tuple[int, int]
) -> Ints:
    """For each place the earlier place it repeats, or itself."""
    source = np.arange(references)
    for _ in range(rng.poisson(density * references / 100.0)):
        size = min(draw_integer(rng, length), references // 2)
        start = int(rng.integers(size, references - size + 1))
        earlier = int(rng.integers(0, start - size + 1))
        source[start : start + size] = source[earlier : earlier + size]
    return source


def bland_places(
    rng: np.random.Generator,
    references: int,
    density: float,
    length: tuple[int, int],
    hubs: float,
) -> Floats:
    """Which places attract (+1) or repel (-1) all queries."""
    bland = np.zeros(references, np.float32)
    for _ in range(rng.poisson(density * references / 100.0)):
        start, size = int(rng.integers(references)), draw_integer(rng, length)
        bland[start : start + size] = 1.0 if rng.random() < hubs else -1.0
    return bland


def no_repeats(rng: np.random.Generator, length: int, kinds: int) -> Ints:
    """`length` numbers below `kinds`: all of them once in random order, then never one twice."""
    order = rng.permutation(kinds)[:length]
    if kinds == 1:
        return np.zeros(length, np.int64)
    steps = rng.integers(1, kinds, max(length - kinds, 0))
    later = (order[-1] + np.cumsum(steps)) % kinds
    return np.concatenate([order, later]).astype(np.int64)
