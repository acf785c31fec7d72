"""A bag is played to the three nodes; each of them is killed in the middle of it and started again."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import Start, StartNode
from diagnostic_msgs.msg import DiagnosticArray
from peer import Peer
from rclpy.node import Node
from wandering import LATCHED

from neuse.records import MapObject, ObjectStatus
from neuse.simulation.worlds import PRESETS, make_world, simulate
from neuse_bags import topics
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagWriter
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_msgs.msg import ObjectMap

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ROUNDS, N_FRAMES = 3, 600  # long enough for three nodes that start slowly on a busy machine
RATE = 0.3  # so slow that a node starts within two seconds of data
NEAR_M = 0.15  # a session that has just found its place in a map of seconds errs by some centimetres
OFTEN = 8
KNOWN = 7  # of the table's twelve: by then the camera turns to objects that it has seen
WHOLE_NS = 10 * 10**9  # of data, within which the map is whole again
NODES = {
    "encoder_node": {"input_reliable": True},
    "slam_node": {},
    "mapper_node": {"map_period_s": 0.0, "draw_period_s": 3600.0},
}


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Around a tabletop on which nothing changes."""
    tabletop = PRESETS["tabletop"]
    preset = replace(tabletop, routes=tabletop.routes[:1] * ROUNDS, changes=(), frames=N_FRAMES)
    path = tmp_path_factory.mktemp("killed") / "rounds.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY))
        for simulated in simulate(make_world(preset, seed=3)):
            write_frame(writer, simulated.frame)
            stamp_ns, T_odom_camera = simulated.odometry.stamp_ns, simulated.odometry.T_odom_camera
            message = odometry_to_msg(stamp_ns, T_odom_camera, "odom")
            writer.write(topics.ODOMETRY.name, message, stamp_ns)
    return path


class Listener:
    """What is heard of the nodes while the bag plays."""

    def __init__(self, node: Node) -> None:
        self.peer = Peer(node, "slam_node")
        self._reports = self.peer.listen(DiagnosticArray, "/diagnostics")
        self._maps = self.peer.listen(ObjectMap, "neuse/map", LATCHED)

    def stamp_ns(self) -> int:
        """Of the latest map."""
        return stamp_from_msg(self._maps[-1].header.stamp) if self._maps else 0

    def objects(self) -> dict[int, MapObject]:
        """Those that stand somewhere by the latest map."""
        if not self._maps:
            return {}
        found = object_map_from_msg(self._maps[-1]).objects
        return {known.object_id: known for known in found if known.status != ObjectStatus.REMOVED}

    def well_known(self) -> dict[int, MapObject]:
        """Objects that have been seen often."""
        return {i: known for i, known in self.objects().items() if known.n_observations >= OFTEN}

    def well_known_in_sight(self) -> int:
        """How many are; it takes three of them for a new session to find its place."""
        recent_ns = self.stamp_ns() - 5 * 10**8
        return sum(known.last_seen_ns >= recent_ns for known in self.well_known().values())

    def wait_until_running(self, name: str) -> None:
        asked_ns = time.time_ns()

        def has_reported() -> bool:
            recent = (m for m in self._reports if stamp_from_msg(m.header.stamp) > asked_ns)
            return any(status.name == name for m in recent for status in m.status)

        self.peer.wait_for(has_reported, f"word of {name}")

    def wait_for_map(self, object_ids: set[int], after_ns: int) -> None:
        """Until a map later than this has all of these objects."""
        self.peer.wait_for(
            lambda: self.stamp_ns() > after_ns and self.objects().keys() >= object_ids,
            f"map later than {after_ns} with objects {sorted(object_ids)}",
        )


def test_any_node_killed_in_mid_bag_comes_back_to_the_whole_map(
    bag_path: Path, node: Node, start_node: StartNode, start_bags: Start
):
    listener = Listener(node)
    running = {name: start_node(name, **parameters) for name, parameters in NODES.items()}
    for name in NODES:
        listener.wait_until_running(name)
    start_bags("play", bag_path, "--rate", str(RATE), "--wait-for", "120")
    for name, parameters in NODES.items():
        listener.peer.wait_for(
            lambda: len(listener.well_known()) >= KNOWN and listener.well_known_in_sight() >= 3,
            f"{KNOWN} known objects, three of them in sight",
        )
        before, killed_ns = listener.well_known(), listener.stamp_ns()
        running[name].process.kill()
        running[name] = start_node(name, **parameters)
        listener.wait_until_running(name)
        listener.wait_for_map(set(before), after_ns=max(listener.stamp_ns(), killed_ns))
        assert listener.stamp_ns() - killed_ns <= WHOLE_NS, name
        after = listener.objects()
        for object_id, known in before.items():
            np.testing.assert_allclose(
                after[object_id].code.center, known.code.center, atol=NEAR_M, err_msg=name
            )
