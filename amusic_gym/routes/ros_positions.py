"""Positions in ROS bags, of ROS 1 and 2 (MCAP or SQLite), by the optional package rosbags."""

import os
from pathlib import Path
from typing import Any

import numpy as np

from amusic_gym.routes.positions import GEOGRAPHIC, LOCAL, Positions, from_degrees
from amusic_gym.routes.tracks import Track, heading_of
from amusic_gym.utils.optional import optional

SUFFIXES = (".bag", ".mcap", ".db3")  # of files; ROS 2 has folders with a ``metadata.yaml``, too
FIXES = "sensor_msgs/msg/NavSatFix"
POSES = {
    "nav_msgs/msg/Odometry": lambda message: message.pose.pose,
    "geometry_msgs/msg/PoseStamped": lambda message: message.pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda message: message.pose.pose,
}
"""Type of a message -> its pose."""


def is_bag(source: str | os.PathLike[str]) -> bool:
    """Whether a name is that of a bag, or of a topic in one: ``drive.mcap:/gps/fix``."""
    path, _ = _parts(source)
    return path.suffix.lower() in SUFFIXES or (path / "metadata.yaml").is_file()


def read_bag(source: str | os.PathLike[str]) -> Track:
    """Positions of a bag's topic, by the time stamps of their headers; those without fix are left.

    ``source`` is the bag, with the topic behind a colon where several have positions.

    Raises:
        FileNotFoundError: when there is no such bag.
        ValueError: for a damaged bag, one without positions, and one with several topics of them
            where none is named; where rosbags is not installed.
    """
    needed = os.fspath(source), "the package rosbags", "ros"
    reader, types = (optional(f"rosbags.{each}", *needed) for each in ("highlevel", "typesys"))
    path, topic = _parts(source)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; check the name")
    bare = path.suffix.lower() == ".db3"  # as rosbag2 takes them: the folder with its metadata
    try:
        store = types.get_typestore(types.Stores.ROS2_HUMBLE)
        with reader.AnyReader([path.parent if bare else path], default_typestore=store) as bag:
            known = {
                each.topic: each for each in bag.connections if each.msgtype in (FIXES, *POSES)
            }
            chosen = [each for name, each in known.items() if topic in ("", name)]
            if len(chosen) != 1:
                told = ", ".join(f"{n} ({each.msgtype})" for n, each in sorted(known.items()))
                raise ValueError(
                    f"{path} has these topics of positions: {told or 'none'}; name one behind a"
                    f" colon: {path.name}:/TOPIC"
                )
            kind = chosen[0].msgtype
            messages = [
                bag.deserialize(raw, kind) for _, _, raw in bag.messages(connections=chosen)
            ]
    except ValueError:
        raise
    except Exception as error:  # a damaged bag raises nearly anything
        raise ValueError(f"{path} cannot be read as a bag ({error}); copy it again") from None
    return _track(messages, kind, os.fspath(source))


def _parts(source: str | os.PathLike[str]) -> tuple[Path, str]:
    path, colon, topic = os.fspath(source).rpartition(":/")
    return (Path(path), f"/{topic}") if colon else (Path(source), "")


def _track(messages: list[Any], kind: str, source: str) -> Track:
    if kind == FIXES:  # a status below 0 is none
        messages = [each for each in messages if each.status.status >= 0]
    if not messages:
        raise ValueError(f"{source} holds no position with a fix; give another topic")
    stamps = [each.header.stamp.sec + 1e-9 * each.header.stamp.nanosec for each in messages]
    seconds, first = np.unique(stamps, return_index=True)
    kept = [messages[at] for at in first.tolist()]
    if kind == FIXES:
        metres = from_degrees(*np.array([(each.latitude, each.longitude) for each in kept]).T)
        return Track(Positions(metres, GEOGRAPHIC, None, {}, source), seconds=seconds)
    poses = [POSES[kind](each) for each in kept]
    metres = np.array([(pose.position.x, pose.position.y, pose.position.z) for pose in poses])
    turns = [pose.orientation for pose in poses]
    headings = heading_of(*np.array([(turn.x, turn.y, turn.z, turn.w) for turn in turns]).T)
    return Track(Positions(metres, LOCAL, headings, {}, source), seconds=seconds)
