"""How the weights that ship were made: CALC and NetVLAD, from pictures that a program draws.

FAB-MAP's vocabulary is learned here, too, from images of the user's. A closed wing: nothing in the
package imports it; ``scripts/train_*.py`` do, by the names below.
"""

from amusic_gym.pretraining.fabmap import train_fabmap
from amusic_gym.pretraining.job import TECHNIQUES, add_arguments, train

__all__ = ["TECHNIQUES", "add_arguments", "train", "train_fabmap"]
