"""What grows: memory and time of a frame with places, techniques, routes, frames, descriptors."""

import statistics
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np

from amusic_gym.banks.bank import ScoreBank
from amusic_gym.envs.vector_env import TechniqueSelectionVectorEnv
from amusic_gym.extraction import BLOCK
from amusic_gym.extraction.map import DescribedMap
from amusic_gym.techniques import Technique, make_technique

MIB, GIB = 2**20, 2**30
WARM_UP = 3  # frames or queries that are not counted

Row = dict[str, Any]

DESCRIPTORS: dict[str, tuple[int, ...]] = {
    "NetVLAD that ships": (256,),
    "GIST": (512,),
    "CALC": (1064,),
    "NetVLAD, public weights": (4096,),
    "CoHOG": (32, 9, 32),
    "EfficientNet": (15680,),
    "HOG": (35721,),
}
"""Technique → shape of its descriptor of a place."""


class Dot(Technique):
    """A technique that matches by the dot product, as all but CoHOG do."""

    name = "dot product"


def milliseconds(work: Callable[[], object], rounds: int) -> float:
    """Median processor time of a call in milliseconds; the first calls are not counted."""
    taken = []
    for _ in range(WARM_UP + rounds):
        start = time.process_time()
        work()
        taken.append(1e3 * (time.process_time() - start))
    return statistics.median(taken[WARM_UP:])


def step_of(statistic: str, places: int, techniques: int, routes: int, frames: int) -> Row:
    """A step in which all techniques run on rows that were never read before.

    Returns:
        ``ms``: of a step of one route; ``mib``: that the environment keeps beside the scores when
        it has driven through; ``bank_mib``: of the scores.
    """
    rng = np.random.default_rng(0)
    scores = rng.random((techniques, frames + routes, places), np.float32)
    truth = np.arange(frames + routes) % places
    scores[:, np.arange(frames + routes), truth] += 1.0
    names = [f"technique {t}" for t in range(techniques)]

    def new_bank() -> ScoreBank:
        return ScoreBank(scores, names, np.ones(techniques), tolerance=2, ground_truth=truth)

    def begun(bank: ScoreBank) -> tuple[TechniqueSelectionVectorEnv, Callable[[], object]]:
        env = TechniqueSelectionVectorEnv(routes, bank, statistic=statistic)
        env.reset(seed=0, options={"start": np.arange(routes)})
        actions = np.ones((routes, techniques), np.int8)
        return env, lambda: env.step(actions)

    _, step = begun(new_bank())
    ms = milliseconds(step, frames - WARM_UP - 1) / routes
    bank = new_bank()
    tracemalloc.start()
    env, step = begun(bank)
    for _ in range(frames - 1):
        step()
    kept = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    env.close()
    return {"ms": ms, "mib": kept / MIB, "bank_mib": scores.nbytes / MIB}


def match(name: str, places: int, rounds: int) -> Row:
    """A query matched with a map of one technique, in memory, on one thread.

    Returns:
        ``ms``: of a query in blocks, as extraction and a robot match; ``product_ms``: of the bare
        matrix product, where the technique is one.
    """
    shape = DESCRIPTORS[name]
    technique = make_technique("cohog") if name == "CoHOG" else Dot()
    rng = np.random.default_rng(0)
    some = rng.random((BLOCK, *shape), np.float32) / np.float32(np.sqrt(np.prod(shape)))
    whole = np.empty((places, *shape), np.float32)
    for first in range(0, places, BLOCK):
        whole[first : first + BLOCK] = some[: places - first]
    blocks = [whole[first : first + BLOCK] for first in range(0, places, BLOCK)]
    reference = DescribedMap(technique, blocks, threads=1)
    row: Row = {"ms": milliseconds(lambda: reference.scores(some[0]), rounds)}
    if len(shape) == 1:
        row["product_ms"] = milliseconds(lambda: whole @ some[0], rounds)
    return row


def descriptor_bytes(name: str, places: int) -> int:
    """Memory of a map of one technique."""
    return 4 * places * int(np.prod(DESCRIPTORS[name]))
