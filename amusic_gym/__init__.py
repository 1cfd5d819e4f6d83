"""Learned selection of visual place recognition techniques, as a Gymnasium environment.

``gymnasium.make("amusic_gym:amusic_gym/TechniqueSelection-v0")`` makes the environment. Importing
this package loads NumPy and Gymnasium only; what needs more is imported when it is used.
"""

from __future__ import annotations

import os

# Behind this package's own limit of pixels; OpenCV reads it once, when it is imported.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "100000000")

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ground_truth import GroundTruth
from amusic_gym.envs.registration import ENV_ID, register
from amusic_gym.utils import threads as threads  # makes forks safe

__version__ = "0.1.0"
__all__ = ["ENV_ID", "GroundTruth", "ScoreBank", "__version__", "register"]

register()
