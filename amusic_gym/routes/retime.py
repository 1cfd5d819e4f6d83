"""Re-timed recordings: the same query frames, driven through with stops, speeds and jumps.

Most recordings advance by about one place per frame. SIC, like the paper, leans on that. A
re-timed bank has the same map, techniques and costs, and its query rows are rows of the
recording, taken in the order in which a robot that stops, hurries and is carried away would have
seen them.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amusic_gym import bank_files
from amusic_gym.bank import ScoreBank
from amusic_gym.checks import whole
from amusic_gym.ground_truth import GroundTruth
from amusic_gym.routes.world import JUMP, SPEED_CHANGE, SPEEDS

__all__ = ["retime", "retimed_frames", "retimed_truth", "save_retimed"]

_BLOCK = 256  # rows that `save_retimed` holds in memory at a time


def retimed_frames(queries: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Which frame of a recording the robot sees at each frame of its re-timed drive.

    The position p begins at 0 and the speed v at 1. Then ``queries`` times, in this order:

    1. take row ⌊p⌋;
    2. with probability `JUMP`, p becomes one of the recording's frames, each equally likely;
    3. with probability `SPEED_CHANGE`, v is drawn from `SPEEDS`;
    4. p ← p + v;
    5. where p is beyond the last frame, it becomes one of those of the first half.

    So a jump lands v behind the drawn frame, and a new speed holds from the very next frame. All
    p are multiples of a half: nothing is ever rounded.

    Args:
        queries: Q, frames of the recording, at least 1.
        rng: the only source of chance.

    Returns:
        (Q,) int64 frames in [0, Q); the first is 0.

    Raises:
        ValueError: for anything but a whole number of at least 1.
    """
    count = whole("queries", queries, 1)
    jumps = (rng.random(count) < JUMP).tolist()
    changes = (rng.random(count) < SPEED_CHANGE).tolist()
    targets = rng.integers(count, size=count).tolist()
    speeds = rng.choice(SPEEDS, count).tolist()
    restarts = rng.integers((count + 1) // 2, size=count).tolist()
    position, speed, frames = 0.0, 1.0, [0] * count
    for q in range(count):  # scalars only: tens of nanoseconds per frame
        frames[q] = int(position)
        if jumps[q]:
            position = targets[q]
        if changes[q]:
            speed = speeds[q]
        position += speed
        if position > count - 1:
            position = restarts[q]
    return np.asarray(frames, np.int64)


def retime(bank: ScoreBank, seed: int) -> ScoreBank:
    """The bank as a robot would have recorded it that moves as in `retimed_frames`.

    Args:
        bank: the recording.
        seed: whole number >= 0; the same one gives the same frames of any bank of as many.

    Returns:
        A bank in memory with the same map, techniques, costs and tolerance, and as many queries;
        the scores and true places of each are those of the frame that was taken. Its name and
        source say which recording and seed.

    Raises:
        ValueError: for another seed.
    """
    frames = _frames(bank, seed)
    costs, seconds = bank._given  # else a bank under other costs could not go back to its own
    retimed = ScoreBank(
        np.stack([bank.stored[stored][frames] for stored in bank.index]),  # (T, Q, R)
        bank.techniques,
        seconds,
        tolerance=bank.tolerance,
        ground_truth=retimed_truth(bank.truth, frames),
        name=_name(bank, seed),
        source=_source(bank, seed),
        costs=costs,
    )
    return retimed if bank.costs == costs else retimed.with_costs(bank.costs)


def save_retimed(
    bank: ScoreBank, seed: int, path: str | os.PathLike[str], *, name: str = ""
) -> Path:
    """Write what ``retime(bank, seed).save(path)`` would, few rows at a time.

    Args:
        bank: the recording; memory-mapped, it may be larger than memory.
        seed: whole number >= 0.
        path: the folder to make; a bank that is there is replaced.
        name: what to call the new bank; by default, the recording's name and the seed.

    Returns:
        The folder's absolute path.

    Raises:
        ValueError: for another seed, a score that is not finite, or a ``path`` that is something
            other than a bank, or the very bank that is read.
        OSError: when writing fails; what was at ``path`` is still there then.
    """
    frames = _frames(bank, seed)
    path = Path(path)
    if bank.path is not None and Path(os.path.realpath(path)) == bank.path:
        raise ValueError(f"{path} is the bank to re-time, which would be lost; give another folder")
    bank.check_finite()  # a new checksum must not vouch for scores that nothing can use
    return bank_files.write(
        path,
        scores=_blocks(bank, frames),
        truth=retimed_truth(bank.truth, frames),
        techniques=list(zip(bank.techniques, bank.seconds.tolist(), strict=True)),
        tolerance=bank.tolerance,
        name=name or _name(bank, seed),
        source=_source(bank, seed),
        costs=bank.costs,
    )


def retimed_truth(truth: GroundTruth, frames: NDArray[np.int64]) -> GroundTruth:
    """The true places of ``frames``, in their order.

    Args:
        truth: Q queries.
        frames: (n,) int64 in [0, Q), any of them any number of times.

    Returns:
        Ground truth of n queries on the same map.
    """
    begin, count = truth.indptr[frames], np.diff(truth.indptr)[frames]  # (n,) each
    indptr = np.concatenate([[0], np.cumsum(count)])
    within = np.arange(indptr[-1]) - np.repeat(indptr[:-1], count)
    return GroundTruth(indptr, truth.places[np.repeat(begin, count) + within], truth.references)


def _frames(bank: ScoreBank, seed: int) -> NDArray[np.int64]:
    return retimed_frames(bank.queries, np.random.default_rng(whole("seed", seed, 0)))


def _blocks(bank: ScoreBank, frames: NDArray[np.int64]) -> Iterator[NDArray[np.float32]]:
    """The re-timed rows as (≤ `_BLOCK`, R) matrices, technique after technique."""
    for stored in bank.index:
        for first in range(0, len(frames), _BLOCK):
            yield bank.stored[stored][frames[first : first + _BLOCK]]


def _name(bank: ScoreBank, seed: int) -> str:
    return f"{bank.name} retimed {seed}".strip()


def _source(bank: ScoreBank, seed: int) -> str:
    origin = ": ".join(text for text in (bank.name, bank.source) if text)
    return f"re-timed with seed {seed}" + (f" from {origin}" if origin else "")
