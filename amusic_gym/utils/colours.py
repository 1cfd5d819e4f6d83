"""Colours of techniques and of right and wrong, the same in every picture, figure and page.

They are taken from Okabe and Ito's and Tol's sets, made for every common kind of colour vision;
their bright yellow is left out, it vanishes on white.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

# Techniques and policies share no colour: both appear in one figure of curves.
PAPER_COLOURS = {"HOG": "#56B4E9", "CALC": "#E69F00", "CoHOG": "#009E73", "NetVLAD": "#CC79A7"}
TECHNIQUE_COLOURS = (
    *PAPER_COLOURS.values(),
    "#332288",
    "#DDCC77",
    "#882255",
    "#44AA99",
    "#CC6677",
    "#777FA0",
    "#117733",
    "#88CCEE",
    "#AA4499",
    "#8C6D31",
    "#F0B6C0",
    "#5A3E9B",
)
CORRECT_COLOUR, WRONG_COLOUR, NEUTRAL_COLOUR = "#9ECAE1", "#B2182B", "#BBBBBB"


def technique_colours(techniques: Sequence[str]) -> dict[str, str]:
    """One colour per name; the paper's four always get the same, others the next free in order."""
    colours = {n: PAPER_COLOURS[n] for n in techniques if n in PAPER_COLOURS}
    free = [c for c in TECHNIQUE_COLOURS if c not in colours.values()]
    others = [n for n in techniques if n not in colours]
    colours |= {n: free[i % len(free)] for i, n in enumerate(others)}
    return {name: colours[name] for name in techniques}


def _rgb(colour: str) -> NDArray[np.float64]:
    return np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0


def tint(colour: str, strength: float) -> tuple[float, ...]:
    """The colour mixed with white, strength 1 = the colour itself."""
    return tuple(float(c) for c in 1.0 - strength * (1.0 - _rgb(colour)))


def ink_on(colour: str) -> str:
    """Black or white, whichever reads on the colour (relative luminance of sRGB)."""
    luminance = float((_rgb(colour) ** 2.2) @ np.array([0.2126, 0.7152, 0.0722]))
    return "#000000" if luminance > 0.18 else "#FFFFFF"


def sequence(count: int) -> list[tuple[float, ...]]:
    """Shades of one colour for curves of growing parameters, the palest first."""
    return [tint("#08519C", strength) for strength in np.linspace(0.35, 1.0, count)]
