"""How the belief moves from one frame to the next."""

from __future__ import annotations

from typing import Any

from amusic_gym.estimation.belief.memory import REACH
from amusic_gym.estimation.belief.rates import (
    BINOMIAL,
    LOCKED,
    SHARES,
    SPEEDS,
    WANDER,
    WAYS,
    Rates,
    share_of,
)
from amusic_gym.estimation.belief.rows import total
from amusic_gym.kernels.compiling import apart, inner
from amusic_gym.kernels.tables import part


@apart
def add_lines(belief: Any, first: int, stop: int, size: int, out: Any) -> None:
    """Sum of some lines of the belief."""
    for c in range(size):
        out[c] = 0.0
    for way in range(first, stop):
        line = part(belief[way], REACH, size)
        for c in range(size):
            out[c] += line[c]


@apart
def drift(rates: Rates, belief: Any, size: int, gained: Any) -> None:
    """Let images look farther ahead or behind, and steady motion end and begin.

    As in Ehrenfest's urns: towards the middle, the farther off the likelier, so that the offsets
    are binomial in the long run. ``gained`` is the (R,) belief that steady motion takes over.
    """
    stay, step = 1.0 - rates.leave, rates.wander / (2 * WANDER)
    first = LOCKED + 1
    for c in range(size):
        i = REACH + c
        before = 0.0  # what the line of one place less held
        for off in range(2 * WANDER + 1):
            own = belief[first + off, i]
            after = belief[first + off + 1, i] if off < 2 * WANDER else 0.0
            moved = step * (before * (2 * WANDER - off + 1) + after * (off + 1))
            kept = (1.0 - rates.wander) * own
            new = rates.wandering * BINOMIAL[off] * gained[c]
            belief[first + off, i] = stay * (kept + moved) + new
            before = own


@apart
def mix(rates: Rates, belief: Any, size: int, fast: Any, even: Any) -> None:
    """Let speeds change, and steady motion end and begin, in place; (R,) scratch comes last."""
    add_lines(belief, 0, SPEEDS, size, fast)
    add_lines(belief, LOCKED, WAYS, size, even)
    keep, change = (1.0 - rates.change) * (1.0 - rates.settle), rates.change * (1.0 - rates.settle)
    for way in range(SPEEDS):
        line, share, leave = part(belief[way], REACH, size), SHARES[way], rates.leave
        for c in range(size):
            line[c] = keep * line[c] + share * (change * fast[c] + leave * even[c])
    settle = rates.settle
    for c in range(size):
        fast[c] *= settle
    stay, still = 1.0 - rates.leave, 1.0 - rates.wandering
    locked = part(belief[LOCKED], REACH, size)
    for c in range(size):
        locked[c] = stay * locked[c] + still * fast[c]
    drift(rates, belief, size, fast)


@inner
def chances_of(rates: Rates, way: int, stand: float) -> tuple[float, float, float, float]:
    """Chances that a way of moving goes 0, 1, 2 or 3 places in a frame."""
    slack = rates.slack
    if way == 0:
        return (1.0 - slack) * stand, slack, 0.0, 0.0
    if way == 1:
        return 0.5 * stand, 0.5, 0.0, 0.0
    if way == 2:
        return slack * stand, 1.0 - 2.0 * slack, slack, 0.0
    if way == 3:
        return 0.0, 0.5, 0.5, 0.0
    return 0.0, slack, 1.0 - 2.0 * slack, slack


@apart
def advance(rates: Rates, source: Any, target: Any, size: int, stand: float) -> tuple[float, float]:
    """Move every line of the belief on by a frame; returns the sums of all and of steady motion."""
    whole, steady = 0.0, 0.0
    for way in range(SPEEDS):
        p0, p1, p2, p3 = chances_of(rates, way, stand)
        old, new = source[way], part(target[way], REACH, size)
        for c in range(size):
            new[c] = p0 * old[c + 3] + p1 * old[c + 2] + p2 * old[c + 1] + p3 * old[c]
        whole += total(new, size)
    for way in range(LOCKED, WAYS):
        old, new = part(source[way], REACH - 1, size), part(target[way], REACH, size)
        for c in range(size):
            new[c] = old[c]
        steady += total(new, size)
    return whole + steady, steady


@apart
def move(
    rates: Rates,
    mind: Any,
    belief: Any,
    size: int,
    stand: float,
    jump: float,
    fast: Any,
    even: Any,
) -> None:
    """Predict the belief of the next frame: new speeds, motion, jumps.

    Args:
        rates: of the motion.
        mind: MIND record.
        belief: (2, WAYS, REACH + R).
        size: R.
        stand: how much likelier it is that the robot stood.
        jump: factor on the chance of a jump.
        fast: (R,) scratch.
        even: (R,) scratch.
    """
    source, target = belief[mind.side], belief[1 - mind.side]
    mix(rates, source, size, fast, even)
    whole, steady = advance(rates, source, target, size, stand)
    mind.side = 1 - mind.side
    off_map = whole < 1e-200
    if off_map:
        whole, steady = 1.0, 0.0
    steady /= whole
    often, seldom = min(rates.jump * jump, 0.9), min(rates.steady_jump * jump, 0.9)
    lost = (often * (1.0 - steady) + seldom * steady) / size
    for way in range(WAYS):
        keep, gain = (1.0 - seldom) / whole, 0.0
        if way < SPEEDS:
            keep, gain = (1.0 - often) / whole, lost * SHARES[way]
        if off_map:
            keep, gain = 0.0, share_of(rates, way) / size
        line = part(target[way], REACH, size)
        for c in range(size):
            line[c] = keep * line[c] + gain
