"""FAB-MAP's probabilities: a Chow-Liu tree over words, and the likelihood of a place.

From Cummins and Newman (*FAB-MAP*, IJRR 2008; FAB-MAP 2, IJRR 2011) with the defaults of
openFABMAP. In arrays of words, z is whether the query shows a word, L whether the place's image
did, and e whether it is really there.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from amusic_gym.techniques.weight_files import WeightFile, write_weights

P_SEEN = 0.39  # probability that a word that is there is seen; one that is not there never is
LEAST_INFORMATION = 0.0005  # mutual information, in nats, below which two words are not joined
SMOOTHING = 0.98  # share of an observed frequency in a probability; the rest is spread evenly
NEVER = 1e-300  # stands for probability 0 in a logarithm
TECHNIQUE = "FAB-MAP"

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True)
class ChowLiuTree:
    """Words that depend on one other word each."""

    parent: NDArray[np.int64]  # (V,) the word that each depends on; a root is its own
    p: Floats  # (V,) probability of seeing a word
    p1: Floats  # (V,) likewise where its parent is seen
    p0: Floats  # (V,) likewise where its parent is not seen

    @classmethod
    def learn(cls, seen: Bools) -> ChowLiuTree:
        """The tree of most mutual information (Chow and Liu 1968) of words (N, V) that images show.

        Words without an edge of ``LEAST_INFORMATION`` are roots.

        Raises:
            ValueError: for no image or no word.
        """
        if seen.ndim != 2 or 0 in seen.shape:
            raise ValueError(f"the images' words have shape {seen.shape}; give some of both")
        counts = seen.astype(np.float64)
        p = _smoothed(counts.mean(axis=0))
        parent = _parents(_mutual_information(counts, p))
        of_parent = counts[:, parent]  # (N, V)
        both = (counts * of_parent).sum(axis=0)
        times = of_parent.sum(axis=0)
        p1 = _smoothed(both / np.maximum(times, 1))
        p0 = _smoothed((counts.sum(axis=0) - both) / np.maximum(len(counts) - times, 1))
        roots = parent == np.arange(len(parent))
        return cls(parent, p, np.where(roots, p, p1), np.where(roots, p, p0))

    def likelihood_terms(self, seen: Bools) -> tuple[Floats, float]:
        """A query's log-likelihoods of places as a linear function: (V,) weights and the constant.

        Each term of the likelihood depends on one word of the place, so that
        log P(z | L) = weights · L + constant exactly. FAB-MAP 2's inverted index is the same less
        the constant.
        """
        there, not_there = self._observation(seen)
        unseen_place = (1 - P_SEEN) * self.p
        unseen_place /= unseen_place + (1 - self.p)  # P(e | L = 0); P(e | L = 1) is 1
        without = _log(unseen_place * there + (1 - unseen_place) * not_there)
        return _log(there) - without, float(without.sum())

    def new_place(self, seen: Bools) -> float:
        """Log-likelihood of a query at a place without a map, by the mean field."""
        there, not_there = self._observation(seen)
        return float(_log(self.p * there + (1 - self.p) * not_there).sum())

    def _observation(self, seen: Bools) -> tuple[Floats, Floats]:
        """P(z | z of the parent, e) for e true and for e false, (V,) each."""
        p_given_parent = np.where(seen[self.parent], self.p1, self.p0)

        def observed(p_seen: float) -> Floats:
            yes = (1 - self.p) * p_seen * p_given_parent
            no = self.p * (1 - p_seen) * (1 - p_given_parent)
            of_one: Floats = np.where(seen, yes, no) / (yes + no)
            return of_one

        return observed(P_SEEN), observed(0.0)

    def save(self, path: str | Path, vocabulary: NDArray[np.float32], training: str) -> Path:
        """Write tree and vocabulary (V, D), whole or not at all, to a name in ``.safetensors``."""
        arrays = {"parent": self.parent.astype(np.float64), "p": self.p, "p1": self.p1}
        arrays |= {"p0": self.p0, "vocabulary": vocabulary.astype(np.float32)}
        return write_weights(path, arrays, {"technique": TECHNIQUE, "training": training})

    @classmethod
    def read(cls, file: WeightFile, length: int) -> tuple[ChowLiuTree, NDArray[np.float32]]:
        """Tree and vocabulary (V, ``length``) of a file; refuses one of something else."""
        file.description(TECHNIQUE)
        vocabulary = file.layer(TECHNIQUE, "vocabulary", None, length)
        words = len(vocabulary)
        parent, p, p1, p0 = (
            file.layer(TECHNIQUE, name, words).astype(np.float64)
            for name in ("parent", "p", "p1", "p0")
        )
        above = parent.astype(np.int64)
        whole = (above == parent).all() and 0 <= above.min() and above.max() < words
        if not whole or not all(((0 < x) & (x < 1)).all() for x in (p, p1, p0)) or _circle(above):
            raise ValueError(
                f"{file.path} holds no tree of words with probabilities; train it again"
            )
        return cls(above, p, p1, p0), vocabulary


def _smoothed(frequency: Floats) -> Floats:
    return SMOOTHING * frequency + (1 - SMOOTHING) / 2


def _log(x: Floats) -> Floats:
    logs: Floats = np.log(np.maximum(x, NEVER))
    return logs


def _mutual_information(counts: Floats, p: Floats) -> Floats:
    """(V, V), of observed joint frequencies and smoothed marginals, as openFABMAP has it."""
    both = counts.T @ counts / len(counts)
    alone = counts.mean(axis=0)
    found = np.zeros_like(both)
    joints = (
        (both, p[:, None] * p),
        (alone[:, None] - both, p[:, None] * (1 - p)),
        (alone - both, (1 - p)[:, None] * p),
        (1 - alone[:, None] - alone + both, (1 - p)[:, None] * (1 - p)),
    )
    for joint, independent in joints:
        joint = np.maximum(joint, 0)  # rounding
        found += joint * _log(joint / independent)
    return found


def _parents(information: Floats) -> NDArray[np.int64]:
    """(V,) parents in the spanning tree of most information, or in one tree for each part."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order, minimum_spanning_tree

    words = len(information)
    upper = np.triu(information, 1)
    first, second = np.nonzero(upper >= LEAST_INFORMATION)
    parent = np.arange(words)
    if not len(first):
        return parent
    values = upper[first, second]
    lengths = values.max() - values + 1  # a tree of least length; 0 would mean no edge
    tree = minimum_spanning_tree(csr_array((lengths, (first, second)), shape=(words, words)))
    best = first[values.argmax()]
    reached = np.zeros(words, bool)
    for root in (best, *range(words)):
        if reached[root]:
            continue
        order, above = breadth_first_order(tree, root, directed=False)
        reached[order] = True
        parent[order[1:]] = above[order[1:]]
    return parent


def _circle(parent: NDArray[np.int64]) -> bool:
    """Whether following parents fails to end at a root from any word."""
    above = parent
    for _ in range(len(parent).bit_length()):
        above = above[above]  # twice as far up
    return bool((parent[above] != above).any())
