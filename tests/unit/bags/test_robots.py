"""What robots that share a map have exchanged, and where they stand, from bags that are made up."""

import json
from pathlib import Path

import numpy as np
import pytest
from rclpy.serialization import serialize_message

from neuse.errors import BagError
from neuse.geometry import Array, exp, make_transform
from neuse.records import Keyframe, RgbdFrame
from neuse_bags import topics
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagWriter
from neuse_bags.robots import REPORT, evaluate_robots
from neuse_msgs.msg import ObjectMap, TrackedFrame
from neuse_slam_node.conversions import keyframes_to_msg

T_MAP_WORLD = make_transform(exp([0.1, 0.2, 1.0, 0.0, 0.0, 0.0])[:3, :3], [2.0, -1.0, 0.5])
OFF = make_transform(np.eye(3), [0.03, 0.0, 0.04])
COUNT = 6


def way(index: int) -> list[Array]:
    """T_world_camera of a robot."""
    rng = np.random.default_rng(index)
    return [exp(0.5 * rng.normal(size=6)) for _ in range(COUNT)]


@pytest.fixture
def played(frames: list[RgbdFrame], tmp_path: Path) -> Path:
    """Pictures and true poses of two robots."""
    path = tmp_path / "played.mcap"
    with BagWriter(path) as writer:
        own = (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.TRUE_ODOMETRY)
        topics.declare(writer, tuple(topic.under(name) for name in ("/a", "/b") for topic in own))
        for index, name in enumerate(("/a", "/b")):
            for i, T_world_camera in enumerate(way(index)):
                pose = odometry_to_msg(i + 1, T_world_camera, "world")
                writer.write(name + topics.TRUE_ODOMETRY.name, pose, i + 1)
            for frame in frames:
                write_frame(writer, frame, name)
    return path


def recording(path: Path, n_second: int) -> Path:
    """Keyframes of the first robot, exact, and of the second, a little off, in the map of the first."""
    with BagWriter(path) as writer:
        own = (topics.KEYFRAMES, topics.FRAMES, topics.PRIOR_MAP)
        topics.declare(writer, (*(topic.under(n) for n in ("/a", "/b") for topic in own), topics.MAP))
        for name, index, count, off in (("/a", 0, COUNT, np.eye(4)), ("/b", 1, n_second, OFF)):
            keyframes = [Keyframe(i, i + 1, T_MAP_WORLD @ T @ off) for i, T in enumerate(way(index)[:count])]
            for n in range(1, count + 1):
                message = keyframes_to_msg(keyframes[:n], n, "map")
                writer.write(name + topics.KEYFRAMES.name, message, n)
                writer.write(name + topics.FRAMES.name, TrackedFrame(), n)
        writer.write("/b" + topics.PRIOR_MAP.name, ObjectMap(), 3)
    return path


def test_second_robot_is_measured_in_the_map_of_the_first(played: Path, tmp_path: Path):
    evaluate_robots(recording(tmp_path / "told.mcap", n_second=4), played, tmp_path)
    robots = json.loads((tmp_path / REPORT).read_text())["robots"]
    assert robots["/a"]["median_m"] == pytest.approx(0.0, abs=1e-6)
    assert robots["/b"]["median_m"] == pytest.approx(0.05, abs=1e-6)
    assert robots["/b"]["median_deg"] == pytest.approx(0.0, abs=1e-4)
    assert (robots["/a"]["mapped"], robots["/b"]["mapped"]) == (COUNT, 4)


def test_bytes_are_those_of_the_messages(played: Path, tmp_path: Path):
    evaluate_robots(recording(tmp_path / "told.mcap", n_second=4), played, tmp_path)
    robot = json.loads((tmp_path / REPORT).read_text())["robots"]["/b"]
    assert robot["up"]["/neuse/frames"] == 4 * len(serialize_message(TrackedFrame()))
    assert robot["up"]["/neuse/keyframes"] > 4 * 40
    assert robot["down"] == {"/neuse/prior_map": len(serialize_message(ObjectMap())), "/neuse/changes": 0}
    assert robot["frames"] == 5
    assert robot["pictures"]["/depth/image"] > 5 * 24 * 32 * 2
    assert robot["pictures"].keys() == {"/depth/image", "/segmentation/mask"}


def test_robot_that_has_not_found_its_place_is_told(played: Path, tmp_path: Path):
    text = evaluate_robots(recording(tmp_path / "told.mcap", n_second=0), played, tmp_path)
    assert "/b: none of 5 frames in the map: it has not found its place" in text
    assert "/a: 6 of 5 frames in the map, off by 0.000 m" in text


def test_recording_without_keyframes_is_refused(played: Path, tmp_path: Path):
    with BagWriter(tmp_path / "told.mcap") as writer:
        topics.declare(writer, (topics.MAP,))
    with pytest.raises(BagError, match="has no keyframe of /a"):
        evaluate_robots(tmp_path / "told.mcap", played, tmp_path)
