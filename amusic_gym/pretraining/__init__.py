"""How the weights that ship were made: CALC and NetVLAD, from pictures that a program draws.

A closed wing: nothing in the package imports it; ``scripts/train_calc.py`` and
``scripts/train_netvlad.py`` do, by the two names below.
"""

from __future__ import annotations

from amusic_gym.pretraining.job import TECHNIQUES, add_arguments, train

__all__ = ["TECHNIQUES", "add_arguments", "train"]
