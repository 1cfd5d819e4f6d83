"""How policies and techniques are named and coloured, the same in every figure and page.

Colours are taken from Okabe and Ito's and Tol's sets, made for every common kind of colour vision;
their bright yellow is left out, it vanishes on white.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from amusic_gym.policies.registry import parse
from amusic_gym.policies.trace import Trace

SWEEP_COLOURS = ("#D55E00", "#7B3294", "#008837", "#A50F15")  # one per policy with λ


def policy_label(policy: str) -> str:
    """A policy's name for a reader: "single:HOG" -> "HOG", "amusic" -> "A-MuSIC"."""
    return parse(policy).label


def row_label(row: Mapping[str, Any]) -> str:
    """The policy of a results row for a reader; ``label``, where the row has one."""
    return row.get("label") or policy_label(row["policy"])


def weight_label(weight: float) -> str:
    """A compute weight as short as it stays exact to three digits."""
    return f"λ {weight:.3g}"


def all_techniques(ensembles: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """Every technique of several ensembles once, in order of first appearance."""
    return tuple(dict.fromkeys(name for ensemble in ensembles for name in ensemble))


def trace_label(trace: Trace) -> str:
    """A trace's policy and, where it has one, compute weight."""
    name = policy_label(trace.policy)
    if trace.compute_weight is not None:
        name += f", {weight_label(trace.compute_weight)}"
    return legend_name(name)


def bank_label(bank: str) -> str:
    """A bank's name as far as a title holds it; a stand-in for an empty one."""
    return (bank if len(bank) <= 36 else bank[:35] + "…") or "unnamed bank"


def legend_name(name: str) -> str:
    """Matplotlib hides entries that begin with an underscore; a space before it shows them."""
    return f" {name}" if name.startswith("_") else name


def sweep_colour(number: int) -> str:
    """Colour of the learned selector of that number in a figure."""
    return SWEEP_COLOURS[number % len(SWEEP_COLOURS)]
