"""Rendered routes: streets, railways and corridors that exist only as numbers, in any weather.

    world = World(seed=3, kind="street")
    image = render(world, 120.0, "winter+night", size=(320, 240), run=1)
    for image in traverse(3, "fog", places=200, kind="street"): ...
    render_folders(Path("out"), ["winter", "night"], seed=3, places=200, size=(320, 240))

Everything is drawn anew from the seed: no picture is shipped or read. Equal arguments give equal
bits. Equal place numbers of two traverses are the same place, so ground truth is 1:1.
"""

from amusic_gym.worlds.conditions import CONDITIONS, NAMES, REFERENCE
from amusic_gym.worlds.files import render_folders
from amusic_gym.worlds.film import Image
from amusic_gym.worlds.views import SIZE, render, traverse
from amusic_gym.worlds.world import KINDS, SPACING, Kind, World

__all__ = [
    "CONDITIONS",
    "KINDS",
    "NAMES",
    "REFERENCE",
    "SIZE",
    "SPACING",
    "Image",
    "Kind",
    "World",
    "render",
    "render_folders",
    "traverse",
]
