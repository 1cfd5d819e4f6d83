"""Positions in ROS bags, written here by the same library."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest

from amusic_gym.routes.position_files import positions_of, read_track
from amusic_gym.routes.positions import GEOGRAPHIC, LOCAL

pytest.importorskip("rosbags", reason='install it: pip install "amusic-gym[ros]"')

from extraction_cases import make_images
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from amusic_gym.routes.folders import ImageFolder

FIX, ODOMETRY = "sensor_msgs/msg/NavSatFix", "nav_msgs/msg/Odometry"
KINDS = {
    "mcap": (StoragePlugin.MCAP, Stores.ROS2_HUMBLE),
    "sqlite": (StoragePlugin.SQLITE3, Stores.ROS2_HUMBLE),
    "ros1": (None, Stores.ROS1_NOETIC),
}


def fix(types, header, at: int):
    status = types["sensor_msgs/msg/NavSatStatus"](status=-1 if at == 1 else 0, service=1)
    return types[FIX](header, status, 59.9 + 1e-4 * at, 10.75, 7.0, np.zeros(9), 0)


def odometry(types, header, at: int):
    half = -math.radians(90) / 2  # a quarter to the right
    pose = types["geometry_msgs/msg/Pose"](
        types["geometry_msgs/msg/Point"](float(at), 2.0, 3.0),
        types["geometry_msgs/msg/Quaternion"](0.0, 0.0, math.sin(half), math.cos(half)),
    )
    still = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = types["geometry_msgs/msg/Twist"](still, still)
    return types[ODOMETRY](
        header,
        "base",
        types["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
        types["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def bag(path: Path, kind: str, topics: dict[str, str]) -> Path:
    """A bag with four messages of each topic, one a second from 100 s on."""
    plugin, of = KINDS[kind]
    store = get_typestore(of)
    types = store.types
    path = path.with_suffix(".bag") if plugin is None else path
    writer = Writer1(path) if plugin is None else Writer(path, version=9, storage_plugin=plugin)
    with writer:
        for topic, name in topics.items():
            connection = writer.add_connection(topic, name, typestore=store)
            for at in range(4):
                stamp = types["builtin_interfaces/msg/Time"](sec=100 + at, nanosec=500_000_000)
                first = () if plugin is not None else (at,)
                header = types["std_msgs/msg/Header"](*first, stamp, "map")
                message = (fix if name == FIX else odometry)(types, header, at)
                pack = store.serialize_ros1 if plugin is None else store.serialize_cdr
                writer.write(connection, 10**9 * (100 + at), bytes(pack(message, name)))
    return path


@pytest.mark.parametrize("kind", KINDS)
def test_fixes_are_positions_by_time_and_those_without_are_left(tmp_path, kind):
    path = bag(tmp_path / "drive", kind, {"/gps/fix": FIX})
    track = read_track(path)
    assert track.seconds is not None
    assert track.seconds.tolist() == [100.5, 102.5, 103.5]
    degrees = track.positions.degrees()
    assert degrees is not None
    np.testing.assert_allclose(degrees[:, 0], [59.9, 59.9002, 59.9003], atol=1e-9)
    assert track.positions.system == GEOGRAPHIC
    images = make_images(tmp_path / "images", 2)
    for at, image in enumerate(sorted(images.iterdir())):
        image.rename(images / f"{102.5 + at / 2}.png")
    found = positions_of(path, ImageFolder(images)).degrees()
    assert found is not None
    np.testing.assert_allclose(found[:, 0], [59.9002, 59.90025], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_a_topic_is_named_where_there_are_several(tmp_path, kind):
    path = bag(tmp_path / "drive", kind, {"/fix": FIX, "/odom": ODOMETRY})
    with pytest.raises(ValueError, match=r"topics of positions: /fix .*, /odom .*; name one"):
        read_track(path)
    with pytest.raises(ValueError, match=r"name one behind a colon"):
        read_track(f"{path}:/nothing")
    positions = read_track(f"{path}:/odom").positions
    assert positions.system == LOCAL
    assert positions.metres.tolist() == [[at, 2, 3] for at in range(4)]
    np.testing.assert_allclose(positions.headings, 90)


def test_a_file_of_a_bag_is_the_bag(tmp_path):
    for kind, suffix in (("mcap", "mcap"), ("sqlite", "db3")):
        folder = bag(tmp_path / kind, kind, {"/fix": FIX})
        (path,) = folder.glob(f"*.{suffix}")
        assert len(read_track(path).positions) == 3


def test_what_is_no_bag_is_refused(tmp_path):
    garbage = tmp_path / "a.mcap"
    garbage.write_bytes(b"no bag" * 30)
    with pytest.raises(ValueError, match=r"a\.mcap cannot be read as a bag .*; copy it again"):
        read_track(garbage)
    with pytest.raises(FileNotFoundError, match=r"b\.bag does not exist"):
        read_track(tmp_path / "b.bag")


def test_32_without_rosbags_the_refusal_names_the_command(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(ValueError, match=r'pip install "amusic-gym\[ros\]"'):
        read_track(tmp_path / "a.bag")
