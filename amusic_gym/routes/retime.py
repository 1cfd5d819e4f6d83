"""Re-timed recordings: the same query frames, driven through with stops, speeds and jumps.

Most recordings advance by about one place per frame. SIC, like the paper, leans on that. A
re-timed bank has the same map, techniques and costs, and its query rows are rows of the
recording, taken in the order in which a robot that moves otherwise would have seen them. Two looks
at one place never give the very same scores, so every row gets a little noise of its own.
"""

import os
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.banks.scores import floored
from amusic_gym.routes.bank_images import BankImages
from amusic_gym.routes.motion import JUMP, KIDNAPPED, PACED, walk
from amusic_gym.utils.checks import whole
from amusic_gym.utils.names import suggest

RETIMINGS = (PACED, KIDNAPPED)  # motions that a recording can be re-timed by; see `routes.motion`
NOISE = 0.1  # standard deviation of the noise on a row, as a share of the row's own
_BLOCK = 64  # rows that `save_retimed` holds in memory at a time


def retimed_frames(
    queries: int, rng: np.random.Generator, motion: str = KIDNAPPED
) -> NDArray[np.int64]:
    """(Q,) int64 frames in [0, Q) of a recording that the robot sees on its re-timed drive.

    ⌊p⌋ of `amusic_gym.routes.motion.walk` over the recording's frames, for as many frames as the
    recording has; ``kidnapped`` is ``paced`` with jumps to any frame, each equally likely. ``rng``
    is the only source of chance. The first frame is 0.

    Raises:
        ValueError: for anything but a whole number of at least 1, or for another motion.
    """
    count = whole("queries", queries, 1)
    if motion not in RETIMINGS:
        raise ValueError(suggest("motion", motion, RETIMINGS))
    positions = walk(rng, count, count, jump=JUMP if motion == KIDNAPPED else 0.0)
    return positions.astype(np.int64)  # all are at least 0: rounded down


def retime(bank: ScoreBank, seed: int, motion: str = KIDNAPPED) -> ScoreBank:
    """The bank as a robot would have recorded it that moves as in `retimed_frames`.

    Every row that is taken gets Gaussian noise of its own, `NOISE` times the row's standard
    deviation: a robot that stands sees a place, but never exactly the same scores twice. The
    noise of a technique depends on the seed and on its scores at frame 0. So it is the same in any
    subset of the techniques and in any order of them, and a copy of a technique stays a copy.

    Args:
        bank: the recording.
        seed: whole number >= 0; the same one gives the same frames of any bank of as many.
        motion: ``paced`` or ``kidnapped``.

    Returns:
        A bank in memory with the same map, techniques, costs and tolerance, and as many queries;
        the true places of each are those of the frame that was taken, and so are the scores, but
        for the noise. Its name and source say which recording, motion and seed.

    Raises:
        ValueError: for another seed or motion.
    """
    costs, seconds = bank._given  # else a bank under other costs could not go back to its own
    retimed = _retimed(bank, seed, motion, seconds, costs)
    return retimed if bank.costs == costs else retimed.with_costs(bank.costs)


def save_retimed(
    bank: ScoreBank,
    seed: int,
    path: str | os.PathLike[str],
    motion: str = KIDNAPPED,
    *,
    name: str = "",
) -> Path:
    """Write what ``retime(bank, seed, motion).save(path)`` would, few rows at a time.

    Args:
        bank: the recording; memory-mapped, it may be larger than memory.
        seed: as for :func:`retime`; so is ``motion``.
        path: the folder to make; a bank that is there is replaced.
        motion: ``paced`` or ``kidnapped``.
        name: what to call the new bank; by default, the recording's name, the motion and the seed.

    Returns:
        The folder's absolute path.

    Raises:
        ValueError: as :func:`retime` and `ScoreBank.save`; for the very bank that is read.
        OSError: when writing fails; what was at ``path`` is still there then.
    """
    path = Path(path)
    if bank.path is not None and Path(os.path.realpath(path)) == bank.path:
        raise ValueError(f"{path} is the bank to re-time, which would be lost; give another folder")
    bank.check_finite()  # a new checksum must not vouch for scores that nothing can use
    return _retimed(bank, seed, motion, bank.seconds, bank.costs, name, path).path or path


def _retimed(
    bank: ScoreBank,
    seed: int,
    motion: str,
    seconds: NDArray[np.float64],
    costs: str,
    name: str = "",
    out: Path | None = None,
) -> ScoreBank:
    rng = np.random.default_rng(whole("seed", seed, 0))
    frames = retimed_frames(bank.queries, rng, motion)
    origin = ": ".join(text for text in (bank.name, bank.source) if text)
    retimed = ScoreBank.from_rows(
        _blocks(bank, frames, seed),
        bank.techniques,
        seconds,
        truth=retimed_truth(bank.truth, frames),
        tolerance=bank.tolerance,
        name=name or f"{bank.name} {motion} {seed}".strip(),
        source=f"re-timed ({motion}) with seed {seed}" + (f" from {origin}" if origin else ""),
        costs=costs,
        out=out,
    )
    if retimed.path is not None and (images := BankImages.load(bank)) is not None:
        images.frames(frames.tolist()).save(retimed.path)
    return retimed


def retimed_truth(truth: GroundTruth, frames: NDArray[np.int64]) -> GroundTruth:
    """Ground truth of ``frames`` (n,) int64 in [0, Q), in their order and as often as they come."""
    return GroundTruth.from_lists([truth.of(frame) for frame in frames.tolist()], truth.references)


def _blocks(bank: ScoreBank, frames: NDArray[np.int64], seed: int) -> Iterator[NDArray[np.float32]]:
    """The re-timed rows as (≤ `_BLOCK`, R) matrices, technique after technique."""
    for stored in bank.index:
        scores = bank.stored[stored]  # (Q, R)
        chance = np.random.default_rng([seed, zlib.crc32(scores[0].tobytes())])
        for first in range(0, len(frames), _BLOCK):
            rows = scores[frames[first : first + _BLOCK]]
            noise = chance.standard_normal(rows.shape, np.float32)
            noise *= NOISE * floored(rows).std(axis=1, dtype=np.float64, keepdims=True)
            rows += noise
            yield rows
