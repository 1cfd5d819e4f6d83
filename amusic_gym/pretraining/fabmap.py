"""Training of FAB-MAP's vocabulary and Chow-Liu tree on images of the user's."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.routes.folders import ImageFolder
from amusic_gym.techniques.fabmap import local_features, words_of
from amusic_gym.techniques.fabmap_model import ChowLiuTree
from amusic_gym.utils.checks import whole

MOST_FEATURES = 200_000  # local features that a vocabulary is learned from: more are drawn from


def train_fabmap(
    images: Path, out: Path, *, words: int, seed: int, advance: Callable[[int], object]
) -> ChowLiuTree:
    """Learn a vocabulary by k-means and its Chow-Liu tree; write both.

    Raises:
        FileNotFoundError: when there is no such folder.
        ValueError: for a number of words that no vocabulary has, fewer features than words, or
            another ending of the file's name.
    """
    whole("the number of words", words, 2, most=10_000)
    if out.suffix != ".safetensors":
        raise ValueError(f"{out} should end in .safetensors; rename it")
    features = []
    for image in ImageFolder(images):
        features.append(local_features(image))
        advance(1)
    vocabulary = _vocabulary(np.concatenate(features), words, seed)
    tree = ChowLiuTree.learn(np.stack([words_of(each, vocabulary) for each in features]))
    training = f"{len(features)} images, {words} words, seed {seed}"
    tree.save(out, vocabulary, training)
    return tree


def _vocabulary(features: NDArray[np.float32], words: int, seed: int) -> NDArray[np.float32]:
    """(V, D) centres of k-means on features (n, D)."""
    if len(features) < words:
        raise ValueError(
            f"the images have {len(features)} local features for {words} words; give more images, "
            "or fewer words"
        )
    if len(features) > MOST_FEATURES:
        drawn = np.random.default_rng(seed).choice(len(features), MOST_FEATURES, replace=False)
        features = features[np.sort(drawn)]
    cv2.setRNGSeed(seed)
    ends = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 20, 1e-4)
    unlabelled = np.empty(0, np.int32)
    centres = cv2.kmeans(features, words, unlabelled, ends, 1, cv2.KMEANS_PP_CENTERS)[2]
    return np.asarray(centres, np.float32)
