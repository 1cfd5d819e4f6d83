"""A ROS 2 node that recognises the places of a map in a camera's images.

    python examples/ros2_node.py town.map --ros-args -r image:=/camera/image_raw

It reads ``image`` (sensor_msgs/Image) and publishes ``answer`` (std_msgs/String, JSON) for each
and, where the place is known and the map has metres, ``pose`` (geometry_msgs/
PoseWithCovarianceStamped) in the frame ``map``. Needs ROS 2 with rclpy in the same Python.
"""

from __future__ import annotations

import json
import math
import sys
from typing import Any

import numpy as np

POLICY, MIN_P = "ppo", 0.5
NEAR, FAR = 2.0, 50.0
"""Standard deviation in metres of a pose whose place is surely right, or surely wrong."""


def image_of(message: Any) -> np.ndarray:
    """Image of a sensor_msgs/Image: blue-green-red, or grey."""
    channels = {"bgr8": 3, "rgb8": 3, "mono8": 1}.get(message.encoding)
    if channels is None:
        raise ValueError(f"images are {message.encoding}; give bgr8, rgb8 or mono8")
    rows = np.frombuffer(message.data, np.uint8).reshape(message.height, message.step)
    image = rows[:, : message.width * channels]
    if channels == 1:
        return image
    image = image.reshape(message.height, message.width, 3)
    return image[..., ::-1] if message.encoding == "rgb8" else image


def messages_of(
    result: Any, header: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any] | None]:
    """Fields of the answer and of the pose of a `Localisation`; None where there is no pose."""
    names = ("frame", "place", "name", "p_correct", "known", "active", "milliseconds")
    answer = {"data": json.dumps({name: getattr(result, name) for name in names})}
    if result.position is None or not result.known:
        return answer, None
    x, y, z = (*map(float, result.position), 0.0)[:3]
    # ROS counts yaw from east, against the clock; headings are from north, with it.
    yaw = 0.0 if result.heading is None else math.radians(90.0 - result.heading)
    p = 1.0 if result.p_correct is None else result.p_correct
    covariance = [0.0] * 36
    covariance[0] = covariance[7] = p * NEAR**2 + (1.0 - p) * FAR**2
    covariance[35] = 0.1 if result.heading is not None else math.pi**2
    turn = {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
    pose = {"position": {"x": x, "y": y, "z": z}, "orientation": turn}
    return answer, {"header": header, "pose": {"pose": pose, "covariance": covariance}}


def main() -> None:
    """Run the node."""
    import rclpy
    from geometry_msgs.msg import PoseWithCovarianceStamped
    from rosidl_runtime_py import set_message_fields
    from sensor_msgs.msg import Image
    from std_msgs.msg import String

    from amusic_gym.live.localiser import Localiser

    rclpy.init(args=sys.argv)
    node = rclpy.create_node("amusic")
    answers = node.create_publisher(String, "answer", 1)
    poses = node.create_publisher(PoseWithCovarianceStamped, "pose", 1)
    with Localiser.load(sys.argv[1], POLICY, min_p=MIN_P) as localiser:
        # Degrees are no metres: a map with latitudes and longitudes gives no poses.
        metric = localiser.map.positions is not None and localiser.map.positions.degrees() is None

        def take(message: Any) -> None:
            stamp = message.header.stamp
            header = {"stamp": {"sec": stamp.sec, "nanosec": stamp.nanosec}, "frame_id": "map"}
            answer, pose = messages_of(localiser.update(image_of(message)), header)
            for publisher, kind, fields in (
                (answers, String, answer),
                (poses, PoseWithCovarianceStamped, pose if metric else None),
            ):
                if fields is not None:
                    made = kind()
                    set_message_fields(made, fields)
                    publisher.publish(made)

        node.create_subscription(Image, "image", take, 1)
        rclpy.spin(node)


if __name__ == "__main__":
    main()
