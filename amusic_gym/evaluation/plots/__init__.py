"""The figures of a comparison, each from traces or summary rows to one PNG.

They use Matplotlib's object interface only: no pyplot, no display, nothing left open; Matplotlib
itself is imported by the first figure. Axes carry units, and a technique or policy looks the same
in every figure (:mod:`amusic_gym.evaluation.plots.labels`).
"""

from amusic_gym.evaluation.plots.curves import precision_recall, reliability
from amusic_gym.evaluation.plots.route import selections, shares
from amusic_gym.evaluation.plots.tradeoff import front

__all__ = ["front", "precision_recall", "reliability", "selections", "shares"]
