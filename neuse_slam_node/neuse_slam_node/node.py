"""slam_node: latent codes and odometry in; camera poses, keyframes and pose-graph edges out."""

import sys
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from nav_msgs.msg import Odometry, Path
from rclpy.duration import Duration
from rclpy.qos import QoSProfile

from neuse.errors import InputError, ParamError
from neuse.geometry import Array, transform_from_quaternion
from neuse.params import param
from neuse.records import NO_ID, OdometrySample, TrackedFrame
from neuse.slam.feedback import DELAY_S, ChangeFeedback
from neuse.slam.joining import Joiner, JoiningParams
from neuse.slam.params import SlamParams
from neuse.slam.slam import ObjectSlam
from neuse_encoder_node.conversions import observed_frame_from_msg, stamp_from_msg
from neuse_encoder_node.qos import latched, reliable, sensor
from neuse_encoder_node.run import run
from neuse_encoder_node.stage_node import StageNode, StageParams
from neuse_encoder_node.stamps import NANOSECONDS
from neuse_msgs.msg import KeyframeArray, ObjectChange, ObjectMap, ObjectObservationArray, PoseGraphEdgeArray
from neuse_msgs.msg import TrackedFrame as TrackedFrameMsg
from neuse_slam_node import conversions
from neuse_slam_node.map_frame import make_broadcaster
from neuse_slam_node.map_memory import PATIENCE_S, MapMemory
from neuse_slam_node.odometry_match import OdometryMatch
from neuse_slam_node.packed_keyframes import KeyframeTable, pack

NAME = "slam_node"
PATIENCE = Duration(seconds=1)  # with the receivers of frames that come all at once
IDENTITY = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True)
class SlamNodeParams(StageParams):
    """Parameters of slam_node."""

    queue_size: int = param(100, "frames that may wait for the worker; beyond it the oldest goes", 1, 100000)
    topic_depth: int = param(100, "depth of the reliable queues", 1, 10000)
    odometry_reliable: bool = param(True, "false: also hear odometry that is published as best effort")
    odometry_wait_s: float = param(
        0.3, "how far frames may get ahead of odometry before they do without", 0.0, 10.0
    )
    feedback_delay_s: float = param(
        DELAY_S, "a change is applied at the first frame so long after it", 0.0, 60.0
    )
    path_period_s: float = param(1.0, "the path is published at most this often, in stamps", 0.0, 60.0)
    map_frame: str = param("map", "name of the frame of the estimate")
    broadcast_tf: bool = param(True, "broadcast map -> odom where tf2_ros is installed")
    T_child_camera: tuple[float, ...] = param(
        IDENTITY,
        "pose of the camera optical frame in the odometry's child frame: x, y, z (metres), qx, qy, qz, qw",
    )
    slam: SlamParams = field(default_factory=SlamParams)
    joining: JoiningParams = field(default_factory=JoiningParams)

    def __post_init__(self) -> None:
        super().__post_init__()
        unit = abs(np.linalg.norm(self.T_child_camera[3:]) - 1.0) <= 0.01
        if len(self.T_child_camera) != 7 or not unit or not np.isfinite(self.T_child_camera).all():
            raise ParamError(
                f"parameter T_child_camera = {self.T_child_camera} is no pose; give x, y, z, qx, qy, qz, qw"
            )

    @property
    def camera_pose(self) -> Array:
        """(4, 4) T_child_camera."""
        return transform_from_quaternion(self.T_child_camera[3:], self.T_child_camera[:3])


class SlamNode(StageNode):
    """Tracks the camera against the objects. Frames wait for their odometry, changes for their delay."""

    def __init__(self) -> None:
        super().__init__(NAME, SlamNodeParams())

    def build(self, params: SlamNodeParams) -> None:
        self._params = params
        self._slam = ObjectSlam(params.slam)
        self._joiner = Joiner(self._slam, params.joining)
        self._match = OdometryMatch(params.odometry_wait_s, params.restart_s)
        self._feedback = ChangeFeedback(params.feedback_delay_s)
        self._T_child_camera = params.camera_pose
        self._map_frame = make_broadcaster(self, params.map_frame) if params.broadcast_tf else None
        self._odometry_topic = self.resolve_topic_name("odom")
        self._camera_frame = self._odom_frame = ""
        self._last_stamp_ns = self._next_path_ns = 0
        self._counted: Counter[str] = Counter()
        self._memory = MapMemory()
        self._table = KeyframeTable()
        self._connect(params.topic_depth, reliable if params.odometry_reliable else sensor)

    def _connect(self, depth: int, odometry_qos: Callable[[int], QoSProfile]) -> None:
        self._edges = self.offer(PoseGraphEdgeArray, "neuse/edges", reliable(depth))
        self._frames = self.offer(TrackedFrameMsg, "neuse/frames", reliable(depth))
        self._keyframes = self.offer(KeyframeArray, "neuse/keyframes", latched(depth))
        self._odometry = self.offer(Odometry, "neuse/odometry", reliable(depth))
        self._path = self.offer(Path, "neuse/path", reliable(1))
        self.listen(ObjectObservationArray, "neuse/observations", self._receive_frame, reliable(depth))
        self.listen(Odometry, "odom", self._receive_odometry, odometry_qos(depth))
        self.listen(PoseGraphEdgeArray, "neuse/external_edges", self._receive_edges, reliable(depth))
        self.listen(ObjectChange, "neuse/changes", self._receive_change, reliable(depth))
        self._recalled = self.offer(ObjectMap, "neuse/recalled_map", reliable(1))
        self.listen(ObjectMap, "neuse/map", self._receive_map, latched())
        self.listen(ObjectMap, "neuse/prior_map", self._receive_prior, latched())

    def forget(self) -> None:
        self._joiner.begin()
        self._begin()
        self._memory.forget()

    def _begin(self) -> None:
        """A session begins: what belonged to the one before is gone."""
        self._feedback.clear()
        self._counted.clear()
        self._table.clear()
        self._next_path_ns = 0

    def process(self, stamp_ns: int, item: tuple[ObjectObservationArray, OdometrySample | None]) -> None:
        message, odometry = item
        self._camera_frame = message.header.frame_id
        observed = observed_frame_from_msg(message)
        for change in self._feedback.due(stamp_ns):
            self._slam.apply_change(change)
        with self.health.timed("slam"):
            frame = self._slam.step(observed, odometry)
        for stage, milliseconds in self._slam.stopwatch.stage_ms.items():
            self.health.add_time(stage, milliseconds / 1e3)
        self.health.tally("objects", len(frame.observations))
        self.health.tally("edges", len(frame.edges))
        self._count_faults(stamp_ns)
        frames = self._joiner.follow(frame)
        self.health.state("held_frames", self._joiner.n_held)
        self._publish(frames)
        if odometry is not None and frames:
            self._broadcast(frames[-1], odometry)

    def _broadcast(self, frame: TrackedFrame, odometry: OdometrySample) -> None:
        """Map -> odom, from odometry of this very moment that names its frame."""
        age_s = abs(frame.stamp_ns - odometry.stamp_ns) / NANOSECONDS
        if self._map_frame is not None and self._odom_frame and age_s <= self._params.slam.odometry.max_age_s:
            self._map_frame.broadcast(frame, odometry.T_odom_camera, self._odom_frame)

    def flush(self) -> None:
        self._release(patient=False)

    def finish(self) -> None:
        self._publish_path()

    def _receive_frame(self, message: ObjectObservationArray) -> None:
        self._match.add_frame(stamp_from_msg(message.header.stamp), message)
        self._release()

    def _receive_odometry(self, message: Odometry) -> None:
        try:
            sample = conversions.odometry_from_msg(message, self._T_child_camera)
        except InputError as error:
            self.refuse(f"odometry_{error.reason}", str(error))
            return
        self._odom_frame = message.header.frame_id
        self._match.add_sample(sample)
        self._release()

    def _release(self, patient: bool = True) -> None:
        """Hand frames over to the worker that have their odometry, or need not wait for it."""
        expected = patient and self.count_publishers(self._odometry_topic) > 0
        for stamp_ns, message, odometry in self._match.release(expected):
            self.enqueue(stamp_ns, (message, odometry))

    def _receive_edges(self, message: PoseGraphEdgeArray) -> None:
        try:
            edges = conversions.edges_from_msgs(message.edges)
        except InputError as error:
            self.refuse(f"external_edge_{error.reason}", str(error))
            return
        with self.lock:
            added = self._slam.add_external_edges(edges)
            self._count_faults(stamp_from_msg(message.header.stamp))
            if added:
                self.health.tally("external_edges", added)
                self._publish_keyframes(self._last_stamp_ns)

    def _receive_change(self, message: ObjectChange) -> None:
        try:
            change = conversions.change_from_msg(message)
        except InputError as error:
            self.refuse(f"change_{error.reason}", str(error))
            return
        with self.lock:
            self._feedback.add(change)

    def _receive_map(self, message: ObjectMap) -> None:
        """A mapper that was started again gets back what the one before it knew."""
        lost = self._memory.hear(message)
        if lost is not None:
            self.get_logger().info(
                f"mapper has started anew: it is told of {len(lost.objects)} objects",
                throttle_duration_sec=PATIENCE_S,
            )
            self._recalled.publish(lost)

    def _receive_prior(self, message: ObjectMap) -> None:
        """There is a map that this session did not make: it joins it, or learns what is new in it."""
        prior = conversions.prior_map_from_msg(message)
        with self.lock:
            if self._joiner.offer(prior):
                self._begin()
                self.get_logger().info(f"looking for the camera's place in a map of {len(prior)} objects")

    def _count_faults(self, stamp_ns: int) -> None:
        """Pass on what the library has counted since the last look."""
        for reason, amount in (self._slam.counters - self._counted).items():
            self.refuse(reason, f"{amount} refused (stamp {stamp_ns} ns)", amount)
        self._counted = Counter(self._slam.counters)

    def _publish(self, frames: Sequence[TrackedFrame]) -> None:
        """Mostly one frame; all that were held back when a map has been joined, not faster than they go."""
        if any(frame.keyframe_id != NO_ID or frame.loop_closed for frame in frames):
            self._publish_keyframes(frames[-1].stamp_ns)
        for i, frame in enumerate(frames):
            self._publish_frame(frame)
            if i % self._params.topic_depth == self._params.topic_depth - 1:
                self._frames.wait_for_all_acked(PATIENCE)
        if frames and frames[-1].stamp_ns >= self._next_path_ns:
            self._publish_path()
            self._next_path_ns = frames[-1].stamp_ns + int(self._params.path_period_s * NANOSECONDS)

    def _publish_frame(self, frame: TrackedFrame) -> None:
        map_frame = self._params.map_frame
        self._last_stamp_ns = frame.stamp_ns
        if frame.edges:
            self._edges.publish(conversions.edges_to_msg(frame.edges, frame.stamp_ns, self._camera_frame))
        self._frames.publish(conversions.tracked_frame_to_msg(frame, map_frame, self._camera_frame))
        self._odometry.publish(conversions.odometry_to_msg(frame, map_frame, self._camera_frame))

    def _publish_keyframes(self, stamp_ns: int) -> None:
        self._table.update(self._slam.moved_keyframes())
        if self._table.is_old:
            self._table.renew(self._slam.keyframes)
        self._keyframes.publish(pack(self._table.records, stamp_ns, self._params.map_frame))

    def _publish_path(self) -> None:
        """For people only: where nobody looks it is not worth the time."""
        if self._path.get_subscription_count():
            self._path.publish(conversions.path_to_msg(self._slam.keyframes, self._params.map_frame))


def main() -> None:
    """Entry point of `ros2 run neuse_slam_node slam_node`."""
    sys.exit(run(SlamNode))
