"""Descriptors of a simulated route's places and frames, and the scores of one technique."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from amusic_gym.routes.route_model import RouteModel

Floats = NDArray[np.float32]

MIN_BEND = 0.02  # below it a bend is nothing but rounding errors
MOST_LEAN = 2.0  # how much of a condition's shift goes along what all places have in common
BLOCK = 64  # rows that `smooth` computes with one matrix product

_AGES = np.abs(np.arange(BLOCK)[:, None] - np.arange(BLOCK))


@dataclass(frozen=True)
class TechniqueModel:
    """How one technique sees a route: one draw from the ranges of `Simulation`."""

    dimensions: int  # of its descriptors; more make the true place stand out further
    trend: float  # share of a descriptor's variance that changes slowly along the map ...
    trend_length: float  # ... and the places over which it does
    smoothness: float  # places over which descriptors stay alike (e-folding length)
    grain: float  # share of a descriptor's variance that no other place has
    aliasing: float  # how far repeated segments are the same, 0 not at all .. 1 identical
    bland: float  # strength of hubs and voids, relative to a descriptor's length
    base: float  # what all places have in common, relative to a descriptor's length
    noise_memory: float  # frames over which the query's noise stays alike
    noise_grain: float  # share of the noise's variance that is new in each frame
    shift: float  # length of a condition's constant vector, relative to a descriptor's
    lasting: float  # share of its variance that is the same in all conditions
    bend: float  # > 0 stretches high scores, < 0 squeezes them, 0 leaves the cosine
    offset: float  # raw score of an average match
    scale: float  # raw score units per standard deviation


def smooth(
    rng: np.random.Generator, steps: int, dimensions: int, length: float, grain: float = 0.0
) -> Floats:
    """Stationary sequence (steps, dimensions) of unit variance: Ornstein-Uhlenbeck plus grain.

    Steps d > 0 apart correlate by (1 - grain) * exp(-d / length). The recursion
    y[i] = a y[i-1] + w[i] is done block by block with one matrix product, which leaves a Python
    loop over blocks only.
    """
    decay = math.exp(-1.0 / length) if length > 0 else 0.0
    fresh = math.sqrt(1.0 - decay * decay)
    blocks = -(-steps // BLOCK)
    # Uniform noise of unit variance: faster than normal, and no different in sums of a dozen.
    noise = rng.random((blocks * BLOCK, dimensions), dtype=np.float32)
    noise -= np.float32(0.5)
    noise *= np.float32(math.sqrt(12.0))
    powers = decay ** np.arange(BLOCK + 1)
    weights = np.tril(fresh * powers[_AGES]).astype(np.float32)  # (BLOCK, BLOCK)
    parts: Floats = weights @ noise.reshape(blocks, BLOCK, dimensions)
    # The first step has unit variance too.
    parts[0] += (1.0 - fresh) * powers[:BLOCK, None].astype(np.float32) * noise[0]
    carry = powers[1:, None].astype(np.float32)
    for i in range(1, blocks):
        parts[i] += carry * parts[i - 1, -1]
    # Grain from the same draws, one dimension on, where they are independent: half the draws.
    whole = parts.reshape(-1, dimensions)[:steps]
    return _mix(whole, np.roll(noise[:steps], 1, axis=1), grain) if grain else whole


def write_scores(
    rng: np.random.Generator,
    route: RouteModel,
    model: TechniqueModel,
    technique: int,
    out: Floats,
) -> None:
    """Scores of technique number ``technique`` into ``out`` (Q, R) float32.

    Descriptors of map and query, cosine, bend, scale.
    """
    queries, references = out.shape
    size, competence = model.dimensions, route.competence[technique]
    places = smooth(rng, references, size, model.smoothness, model.grain)
    if model.trend:
        places = _mix(places, smooth(rng, references, size, model.trend_length), model.trend)
    alias = np.where(route.source == np.arange(references), 0.0, model.aliasing)
    places = _mix(places, places[route.source], np.square(alias)[:, None])
    noise = smooth(rng, queries, size, model.noise_memory, model.noise_grain)
    common = _unit(rng.standard_normal(size, dtype=np.float32)) * math.sqrt(size)
    turn = rng.standard_normal((competence.size, size), dtype=np.float32)
    lean = rng.uniform(0.0, MOST_LEAN, (competence.size, 1)).astype(np.float32)
    if model.lasting:
        always = rng.standard_normal(size, dtype=np.float32)
        turn, lean = _mix(turn, always, model.lasting), _mix(lean, lean[:1], model.lasting)
    shift = (model.shift * math.sqrt(size)) * _unit(turn + lean * common)  # (C, D)
    if route.decoy is not None and route.lure is not None:
        lure = np.square(route.lure[technique])[:, None]  # (Q, 1)
        noise = _mix(noise, _between(places, route.decoy[technique]), lure)
    level = competence[route.condition][:, None]  # (Q, 1)
    met = _between(places, route.seen)
    if route.leaves is not None:
        off = queries - route.leaves
        met = np.concatenate(
            [met[: route.leaves], smooth(rng, off, size, model.smoothness, model.grain)]
        )
    seen = _mix(noise, met, np.square(level))
    seen += shift[route.condition]
    places += (model.base + model.bland * route.bland)[:, None] * common
    _compare(_unit(seen), _unit(places), model, out)


def _compare(seen: Floats, places: Floats, model: TechniqueModel, out: Floats) -> None:
    """Cosines, bent and scaled into `out` (Q, R); monotone, so no ranking changes."""
    gain = math.sqrt(model.dimensions)  # about one standard deviation of a random match
    if abs(model.bend) < MIN_BEND:
        np.matmul(seen * np.float32(model.scale * gain), places.T, out=out)
        out += model.offset
        return
    np.matmul(seen * np.float32(model.bend * gain), places.T, out=out)
    np.exp(out, out=out)  # (exp(bend x) - 1) / bend; NumPy's expm1 is seven times slower
    out *= model.scale / model.bend
    out += model.offset - model.scale / model.bend


def _mix(first: Floats, second: Floats, share: float | NDArray[np.float64]) -> Floats:
    """Variance-preserving mixture; `share` is the part of the variance the second one gets."""
    kept = np.sqrt(1.0 - np.asarray(share)).astype(np.float32)
    return np.asarray(kept * first + np.sqrt(np.asarray(share)).astype(np.float32) * second)


def _between(places: Floats, position: NDArray[np.float64]) -> Floats:
    """Descriptors (Q, D) at positions that may lie between two places (R, D)."""
    low = position.astype(np.int64).clip(0, len(places) - 1)
    part = (position - low).astype(np.float32)
    start: Floats = places[low]
    if not part.any():
        return start
    high = np.minimum(low + 1, len(places) - 1)
    return np.asarray(start + part[:, None] * (places[high] - start))


def _unit(vectors: Floats) -> Floats:
    length = np.sqrt(np.square(vectors).sum(axis=-1, keepdims=True))
    return np.asarray(vectors / np.maximum(length, 1e-12), np.float32)
