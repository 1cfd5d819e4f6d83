"""From a standardised row to the likelihood of every place, and what a row says of its technique.

A technique's rows are of one of four kinds: they say nothing, or the log-likelihood of a place
grows with its standardised score once, twice or four times as fast. Which, is not known; so each
place's likelihood is the mean over the kinds, by their probabilities. With x = e to the power of
the bent score, softmax over the mean one is x, x² or x⁴ over its mean: a polynomial in x.
"""

from __future__ import annotations

from typing import Any

from amusic_gym.estimation.belief.rates import Rates, trust_of
from amusic_gym.kernels.compiling import apart, inner

DOUBT = 0.01
"""Least probability that a row says nothing: so none ever rules a place out."""

TINY = 1e-300
"""Keeps a quotient finite."""


@inner
def power(value: float) -> float:
    """Exponential of numbers ≤ 0, to within 1 % above −4, never below 0.

    (1 + x/1024)^1024 by ten squarings: a loop of them runs in SIMD, which ``math.exp`` does not.
    """
    base = 1.0 + max(value, -60.0) * (1.0 / 1024.0)
    for _ in range(10):
        base *= base
    return base


@apart
def voice(rates: Rates, known: Any, size: int, row: Any, out: Any) -> None:
    """Turn standardised scores into x in place; ``out`` is filled with the polynomial in x."""
    slope, bend = rates.sharpness * known.weight, rates.convexity
    highest = row[0]
    for place in range(size):
        highest = max(highest, row[place])
    top = slope * (highest + bend * max(highest, 0.0) * highest)
    once, twice, fourfold = 0.0, 0.0, 0.0
    for place in range(size):
        value = row[place]
        row[place] = power(min(slope * (value + bend * max(value, 0.0) * value) - top, 0.0))
    for place in range(size):  # apart: in one loop, sums would keep the powers out of SIMD
        x = row[place]
        once += x
        twice += x * x
        fourfold += (x * x) * (x * x)
    out.norm_once, out.norm_twice, out.norm_fourfold = size / once, size / twice, size / fourfold
    out.none = 1.0 - known.trust
    out.once = known.once * out.norm_once
    out.twice = known.twice * out.norm_twice
    out.fourfold = known.fourfold * out.norm_fourfold


@inner
def likelihood(words: Any, x: float) -> float:
    """Likelihood of a place, from its x."""
    value: float = words.none + x * (words.once + x * (words.twice + x * x * words.fourfold))
    return value


@apart
def learn(
    rates: Rates, known: Any, size: int, row: Any, words: Any, looks: Any, others: Any
) -> None:
    """Learn from the belief after the frame of which kind a technique's rows are.

    What the row itself made of the belief is divided out again: it is compared with what the past
    and the other techniques say. After a jump, those that agree are believed, not blamed.

    Args:
        rates: of the trust.
        known: WITNESS record of the technique.
        size: R.
        row: (R,) its x.
        words: its VOICE record.
        looks: (R,) belief over the places that the image looks like, with all rows in it.
        others: (R,) scratch.
    """
    for place in range(size):
        others[place] = looks[place] / likelihood(words, row[place])
    none, once, twice, fourfold = 0.0, 0.0, 0.0, 0.0
    for place in range(size):
        x, share = row[place], others[place]
        none += share
        once += share * x
        twice += share * (x * x)
        fourfold += share * ((x * x) * (x * x))
    exponent = rates.learn * known.weight
    once = known.once * (words.norm_once * once / none) ** exponent
    twice = known.twice * (words.norm_twice * twice / none) ** exponent
    fourfold = known.fourfold * (words.norm_fourfold * fourfold / none) ** exponent
    keep = (1.0 - rates.relearn) / (1.0 - known.trust + once + twice + fourfold)
    first = trust_of(rates)
    once = keep * once + rates.relearn * first[0]
    twice = keep * twice + rates.relearn * first[1]
    fourfold = keep * fourfold + rates.relearn * first[2]
    whole = max(once + twice + fourfold, TINY)
    known.trust = min(whole, 1.0 - DOUBT)
    keep = known.trust / whole
    known.once, known.twice, known.fourfold = keep * once, keep * twice, keep * fourfold
