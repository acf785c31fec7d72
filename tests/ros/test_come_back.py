"""Save and come back with real processes: Ctrl-C leaves a map, later sessions go on in it, killed or not."""

import signal
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from conftest import StartNode
from rclpy.node import Node
from slam.synthetic import Step, Thing, World, small_world
from wandering import (
    OBSERVATIONS,
    Graph,
    assert_map_is_true,
    messages_of,
    prepared,
    start_graph,
    start_mapper,
)

from neuse.geometry import Array, make_transform, transform_points
from neuse.mapping.change_detection import settled_changes
from neuse.mapping.mapper import ObjectMapper
from neuse.records import ChangeKind, ObjectMap, ObjectStatus
from neuse_msgs.msg import ObjectChange as ObjectChangeMsg
from neuse_slam_node.conversions import change_from_msg

pytestmark = [pytest.mark.ros, pytest.mark.slow]

MOVED, GONE = 2, 8  # names of things
N_BLIND = 20  # steps of a session that has no odometry yet


def before() -> World:
    """Twelve things, and a camera that goes once round them."""
    world = small_world(3)
    return replace(world, path=world.path[:95])


def after() -> World:
    """The same place later: one thing stands elsewhere, one is gone, and the camera begins elsewhere."""
    world = small_world(3)
    there = make_transform(np.eye(3), [0.3, 0.3, 0.0]) @ world.things[MOVED].T_world_object
    things = [replace(t, T_world_object=there) if t.name == MOVED else t for t in world.things]
    return replace(world, things=[t for t in things if t.name != GONE], path=world.path[40:140], seed=7)


def steps_of(world: World, run: int) -> list[Step]:
    """The steps of a run, behind all things a far wall, so that free space is seen."""
    wall_m = np.full((48, 64), 6.0, np.float32)
    steps = prepared(world.steps(), run)
    return [replace(step, frame=replace(step.frame, coarse_depth_m=wall_m)) for step in steps]


def start_with(graph: Graph, start_node: StartNode, path: Path) -> None:
    """A mapper that goes on with a saved map; returns when both nodes have heard of each other."""
    graph.mapper = start_mapper(start_node, load_path=path)
    graph.wait_for_report("mapper_node")
    graph.wait_for_report("slam_node")


def settled(graph: Graph) -> dict[ChangeKind, set[int]]:
    """Ids of what has changed, by kind, without reports that a later one has superseded."""
    found: dict[ChangeKind, set[int]] = {kind: set() for kind in ChangeKind}
    for change in settled_changes(list(map(change_from_msg, graph.peer.heard["neuse/changes"]))):
        found[change.kind].add(change.object_id)
    return found


@dataclass
class Saved:
    """What the first session has left behind."""

    path: Path
    object_map: ObjectMap
    T_world_map: Array

    def id_of(self, thing: Thing) -> int:
        """What the map calls a thing."""
        known = self.object_map.objects
        centers = transform_points(self.T_world_map, np.array([item.code.center for item in known]))
        far_m = np.linalg.norm(centers - thing.T_world_object[:3, 3], axis=1)
        return known[int(far_m.argmin())].object_id

    @property
    def ids(self) -> set[int]:
        """All names."""
        return {known.object_id for known in self.object_map.objects}


@pytest.fixture(scope="module")
def graph(node: Node, start_node: StartNode, path: Path) -> Graph:
    made = start_graph(node, start_node, save_path=path)
    made.peer.listen(ObjectChangeMsg, "neuse/changes")
    return made


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("maps") / "room.map"


@pytest.fixture(scope="module")
def saved(graph: Graph, path: Path) -> Saved:
    """A first session: the slam_node is killed, the mapper is ended by Ctrl-C."""
    steps = steps_of(before(), run=0)
    graph.send(messages_of(steps))
    object_map = graph.map_at(steps[-1].frame.stamp_ns)
    graph.slam.process.kill()
    assert graph.mapper.end(signal.SIGINT) == 0
    return Saved(path, object_map, steps[0].T_world_camera)


def test_ctrl_c_leaves_a_map(saved: Saved):
    mapper = ObjectMapper({})
    mapper.load(saved.path)
    assert mapper.places().keys() == saved.ids
    assert len(saved.ids) == 12


def test_next_session_finds_its_place_keeps_the_names_and_tells_what_has_changed(
    graph: Graph, saved: Saved, start_node: StartNode
):
    graph.slam = start_node("slam_node")
    start_with(graph, start_node, saved.path)
    graph.peer.wait_for(lambda: "in a map of 12 objects" in graph.slam.output, "search for the place")
    graph.peer.heard["neuse/changes"].clear()
    world, steps = after(), steps_of(after(), run=1)
    blind = [(topic, m) for topic, m in messages_of(steps[:N_BLIND]) if topic == OBSERVATIONS]
    graph.send([*blind, *messages_of(steps[N_BLIND:])])
    found = graph.map_at(steps[-1].frame.stamp_ns)
    assert {known.object_id for known in found.objects} == saved.ids
    assert_map_is_true(found, world.things, saved.T_world_map)
    assert_changes(graph, saved, found)


def assert_changes(graph: Graph, saved: Saved, found: ObjectMap) -> None:
    """What the nodes have told is what has changed since the map was saved."""
    moved, gone = (saved.id_of(before().things[name]) for name in (MOVED, GONE))
    assert settled(graph) == {ChangeKind.MOVED: {moved}, ChangeKind.REMOVED: {gone}, ChangeKind.ADDED: set()}
    statuses = {known.object_id: known.status for known in found.objects}
    assert statuses[moved] == ObjectStatus.MOVED
    assert statuses[gone] == ObjectStatus.REMOVED


def test_mapper_that_is_killed_and_begins_with_the_saved_map_gets_back_what_has_changed_since(
    graph: Graph, saved: Saved, start_node: StartNode
):
    graph.mapper.process.kill()
    start_with(graph, start_node, saved.path)
    steps = steps_of(replace(after(), path=small_world(3).path[40:170]), run=1)[100:]
    graph.send(messages_of(steps))
    found = graph.map_at(steps[-1].frame.stamp_ns)
    assert {known.object_id for known in found.objects} == saved.ids
    assert_map_is_true(found, after().things, saved.T_world_map)
