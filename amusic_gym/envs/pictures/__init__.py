"""The picture of one frame: what the robot sees, where it thinks it is, and what that cost.

:class:`Scene` says what is to be seen, :func:`amusic_gym.envs.pictures.layout.draw` draws it with
OpenCV and :class:`amusic_gym.envs.pictures.viewer.Viewer` does both for an environment. OpenCV is
imported by the first drawing, pygame by the first window (:mod:`amusic_gym.envs.window`).
"""

from amusic_gym.envs.pictures.scene import Scene, Trail

__all__ = ["Scene", "Trail"]
