"""FAB-MAP: which words places show, and how probable that makes them (Cummins and Newman 2008)."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.fabmap_model import TECHNIQUE, Bools, ChowLiuTree
from amusic_gym.techniques.preparation import check_image
from amusic_gym.techniques.protocol import Descriptor, Image, Parameters, Technique
from amusic_gym.techniques.weight_files import read_weights

SIDE = 480  # pixels of the longer side that features are looked for in
LENGTH = 128  # numbers of a local feature
_LEAST = 16  # pixels of the shorter side


def local_features(image: Image) -> NDArray[np.float32]:
    """RootSIFT of the grey image, its longer side brought to ``SIDE``: (n, 128), of length 1.

    openFABMAP uses SURF, which OpenCV's wheels do not have.

    Raises:
        ValueError: for an array that is no image.
    """
    check_image(image)
    height, width = image.shape[:2]
    scale = SIDE / max(height, width)
    size = (max(_LEAST, round(width * scale)), max(_LEAST, round(height * scale)))
    grey = cv2.resize(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), size)
    found = cv2.SIFT.create().detectAndCompute(grey, None)[1]
    if found is None:
        return np.zeros((0, LENGTH), np.float32)
    sums = np.maximum(np.abs(found).sum(axis=1, keepdims=True), 1e-9)
    roots: NDArray[np.float32] = np.sqrt(found / sums).astype(np.float32)
    return roots


def words_of(features: NDArray[np.float32], vocabulary: NDArray[np.float32]) -> Bools:
    """(V,) whether a feature (n, D) is nearest to each word (V, D)."""
    seen = np.zeros(len(vocabulary), bool)
    if len(features):
        distances = (vocabulary**2).sum(axis=1) - 2 * features @ vocabulary.T  # (n, V)
        seen[distances.argmin(axis=1)] = True
    return seen


class FABMAP(Technique):
    """Log-likelihood of a query's words at each place; V + 1 values, dot product.

    A place's descriptor is its words and a 1, a query's what they weigh and a constant, so that
    the dot product is FAB-MAP's log-likelihood. There is no posterior, no motion model and no
    decision on new places: the environment has its own; :meth:`new_place` tells the latter's
    log-likelihood.

    Args:
        weights: a vocabulary with its Chow-Liu tree, from ``scripts/train_fabmap.py``, learned on
            images of other places. None ships.

    Raises:
        FileNotFoundError: when there is no such file.
        ValueError: without weights, or for a file of something else.
    """

    name = TECHNIQUE

    def __init__(self, weights: str | Path | None = None) -> None:
        if weights is None:
            raise ValueError(
                "FAB-MAP needs a vocabulary, learned on images of other places: python "
                "scripts/train_fabmap.py --images DIR --out fabmap.safetensors, then "
                "--weights fabmap=fabmap.safetensors"
            )
        file = read_weights(weights)
        self._digest = file.digest
        self._tree, self._vocabulary = ChowLiuTree.read(file, LENGTH)

    def parameters(self) -> Parameters:
        """The digest of the vocabulary's file, and the input's size."""
        return {"weights": self._digest, "side": SIDE}

    def words(self, image: Image) -> Bools:
        """(V,) whether the image shows each word."""
        return words_of(local_features(image), self._vocabulary)

    def describe(self, image: Image) -> Descriptor:
        """(V + 1,) the words, and 1."""
        return np.append(self.words(image), True).astype(np.float32)

    def describe_query(self, image: Image) -> Descriptor:
        """(V + 1,) what each word of a place adds to the log-likelihood, and its constant."""
        weights, constant = self._tree.likelihood_terms(self.words(image))
        return np.append(weights, constant).astype(np.float32)

    def new_place(self, image: Image) -> float:
        """Log-likelihood that the image was taken at a place that is not on the map."""
        return self._tree.new_place(self.words(image))
