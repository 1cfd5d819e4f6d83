"""One sequence against itself: only what lies more than some frames back is a candidate."""

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.utils.checks import whole


def truth_without_recent(truth: GroundTruth, recent: int) -> GroundTruth:
    """The true places of each frame that lie more than ``recent`` frames before it.

    Raises:
        ValueError: where there are not as many places as frames; where no place is left.
    """
    whole("exclude_recent", recent, 0)
    if truth.queries != truth.references:
        raise ValueError(
            f"exclude_recent is for one sequence against itself, but there are {truth.queries} "
            f"queries and {truth.references} places; leave it out"
        )
    matrix = truth.matrix() & np.tri(truth.queries, k=-(min(recent, truth.queries) + 1), dtype=bool)
    if not matrix.any():
        raise ValueError(
            f"exclude_recent is {recent}, and no frame has a true place more than {recent} frames "
            "back; give ground truth that lists where the sequence comes back to a place"
        )
    return GroundTruth.from_matrix(matrix)


def rows_without_recent(
    blocks: Iterable[NDArray[np.float32]], queries: int, recent: int
) -> Iterator[NDArray[np.float32]]:
    """Score rows (n, Q) with −∞ at the frame itself, the ``recent`` before it and all after it."""
    frame = 0
    for block in blocks:
        frames = (frame + np.arange(len(block))) % queries
        masked = np.arange(block.shape[1]) >= (frames - recent)[:, None]
        yield np.where(masked, np.float32(-np.inf), block)
        frame += len(block)
