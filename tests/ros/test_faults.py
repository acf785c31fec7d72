"""The graph under faults: messages lost and out of order, odometry that jumps, clocks that go back, kill -9.

All runs go through one pair of processes; stamps go back from run to run, as those of a bag that is looped.
"""

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hand_made import frame_messages
from peer import Peer
from rclpy.node import Node
from slam.synthetic import Step, World, small_world
from wandering import Graph, assert_map_is_true, messages_of, prepared, start_graph, start_mapper

from neuse.geometry import exp
from neuse.records import ObjectMap
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_encoder_node.node import INPUTS
from neuse_msgs.msg import ObjectObservationArray

pytestmark = [pytest.mark.ros, pytest.mark.slow]

LOST, LATE_S = 0.05, 0.2


@pytest.fixture(scope="module")
def graph(node: Node, start_node) -> Graph:
    return start_graph(node, start_node)


def final_map(graph: Graph, steps: list[Step]) -> ObjectMap:
    """The map after these steps."""
    graph.send(messages_of(steps))
    return graph.map_at(steps[-1].frame.stamp_ns)


def unreliable(messages: list[tuple[str, Any]], steps_s: float, seed: int) -> list[tuple[str, Any]]:
    """The messages as a bad network brings them: some not at all, others late."""
    rng = np.random.default_rng(seed)
    sent_s = np.arange(len(messages)) // 2 * steps_s + rng.uniform(0.0, LATE_S, len(messages))
    kept = rng.random(len(messages)) >= LOST
    return [messages[i] for i in np.argsort(sent_s, kind="stable") if kept[i]]


def test_lost_and_late_messages_are_counted_and_the_map_is_right(graph: Graph):
    world = small_world()
    steps = prepared(world.steps(), run=0)
    middle = unreliable(messages_of(steps[1:-20]), 0.1, seed=3)
    graph.send([*messages_of(steps[:1]), *middle])
    assert_map_is_true(final_map(graph, steps[-20:]), world.things, steps[0].T_world_camera)
    graph.wait_for_count("slam_node", "stale_stamp", 10)


def test_clock_that_goes_back_begins_a_new_map(graph: Graph):
    world = small_world()
    steps = prepared(world.steps(), run=1)[:110]
    found = final_map(graph, steps)
    assert_map_is_true(found, world.things, steps[0].T_world_camera)
    assert min(known.first_seen_ns for known in found.objects) >= steps[0].frame.stamp_ns
    graph.wait_for_count("slam_node", "time_jump")
    graph.wait_for_count("mapper_node", "time_jump")


def test_odometry_that_jumps_by_metres_is_counted_and_the_map_is_right(graph: Graph):
    world = small_world()
    steps = prepared(world.steps(), run=2)[:110]
    for start in (40, 90, 91):
        T = exp([0.5, -0.2, 1.0, 4.0, -7.0, 2.0])
        steps[start:] = [jumped(step, T) for step in steps[start:]]
    assert_map_is_true(final_map(graph, steps), world.things, steps[0].T_world_camera)
    graph.wait_for_count("slam_node", "odometry_jump", 3)


def jumped(step: Step, T: Any) -> Step:
    odometry = replace(step.odometry, T_odom_camera=T @ step.odometry.T_odom_camera)
    return replace(step, odometry=odometry)


def narrow_world() -> World:
    """Twelve objects of which a few are in sight at once; all have been after a loop of ninety steps."""
    return replace(small_world(), max_range_m=1.5)


def test_mapper_that_is_killed_and_started_again_has_the_whole_map_within_seconds(graph: Graph, start_node):
    steps = prepared(narrow_world().steps(), run=3)
    before = final_map(graph, steps[:100])
    assert len(before.objects) == 12
    graph.mapper.process.kill()
    graph.send(messages_of(steps[100:105]))
    graph.mapper = start_mapper(start_node)
    graph.wait_for_report("mapper_node")
    used = resume(graph, steps[105:160])
    after = final_map(graph, steps[105 + used : 110 + used])
    assert len({name for step in steps[100 : 110 + used] for name in step.names}) < 12
    known = {item.object_id: item for item in after.objects}
    assert known.keys() >= {item.object_id for item in before.objects}
    for item in before.objects:
        np.testing.assert_allclose(known[item.object_id].code.center, item.code.center, atol=0.05)
        assert known[item.object_id].first_seen_ns == item.first_seen_ns


def test_slam_node_that_is_killed_and_started_again_finds_its_place_in_the_map(graph: Graph, start_node):
    world = narrow_world()
    steps = prepared(world.steps(), run=4)
    before = final_map(graph, steps[:90])
    assert len(before.objects) == 12
    graph.slam.process.kill()
    graph.slam = start_node("slam_node")
    graph.wait_for_report("slam_node")
    used = resume(graph, steps[95:175])
    after = final_map(graph, steps[95 + used : 100 + used])
    assert {item.object_id for item in after.objects} == {item.object_id for item in before.objects}
    assert_map_is_true(after, world.things, steps[0].T_world_camera)


def test_frames_of_which_messages_are_lost_are_counted_and_the_encoder_goes_on(node: Node, start_node):
    peer = Peer(node, "encoder_node")
    seen = peer.listen(ObjectObservationArray, "neuse/observations")
    queues = {"input_depth": 1000, "queue_size": 1000}  # nothing else is lost
    encoder = start_node("encoder_node", input_reliable=True, weights="['mug']", **queues)
    for topic, message in frame_messages(1).by_topic().items():
        peer.connect(type(message), topic)
    peer.meet()
    arrived = send_with_loss(peer, start_ns=10**9, n_frames=60)
    whole = [stamp_ns for stamp_ns, n_messages in arrived.items() if n_messages == len(INPUTS)]
    parts = [stamp_ns for stamp_ns in arrived if stamp_ns not in whole and stamp_ns < whole[-1]]
    assert len(parts) > 10
    peer.wait_for_stamp("neuse/observations", whole[-1])
    assert [stamp_from_msg(message.header.stamp) for message in seen] == whole
    peer.wait_for_count("incomplete_frame", len(parts))
    peer.wait_for_count("frames", len(whole))
    assert (peer.count("incomplete_frame"), peer.count("frames")) == (len(parts), len(whole))
    assert encoder.end() == 0


def send_with_loss(peer: Peer, start_ns: int, n_frames: int) -> dict[int, int]:
    """Frames of which each message may get lost by itself; how many of each frame are sent, by stamp."""
    rng, arrived = np.random.default_rng(7), Counter[int]()
    for stamp_ns in range(start_ns, start_ns + n_frames * 10**8, 10**8):
        for topic, message in frame_messages(stamp_ns).by_topic().items():
            if rng.random() >= LOST:
                peer.send(topic, message)
                arrived[stamp_ns] += 1
        peer.spin(0.02)
    return arrived


def test_encoder_that_is_killed_and_started_again_goes_on(node: Node, start_node):
    peer = Peer(node, "encoder_node")
    seen = peer.listen(ObjectObservationArray, "neuse/observations")
    encoder = start_node("encoder_node", input_reliable=True, weights="['mug']")
    for topic, message in frame_messages(1).by_topic().items():
        peer.connect(type(message), topic)
    send_until_seen(peer, seen, start_ns=10**9)
    encoder.process.kill()
    start_node("encoder_node", input_reliable=True, weights="['mug']")
    send_until_seen(peer, seen, start_ns=10**12)


def send_until_seen(peer: Peer, seen: list[ObjectObservationArray], start_ns: int) -> None:
    """Send frames until one of them has been encoded."""
    seen.clear()
    for index in range(200):
        for topic, message in frame_messages(start_ns + index * 10**8).by_topic().items():
            peer.send(topic, message)
        peer.spin(0.5)
        if seen:
            return
    raise AssertionError("no frame is encoded")


def resume(graph: Graph, steps: list[Step]) -> int:
    """Send steps until the graph is whole again, which shows by a map of them; how many that took."""
    maps, start_ns = graph.peer.heard["neuse/map"], steps[0].frame.stamp_ns
    maps.clear()
    for used, step in enumerate(steps, start=1):
        for topic, message in messages_of([step]):
            graph.peer.send(topic, message)
        graph.peer.spin(0.3)
        if maps and stamp_from_msg(maps[-1].header.stamp) >= start_ns:
            return used
    raise AssertionError(f"no map within {len(steps)} steps")
