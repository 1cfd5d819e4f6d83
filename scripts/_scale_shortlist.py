"""What a coarse index would change: time and memory, and accuracy after SIC."""

import importlib
import warnings
from collections.abc import Sequence
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np
from _scale_growth import MIB, Row, milliseconds
from amusic_baselines import make_policy
from numpy.typing import NDArray

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.banks.ranking import highest
from amusic_gym.cli.demo_tours import FIRST_WORLD, WORLDS
from amusic_gym.cli.images import extract_tour
from amusic_gym.evaluation.metrics import summarise
from amusic_gym.evaluation.rollout import rollout
from amusic_gym.policies.protocol import Context
from amusic_gym.routes.simulated_descriptors import smooth
from amusic_gym.routes.tours import make_tour
from amusic_gym.worlds import render_folders

DIMENSIONS, INNER = 256, 32  # of a descriptor, and of what varies in it
SMOOTHNESS, GRAIN = 5.0, 0.2  # of descriptors along the route: see `Simulation`
TOLERANCE = 2
TECHNIQUES = ("hog", "calc", "netvlad")  # on rendered images
SECONDS = {"HOG": 1.0, "CALC": 1.0, "NetVLAD": 1.0}  # which change nothing here
COMPETENCES = (0.9, 0.5)  # share of a query's descriptor that is its place's; the rest is noise
SAMPLES, ITERATIONS = 32, 5  # descriptors per list that k-means learns from, and its rounds

FILLS = ("floor", "mean", "none")
"""What places beyond the shortlist get: the least score of it, the row's mean, −∞."""

Floats = NDArray[np.float32]


BEST = 50  # places that a search gives: SIC's K


class NumpyIndex:
    """An inverted file in NumPy: places sorted by centroid, which k-means learns from a sample."""

    name = "NumPy"

    def __init__(self, descriptors: Floats, lists: int) -> None:
        rng = np.random.default_rng(0)
        size = min(len(descriptors), SAMPLES * lists)
        sample = descriptors[np.sort(rng.choice(len(descriptors), size, replace=False))]
        self.centroids = sample[rng.choice(size, lists, replace=False)]
        for _ in range(ITERATIONS):
            near = self._nearest(sample)
            sums = np.zeros_like(self.centroids)
            np.add.at(sums, near, sample)
            full = np.bincount(near, minlength=lists) > 0
            lengths = np.linalg.norm(sums[full], axis=1, keepdims=True)
            self.centroids[full] = sums[full] / np.maximum(lengths, 1e-12)
        near = self._nearest(descriptors)
        self.places = np.argsort(near, kind="stable")
        self.edges = np.searchsorted(near[self.places], np.arange(lists + 1))
        self.stored = descriptors[self.places]

    def _nearest(self, descriptors: Floats, block: int = 4096) -> NDArray[np.int64]:
        parts = np.split(descriptors, range(block, len(descriptors), block))
        return np.concatenate([(part @ self.centroids.T).argmax(axis=1) for part in parts])

    def search(self, query: Floats, lists: int) -> NDArray[np.int64]:
        """The best places (n,) of the nearest lists, at most `BEST`, in no order."""
        near = highest(self.centroids @ query, lists)
        scores = [self.stored[self.edges[at] : self.edges[at + 1]] @ query for at in near]
        places = [self.places[self.edges[at] : self.edges[at + 1]] for at in near]
        return np.concatenate(places)[highest(np.concatenate(scores), BEST)]


class FaissIndex:
    """faiss's IndexIVFFlat, on one thread."""

    def __init__(self, descriptors: Floats, lists: int, faiss: Any) -> None:
        self.name = f"faiss {faiss.__version__}"
        faiss.omp_set_num_threads(1)
        kind = f"IVF{lists},Flat"
        self._index = faiss.index_factory(DIMENSIONS, kind, faiss.METRIC_INNER_PRODUCT)
        rng = np.random.default_rng(0)
        size = min(len(descriptors), 2 * SAMPLES * lists)  # fewer than 39 a list, and it warns
        self._index.train(descriptors[rng.choice(len(descriptors), size, replace=False)])
        self._index.add(descriptors)

    def search(self, query: Floats, lists: int) -> NDArray[np.int64]:
        """As `NumpyIndex.search`."""
        self._index.nprobe = lists
        places: NDArray[np.int64] = self._index.search(query[None], BEST)[1][0]
        return places[places >= 0]


def load_faiss() -> Any:
    """Faiss, or None where it is not installed."""
    try:
        return importlib.import_module("faiss")
    except ImportError:
        return None


def route_of(places: int, queries: int) -> tuple[Floats, NDArray[np.int64], dict[float, Floats]]:
    """Descriptors (R, D) along a route, true places (Q,), and per competence queries (Q, D).

    They vary in `INNER` dimensions and lie in `DIMENSIONS`, as descriptors of images do.
    """
    rng = np.random.default_rng(0)
    inner = unit(smooth(rng, places, INNER, SMOOTHNESS, GRAIN))
    truth = np.sort(rng.choice(places, queries, replace=False))
    noise = unit(rng.standard_normal((queries, INNER)).astype(np.float32))
    turn = np.linalg.qr(rng.standard_normal((DIMENSIONS, INNER)))[0].T.astype(np.float32)
    seen = {c: unit(c * inner[truth] + np.sqrt(1 - c * c) * noise) @ turn for c in COMPETENCES}
    return inner @ turn, truth, {c: query.astype(np.float32) for c, query in seen.items()}


def unit(vectors: Floats) -> Floats:
    """Rows of length 1."""
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def search(places: int, lists: int, probes: Sequence[int], queries: int, rounds: int) -> list[Row]:
    """Exact search and an index's, at the same queries.

    Returns:
        Rows with ``lists`` searched (None: all places, without an index), ``ms``, ``mib`` beside
        the descriptors, and per competence the share of queries whose true place is among the
        `BEST`.
    """
    descriptors, truth, seen = route_of(places, queries)
    faiss = load_faiss()
    index = FaissIndex(descriptors, lists, faiss) if faiss else NumpyIndex(descriptors, lists)

    def exact(query: Floats, _: int) -> NDArray[np.int64]:
        return highest(descriptors @ query, BEST)

    extra = (descriptors.nbytes + 8 * places) / MIB  # a copy in the lists' order, and its places
    rows = []
    for probe in (None, *probes):
        find = index.search if probe else exact
        others = cycle(seen[COMPETENCES[0]])  # whose lists are in no cache
        row: Row = {
            "by": index.name if probe else "all places",
            "lists": probe,
            "ms": milliseconds(lambda: find(next(others), probe or 0), rounds),  # noqa: B023
            "mib": extra if probe else 0.0,
        }
        for competence, query in seen.items():
            found = [find(one, probe or 0) for one in query]
            near = [
                (abs(each - true) <= TOLERANCE).any()
                for each, true in zip(found, truth, strict=True)
            ]
            row[f"found {competence}"] = float(np.mean(near))
        rows.append(row)
    return rows


def rendered(out: Path, places: int) -> ScoreBank:
    """A tour through the demo's rendered worlds, joined in one map; images are kept in ``out``."""
    parts = []
    for seed, world in enumerate(WORLDS, FIRST_WORLD):
        images = out / "images" / world.kind
        render_folders(images, [world.condition], seed=seed, places=places, kind=world.kind)
        parts.append((images / "reference", images / world.condition))
    tour = make_tour(parts, seed=1)
    return extract_tour(tour, TECHNIQUES, TOLERANCE, seconds=SECONDS, cache=out / "cache")


def shortened(bank: ScoreBank, share: float, fill: str) -> ScoreBank:
    """The bank as a shortlist leaves it: of every row only the best share of the scores exists."""
    scores = np.array(bank.scores)
    count = max(1, round(share * bank.references))
    for row in scores.reshape(-1, bank.references):
        kept = highest(row, count)
        rest = {"floor": row[kept[-1]], "mean": row.mean(), "none": -np.inf}[fill]
        best = row[kept]
        row[:] = np.minimum(rest, best[-1])
        row[kept] = best
    return ScoreBank(
        scores,
        bank.techniques,
        bank.seconds,
        tolerance=bank.tolerance,
        ground_truth=bank.truth,
        name=bank.name,
    )


def accuracy(banks: Sequence[ScoreBank], statistic: str) -> Row:
    """Means over routes of each ``single`` technique and of ``music``, all of them; and AUCs."""
    rows: dict[str, list[Row]] = {"single": [], "music": []}
    for bank in banks:
        for spec in (*(f"single:{name}" for name in bank.techniques), "music"):
            policy = make_policy(spec, Context.of(bank, statistic=statistic))
            trace = rollout(policy, bank, name=spec, statistic=statistic)
            rows[spec.partition(":")[0]].append(summarise(trace))
    means: Row = {}
    for kind, found in rows.items():
        means[kind] = float(np.mean([row["accuracy"] for row in found]))
        means[f"{kind}_auc"] = float(np.mean([row["auc"] for row in found]))
    return means


def driven(banks: Sequence[ScoreBank], share: float, fill: str, statistic: str) -> Row:
    """Accuracy on routes of which a shortlist is left."""
    left = [shortened(bank, share, fill) for bank in banks] if fill else banks
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* has no correct match", UserWarning)
        return accuracy(left, statistic)
