"""How policies and techniques are named and coloured, the same in every figure and page.

Colours are Okabe and Ito's, then Tol's muted set: readers with any common colour vision tell them
apart. Yellow is left out, it vanishes on white.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from amusic_gym.trace import Trace

OKABE_ITO = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00", "#6F4E37")
TOL_MUTED = (
    "#332288",
    "#88CCEE",
    "#117733",
    "#DDCC77",
    "#CC6677",
    "#AA4499",
    "#44AA99",
    "#999933",
    "#882255",
)
PALETTE = OKABE_ITO + TOL_MUTED
PAPER_TECHNIQUES = ("HOG", "CALC", "CoHOG", "NetVLAD")  # these keep their colour in any ensemble
CORRECT_COLOUR, WRONG_COLOUR, NEUTRAL_COLOUR = "#9ECAE1", "#B2182B", "#BBBBBB"
SWEEP_COLOURS = ("#D55E00", "#7B3294", "#008837", "#6F4E37")  # one per learned selector
POLICY_MARKS = {  # policy -> colour and marker in figures of policies
    "amusic": ("#0072B2", "D"),
    "music": ("#000000", "s"),
    "cascade": ("#009E73", "^"),
    "random": ("#999999", "v"),
    "oracle": ("#CC79A7", "*"),
}
OTHER_MARK = ("#6F4E37", "P")
FIXED = ("single", "subset")  # policies that run the same techniques on every frame


def policy_label(policy: str) -> str:
    """A policy's name for a reader: "single:HOG" -> "HOG", "amusic" -> "A-MuSIC"."""
    kind, _, argument = policy.partition(":")
    names = {"amusic": "A-MuSIC", "music": "MuSIC (all)", "ppo": "selector"}
    if kind in FIXED and argument:
        return argument
    if kind == "raw" and argument:
        return f"{argument}, no SIC"
    if kind == "random" and argument:
        return f"random, p = {argument}"
    if kind == "ppo" and argument:
        return f"selector {PurePath(argument).name}"
    return names.get(kind, kind) + (f" ({argument})" if argument else "")


def policy_mark(policy: str) -> tuple[str, str]:
    """Colour and marker of a policy that is neither fixed nor swept over compute weights."""
    return POLICY_MARKS.get(policy.partition(":")[0], OTHER_MARK)


def weight_label(weight: float) -> str:
    """A compute weight as short as it stays exact to three digits."""
    return f"λ {weight:.3g}"


def technique_colours(techniques: Sequence[str]) -> dict[str, str]:
    """One colour per name; the paper's four always get the same, others the next free in order."""
    colours = {n: PALETTE[PAPER_TECHNIQUES.index(n)] for n in techniques if n in PAPER_TECHNIQUES}
    free = [c for c in PALETTE if c not in colours.values()]
    others = [n for n in techniques if n not in colours]
    colours |= {n: free[i % len(free)] for i, n in enumerate(others)}
    return {name: colours[name] for name in techniques}


def all_techniques(ensembles: Iterable[Sequence[str]]) -> tuple[str, ...]:
    """Every technique of several ensembles once, in order of first appearance."""
    return tuple(dict.fromkeys(name for ensemble in ensembles for name in ensemble))


def trace_label(trace: Trace) -> str:
    """A trace's policy and, where it has one, compute weight."""
    name = policy_label(trace.policy)
    if trace.compute_weight is not None:
        name += f", {weight_label(trace.compute_weight)}"
    return legend_name(name)


def legend_name(name: str) -> str:
    """Matplotlib hides entries that begin with an underscore; a space before it shows them."""
    return f" {name}" if name.startswith("_") else name


def _rgb(colour: str) -> NDArray[np.float64]:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def tint(colour: str, strength: float) -> tuple[float, ...]:
    """The colour mixed with white, strength 1 = the colour itself."""
    return tuple(float(c) for c in 1.0 - strength * (1.0 - _rgb(colour)))


def ink_on(colour: str) -> str:
    """Black or white, whichever reads on the colour (relative luminance of sRGB)."""
    luminance = float((_rgb(colour) ** 2.2) @ np.array([0.2126, 0.7152, 0.0722]))
    return "#000000" if luminance > 0.18 else "#FFFFFF"


def sweep_colour(number: int) -> str:
    """Colour of the learned selector of that number in a figure."""
    return SWEEP_COLOURS[number % len(SWEEP_COLOURS)]
