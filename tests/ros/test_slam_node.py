"""slam_node as a process of its own, fed with codes and odometry, beside the same stage without ROS."""

import signal
from dataclasses import dataclass, replace

import numpy as np
import pytest
from nav_msgs.msg import Odometry, Path
from peer import Peer
from rclpy.node import Node
from slam.synthetic import Step, small_world

from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind, Keyframe, TrackedFrame
from neuse.slam.slam import ObjectSlam
from neuse_encoder_node.conversions import header_to_msg, observed_frame_to_msg
from neuse_msgs.msg import KeyframeArray, ObjectChange, ObjectObservationArray, PoseGraphEdgeArray
from neuse_msgs.msg import TrackedFrame as TrackedFrameMsg
from neuse_slam_node import conversions
from neuse_slam_node.poses import pose_to_msg, transform_from_msg

pytestmark = pytest.mark.ros

N_STEPS = 60
CAMERA = "camera_optical_frame"


@dataclass
class Tracker:
    """The node under test and its peer; `steps` of a small world."""

    peer: Peer
    steps: list[Step]

    def send(self, step: Step, odometry_first: bool = True, with_odometry: bool = True) -> None:
        """One step; the order of the topics must not matter."""
        sends = [
            ("odom", odometry_message(step)),
            ("neuse/observations", observed_frame_to_msg(step.frame, CAMERA)),
        ]
        for topic, message in sends if odometry_first else sends[::-1]:
            if with_odometry or topic != "odom":
                self.peer.send(topic, message)

    def external_refusals(self) -> int:
        """How many edges of an external SLAM were refused."""
        counters = self.peer.diagnostics.items()
        return sum(int(value) for name, value in counters if name.startswith("external_edge_"))

    def wait(self, stamp_ns: int) -> TrackedFrame:
        return conversions.tracked_frame_from_msg(self.peer.wait_for_stamp("neuse/frames", stamp_ns))


def odometry_message(step: Step) -> Odometry:
    stamp_ns, T_odom_camera = step.odometry.stamp_ns, step.odometry.T_odom_camera
    message = Odometry(header=header_to_msg(stamp_ns, "odom"), child_frame_id=CAMERA)
    message.pose.pose = pose_to_msg(T_odom_camera)
    return message


def later(step: Step, seconds: float) -> Step:
    """The same step at another time."""
    stamp_ns = step.frame.stamp_ns + int(seconds * 1e9)
    odometry = replace(step.odometry, stamp_ns=stamp_ns)
    return replace(step, frame=replace(step.frame, stamp_ns=stamp_ns), odometry=odometry)


@pytest.fixture(scope="module")
def slam(start_node):
    return start_node("slam_node")


@pytest.fixture(scope="module")
def tracker(node: Node, slam) -> Tracker:
    peer = Peer(node, "slam_node")
    peer.listen(TrackedFrameMsg, "neuse/frames")
    peer.listen(PoseGraphEdgeArray, "neuse/edges")
    peer.listen(KeyframeArray, "neuse/keyframes")
    peer.listen(Odometry, "neuse/odometry")
    peer.listen(Path, "neuse/path")
    peer.connect(ObjectObservationArray, "neuse/observations")
    peer.connect(Odometry, "odom")
    peer.connect(PoseGraphEdgeArray, "neuse/external_edges")
    peer.connect(ObjectChange, "neuse/changes")
    peer.meet()
    return Tracker(peer, list(small_world().steps()))


@pytest.fixture(scope="module")
def expected(tracker: Tracker) -> tuple[list[TrackedFrame], tuple[Keyframe, ...]]:
    """What the stage gives without ROS."""
    stage = ObjectSlam()
    frames = [stage.step(step.frame, step.odometry) for step in tracker.steps[:N_STEPS]]
    return frames, stage.keyframes


@pytest.fixture(scope="module")
def tracked(tracker: Tracker) -> list[TrackedFrame]:
    """What the node gives; every third time the observations come before the odometry."""
    for index, step in enumerate(tracker.steps[:N_STEPS]):
        tracker.send(step, odometry_first=index % 3 > 0)
    return [tracker.wait(step.frame.stamp_ns) for step in tracker.steps[:N_STEPS]]


def same_edge(one: Edge, other: Edge) -> bool:
    names = ("from_id", "to_id", "from_stamp_ns", "to_stamp_ns", "kind", "object_ids")
    return (
        all(getattr(one, name) == getattr(other, name) for name in names)
        and np.allclose(one.T_from_to, other.T_from_to, atol=1e-6)
        and np.allclose(one.covariance, other.covariance, rtol=1e-4, atol=1e-9)
    )


def test_node_gives_the_edges_of_the_stage_without_ros(tracker: Tracker, tracked, expected):
    wanted = [edge for frame in expected[0] for edge in frame.edges]
    assert len(wanted) > N_STEPS / 4
    messages = tracker.peer.heard["neuse/edges"]
    tracker.peer.wait_for(lambda: sum(len(m.edges) for m in messages) >= len(wanted), f"{len(wanted)} edges")
    published = [edge for message in messages for edge in conversions.edges_from_msgs(message.edges)]
    assert len(published) == len(wanted)
    assert all(same_edge(one, other) for one, other in zip(published, wanted, strict=True))


def test_node_gives_the_poses_and_objects_of_the_stage_without_ros(tracked, expected):
    for one, other in zip(tracked, expected[0], strict=True):
        np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-6)
        assert [(o.status, o.object_id) for o in one.observations] == [
            (o.status, o.object_id) for o in other.observations
        ]
        assert one.keyframe_id == other.keyframe_id


def test_keyframes_and_path_have_the_latest_estimates(tracker: Tracker, tracked, expected):
    messages = tracker.peer.heard["neuse/keyframes"]
    tracker.peer.wait_for(lambda: len(messages[-1].keyframes) == len(expected[1]), "all keyframes")
    keyframes = conversions.keyframes_from_msg(messages[-1])
    assert [k.keyframe_id for k in keyframes] == [k.keyframe_id for k in expected[1]]
    for one, other in zip(keyframes, expected[1], strict=True):
        np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-6)
    assert tracker.peer.heard["neuse/path"]


def test_odometry_of_the_estimate_has_the_pose_of_its_frame(tracker: Tracker, tracked):
    for frame in tracked[:5]:
        message = tracker.peer.wait_for_stamp("neuse/odometry", frame.stamp_ns)
        assert (message.header.frame_id, message.child_frame_id) == ("map", CAMERA)
        T_map_camera = transform_from_msg(message.pose.pose)
        np.testing.assert_allclose(T_map_camera, frame.T_map_camera, atol=1e-9)


def test_edge_of_an_external_slam_is_taken_by_the_stamps_of_its_ends(tracker: Tracker, tracked):
    first, second = tracked[0], tracked[-1]
    T_from_to = inverse(first.T_map_camera) @ second.T_map_camera
    edge = Edge(0, 1, first.stamp_ns, second.stamp_ns, EdgeKind.EXTERNAL, T_from_to, 1e-4 * np.eye(6))
    before = len(tracker.peer.heard["neuse/keyframes"])
    tracker.peer.send("neuse/external_edges", conversions.edges_to_msg([edge], second.stamp_ns, CAMERA))
    tracker.peer.wait_for_count("external_edges")
    tracker.peer.wait_for(lambda: len(tracker.peer.heard["neuse/keyframes"]) > before, "new keyframes")


def test_external_edge_between_unknown_stamps_is_refused(tracker: Tracker, tracked, slam):
    edge = Edge(0, 1, 5, 6, EdgeKind.EXTERNAL, np.eye(4), np.eye(6))
    tracker.peer.send("neuse/external_edges", conversions.edges_to_msg([edge], 6, CAMERA))
    tracker.peer.wait_for(lambda: any("external" in name for name in tracker.peer.diagnostics), "a counter")


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_external_edge_with_an_impossible_covariance_is_counted(
    tracker: Tracker, tracked, slam, value: float
):
    first, second = tracked[0], tracked[-1]
    edge = Edge(0, 1, first.stamp_ns, second.stamp_ns, EdgeKind.EXTERNAL, np.eye(4), np.eye(6))
    message = conversions.edges_to_msg([edge], second.stamp_ns, CAMERA)
    message.edges[0].pose.covariance = np.full(36, value)
    before = tracker.external_refusals()
    tracker.peer.send("neuse/external_edges", message)
    tracker.peer.wait_for(lambda: tracker.external_refusals() > before, "a counter of external edges")
    assert "internal_error" not in slam.output


def spoil_code(message: ObjectObservationArray) -> None:
    message.observations[0].code.z = message.observations[0].code.z[:-1]


def spoil_descriptor(message: ObjectObservationArray) -> None:
    message.observations[0].code.descriptor = message.observations[0].code.descriptor[:-2]


def spoil_cloud(message: ObjectObservationArray) -> None:
    message.observations[0].cloud = message.observations[0].cloud[:-1]


def spoil_thumbnail(message: ObjectObservationArray) -> None:
    message.coarse_depth.data = message.coarse_depth.data[:-4]


SPOIL = [spoil_code, spoil_descriptor, spoil_cloud, spoil_thumbnail]


@pytest.mark.parametrize("spoil", SPOIL)
def test_observations_of_wrong_array_length_are_counted(tracker: Tracker, tracked, spoil):
    step = later(tracker.steps[N_STEPS - 1], 0.01 * (1 + SPOIL.index(spoil)))
    message = observed_frame_to_msg(step.frame, CAMERA)
    spoil(message)
    before = tracker.peer.count("array_length")
    tracker.peer.send("odom", odometry_message(step))
    tracker.peer.send("neuse/observations", message)
    tracker.peer.wait_for_count("array_length", before + 1)


def test_unusable_messages_are_counted_and_the_next_frame_is_right(tracker: Tracker, tracked, slam):
    bad, good = tracker.steps[N_STEPS], tracker.steps[N_STEPS + 1]
    odometry = odometry_message(bad)
    odometry.pose.pose.orientation.w = float("nan")
    tracker.peer.send("odom", odometry)
    tracker.peer.send("neuse/changes", ObjectChange(kind=77))
    tracker.send(good)
    frame = tracker.wait(good.frame.stamp_ns)
    truth = inverse(tracker.steps[0].T_world_camera) @ good.T_world_camera
    assert np.linalg.norm(frame.T_map_camera[:3, 3] - truth[:3, 3]) < 0.1
    for reason in ("odometry_pose", "change_enum_value"):
        tracker.peer.wait_for_count(reason)
        assert f"{reason}: " in slam.output


def test_frames_go_on_when_odometry_stops(tracker: Tracker, tracked):
    silent = tracker.steps[N_STEPS + 2 : N_STEPS + 12]
    for step in silent:
        tracker.send(step, with_odometry=False)
    for step in silent:
        tracker.wait(step.frame.stamp_ns)
    tracker.peer.wait_for(
        lambda: tracker.peer.count("odometry_stale") + tracker.peer.count("odometry_missing") >= 1,
        "a counter",
    )


def test_jump_of_odometry_is_counted_and_does_not_move_the_camera(tracker: Tracker, tracked):
    steps = tracker.steps[N_STEPS + 12 : N_STEPS + 16]
    jump = exp([0.0, 0.0, 0.0, 100.0, 0.0, 0.0])
    for index, step in enumerate(steps):
        T_odom_camera = jump @ step.odometry.T_odom_camera if index else step.odometry.T_odom_camera
        tracker.send(replace(step, odometry=replace(step.odometry, T_odom_camera=T_odom_camera)))
    poses = [tracker.wait(step.frame.stamp_ns).T_map_camera for step in steps]
    assert np.linalg.norm(poses[-1][:3, 3] - poses[0][:3, 3]) < 1.0
    tracker.peer.wait_for_count("odometry_jump")


def test_late_frame_is_dropped(tracker: Tracker, tracked):
    tracker.send(later(tracker.steps[N_STEPS + 15], -0.25))
    tracker.peer.wait_for_count("stale_stamp")


def test_stamps_that_go_back_start_a_new_map(tracker: Tracker, tracked, expected, slam):
    again = [later(step, -0.5) for step in tracker.steps[:10]]
    tracker.peer.heard["neuse/frames"].clear()
    for step in again:
        tracker.send(step)
    frames = [tracker.wait(step.frame.stamp_ns) for step in again]
    for one, other in zip(frames, expected[0], strict=False):
        np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-6)
    assert frames[0].keyframe_id == 0
    tracker.peer.wait_for_count("time_jump")
    assert "time_jump: stamps went back" in slam.output


def test_sigterm_ends_it_well(tracker: Tracker, tracked, slam):
    assert slam.process.poll() is None
    assert slam.end(signal.SIGTERM) == 0
    assert "Traceback" not in slam.output
