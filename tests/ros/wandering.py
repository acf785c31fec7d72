"""A camera that wanders through a world of codes, told to slam_node; what mapper_node makes of it."""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from conftest import RunningNode, StartNode
from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from nav_msgs.msg import Odometry
from peer import Peer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from slam.synthetic import Step, Thing

from neuse.geometry import Array, transform_points
from neuse.records import ObjectMap, ObjectStatus, Observation
from neuse_bags.conversions import odometry_to_msg
from neuse_encoder_node.conversions import observed_frame_to_msg, stamp_from_msg
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_msgs.msg import ObjectMap as ObjectMapMsg
from neuse_msgs.msg import ObjectObservationArray, TrackedFrame

CATEGORY = "vase"  # of no shipped decoder
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
BATCH = 20  # messages that are under way at once
OBSERVATIONS = "neuse/observations"
RUN_NS = 10**12  # from one run back to the next
LAG_NS = 500_000_000  # that frames may wait for lost odometry


@dataclass
class Graph:
    """slam_node and mapper_node, and who talks to them."""

    slam: RunningNode
    mapper: RunningNode
    peer: Peer

    def send(self, messages: Sequence[tuple[str, Any]]) -> None:
        """Messages by topic, in this order, as fast as they are worked on."""
        for start in range(0, len(messages), BATCH):
            batch = messages[start : start + BATCH]
            for topic, message in batch:
                self.peer.send(topic, message)
            sent_ns = [stamp_from_msg(m.header.stamp) for topic, m in batch if topic == OBSERVATIONS]
            if sent_ns:
                self._wait_for("neuse/frames", max(sent_ns) - LAG_NS)

    def map_at(self, stamp_ns: int) -> ObjectMap:
        """The map once it is as late as this."""
        self._wait_for("neuse/map", stamp_ns)
        return object_map_from_msg(self.peer.heard["neuse/map"][-1])

    def wait_for_count(self, node: str, name: str, least: int = 1) -> None:
        """Until a node has counted so much."""
        self.peer.wait_for(lambda: self._count(node, name) >= least, f"{least} x {name} of {node}")

    def wait_for_report(self, node: str) -> None:
        """Until a node tells how it is now: one that has been killed may have reports under way."""
        asked_ns, heard = time.time_ns(), self.peer.heard["/diagnostics"]

        def has_reported() -> bool:
            recent = (m for m in heard if stamp_from_msg(m.header.stamp) > asked_ns)
            return any(s.name == node for m in recent for s in m.status)

        self.peer.wait_for(has_reported, f"word of {node}")

    def _count(self, node: str, name: str) -> int:
        """A counter as the node told it last."""
        told = (s for m in reversed(self.peer.heard["/diagnostics"]) for s in m.status if s.name == node)
        return next((int(value.value) for s in told for value in s.values if value.key == name), 0)

    def _wait_for(self, topic: str, stamp_ns: int) -> None:
        heard = self.peer.heard[topic]
        run_ns = range(stamp_ns, stamp_ns + RUN_NS // 2)  # an earlier run has later stamps
        self.peer.wait_for(
            lambda: heard and stamp_from_msg(heard[-1].header.stamp) in run_ns, f"{topic} of {stamp_ns} ns"
        )


def start_graph(node: Node, start_node: StartNode, **mapper_parameters: object) -> Graph:
    """Both nodes, ready."""
    slam, mapper = start_node("slam_node"), start_mapper(start_node, **mapper_parameters)
    peer = Peer(node, "slam_node")
    peer.listen(DiagnosticArray, "/diagnostics")
    peer.listen(TrackedFrame, "neuse/frames")
    peer.listen(ObjectMapMsg, "neuse/map", LATCHED)
    peer.connect(ObjectObservationArray, OBSERVATIONS)
    peer.connect(Odometry, "odom")
    peer.meet()
    peer.call(GetState, "mapper_node/get_state", GetState.Request())
    return Graph(slam, mapper, peer)


def start_mapper(start_node: StartNode, **parameters: object) -> RunningNode:
    """A mapper that tells its map after every frame, and draws nothing."""
    return start_node("mapper_node", map_period_s=0.0, draw_period_s=3600.0, **parameters)


def prepared(steps: Iterable[Step], run: int) -> list[Step]:
    """The steps of a run, with objects that no shipped decoder knows; later runs have earlier stamps."""
    return [_prepared(step, (10 - run) * RUN_NS) for step in steps]


def _prepared(step: Step, start_ns: int) -> Step:
    observations = tuple(map(_with_surface, step.frame.observations))
    stamp_ns = step.frame.stamp_ns + start_ns
    frame = replace(step.frame, stamp_ns=stamp_ns, observations=observations)
    return replace(step, frame=frame, odometry=replace(step.odometry, stamp_ns=stamp_ns))


def _with_surface(seen: Observation) -> Observation:
    """The landmarks of the code stand for the points that a camera sees."""
    code = replace(seen.code, category=CATEGORY)
    return replace(seen, code=code, cloud=code.landmarks.astype(np.float32))


def messages_of(steps: Iterable[Step]) -> list[tuple[str, Any]]:
    """What the nodes hear of them: odometry and codes."""
    found: list[tuple[str, Any]] = []
    for step in steps:
        odometry = odometry_to_msg(step.odometry.stamp_ns, step.odometry.T_odom_camera, "odom")
        found += [("odom", odometry), (OBSERVATIONS, observed_frame_to_msg(step.frame, "camera"))]
    return found


def assert_map_is_true(object_map: ObjectMap, things: Sequence[Thing], T_world_map: Array) -> None:
    """Every object of the map is a thing at its place, none is there twice, and none is missing."""
    present = [known for known in object_map.objects if known.status != ObjectStatus.REMOVED]
    centers = transform_points(T_world_map, np.array([known.code.center for known in present]))
    places = np.array([thing.T_world_object[:3, 3] for thing in things])
    distances_m = np.linalg.norm(centers[:, None] - places, axis=2)
    off_m = {(k.object_id, k.status.name): d for k, d in zip(present, distances_m.min(axis=1), strict=True)}
    assert not {name: distance for name, distance in off_m.items() if distance >= 0.06}
    assert sorted(distances_m.argmin(axis=1)) == list(range(len(things)))
