"""The transform map -> odom, with a stand-in where tf2_ros is not installed."""

from types import SimpleNamespace

import numpy as np
import pytest

from neuse.geometry import transform_from_quaternion
from neuse_slam_node import map_frame

from . import samples


class Broadcasts(list):
    """Stands for tf2_ros.TransformBroadcaster."""

    def __init__(self, node: object) -> None:
        super().__init__()

    sendTransform = list.append


def test_map_to_odom_makes_up_for_the_drift_of_the_odometry(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(map_frame, "TransformBroadcaster", Broadcasts)
    frame, T_odom_camera = samples.tracked_frame(), samples.transform(8)
    broadcaster = map_frame.make_broadcaster(SimpleNamespace(), "map")
    broadcaster.broadcast(frame, T_odom_camera, "odom")
    (sent,) = broadcaster._broadcaster
    t, q = sent.transform.translation, sent.transform.rotation
    T_map_odom = transform_from_quaternion([q.x, q.y, q.z, q.w], [t.x, t.y, t.z])
    np.testing.assert_allclose(T_map_odom @ T_odom_camera, frame.T_map_camera, atol=1e-9)
    assert (sent.header.frame_id, sent.child_frame_id) == ("map", "odom")


def test_without_tf2_ros_there_is_no_broadcaster_and_a_line_says_so(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(map_frame, "TransformBroadcaster", None)
    said: list[str] = []
    node = SimpleNamespace(get_logger=lambda: SimpleNamespace(info=said.append))
    assert map_frame.make_broadcaster(node, "map") is None
    assert "tf2_ros" in said[0]
