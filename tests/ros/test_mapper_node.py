"""mapper_node as a process of its own, fed with tracked frames, beside the same stage without ROS."""

import signal
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from mapping.synthetic import World, five_things, make_world, orbit
from peer import Peer
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import PointCloud2
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker, MarkerArray

from neuse.mapping.mapper import ObjectMapper
from neuse.records import NO_ID, ChangeKind, Keyframe, ObjectChange, ObjectMap, TrackedFrame
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_msgs.msg import KeyframeArray
from neuse_msgs.msg import ObjectChange as ObjectChangeMsg
from neuse_msgs.msg import ObjectMap as ObjectMapMsg
from neuse_msgs.msg import TrackedFrame as TrackedFrameMsg
from neuse_msgs.srv import LoadMap, SaveMap
from neuse_slam_node import conversions

pytestmark = pytest.mark.ros

CATEGORY = "vase"  # of no shipped decoder: drawn as boxes, in the node as in the test
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Diary(ObjectMapper):
    """Remembers what it is fed."""

    def __init__(self) -> None:
        super().__init__({})
        self.fed: list[tuple[TrackedFrame, tuple[Keyframe, ...]]] = []

    def step(self, frame, keyframes=()):
        self.fed.append((frame, tuple(keyframes)))
        return super().step(frame, keyframes)


@dataclass
class Told:
    """Two tours around a table, between which one object is moved and one taken away; what came of it."""

    fed: list[tuple[TrackedFrame, tuple[Keyframe, ...]]]
    changes: list[ObjectChange]
    object_map: ObjectMap
    held_back: tuple[ObjectChange, ...]


@dataclass
class Mapper:
    """The node under test and its peer."""

    peer: Peer
    maps: list[ObjectMapMsg] = field(default_factory=list)

    def send(
        self, frame: TrackedFrame, keyframes: tuple[Keyframe, ...], keyframes_first: bool = True
    ) -> None:
        sends = [
            ("neuse/keyframes", conversions.keyframes_to_msg(keyframes, frame.stamp_ns, "map")),
            ("neuse/frames", conversions.tracked_frame_to_msg(frame, "map", "camera")),
        ]
        for topic, message in sends if keyframes_first else sends[::-1]:
            self.peer.send(topic, message)

    def wait_for_frames(self, least: int) -> None:
        self.peer.wait_for_count("frames", least)


@pytest.fixture(scope="module")
def save_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept") / "room.map"


@pytest.fixture(scope="module")
def mapper(start_node, save_path: Path):
    return start_node("mapper_node", map_period_s=0.0, save_path=save_path)


@pytest.fixture(scope="module")
def mapped(node: Node, mapper) -> Mapper:
    peer = Peer(node, "mapper_node")
    maps = peer.listen(ObjectMapMsg, "neuse/map", LATCHED)
    peer.listen(ObjectChangeMsg, "neuse/changes")
    peer.listen(MarkerArray, "neuse/markers", LATCHED)
    peer.listen(PointCloud2, "neuse/map_points", LATCHED)
    peer.connect(TrackedFrameMsg, "neuse/frames")
    peer.connect(KeyframeArray, "neuse/keyframes", QoSProfile(depth=100, durability=LATCHED.durability))
    peer.meet()
    return Mapper(peer, maps)


@pytest.fixture(scope="module")
def told() -> Told:
    things = [replace(thing, category=CATEGORY) for thing in five_things()]
    world: World = make_world(things, Diary())
    world.tour(orbit(count=16))
    world.remove("a")
    world.move("b", 0.05, 0.35)
    world.tour(orbit(count=16, start_rad=1.0))
    mapper = world.mapper
    return Told(mapper.fed, list(world.changes), mapper.object_map, mapper.finalize())


@pytest.fixture(scope="module")
def sent(mapped: Mapper, told: Told) -> None:
    """Everything is sent; every third time the frame comes before its keyframes."""
    for index, (frame, keyframes) in enumerate(told.fed):
        mapped.send(frame, keyframes, keyframes_first=index % 3 > 0)
    mapped.wait_for_frames(len(told.fed))


def test_node_gives_the_map_of_the_stage_without_ros(mapped: Mapper, told: Told, sent):
    stamp_ns = told.object_map.stamp_ns
    found = object_map_from_msg(mapped.peer.wait_for_stamp("neuse/map", stamp_ns))
    assert [o.object_id for o in found.objects] == [o.object_id for o in told.object_map.objects]
    for one, other in zip(found.objects, told.object_map.objects, strict=True):
        assert (one.status, one.category, one.n_observations) == (
            other.status,
            CATEGORY,
            other.n_observations,
        )
        np.testing.assert_allclose(one.T_map_object, other.T_map_object, atol=1e-6)
        np.testing.assert_allclose(one.box_size, other.box_size, atol=1e-6)


def test_node_gives_the_changes_of_the_stage_without_ros(mapped: Mapper, told: Told, sent):
    assert ChangeKind.MOVED in {change.kind for change in told.changes}
    heard = mapped.peer.heard["neuse/changes"]
    mapped.peer.wait_for(lambda: len(heard) >= len(told.changes), "all changes")
    found = [conversions.change_from_msg(message) for message in heard]
    assert [(c.stamp_ns, c.kind, c.object_id, c.merged_id) for c in found] == [
        (c.stamp_ns, c.kind, c.object_id, c.merged_id) for c in told.changes
    ]


def test_markers_show_each_object_that_is_there_once(mapped: Mapper, told: Told, sent):
    (markers,) = mapped.peer.heard["neuse/markers"][-1:]
    drawn = [m for m in markers.markers if m.action == Marker.ADD]
    assert len({(m.ns, m.id) for m in drawn}) == len(drawn)
    assert all(m.header.frame_id == "map" for m in drawn)
    assert {m.id for m in drawn if m.type == Marker.TRIANGLE_LIST} <= {
        o.object_id for o in told.object_map.objects
    }
    assert any(m.type == Marker.ARROW for m in drawn)
    assert mapped.peer.heard["neuse/map_points"][-1].width > 0


def test_frame_with_a_pose_that_is_none_is_counted_and_the_next_is_used(
    mapped: Mapper, told: Told, sent, mapper
):
    frame, keyframes = told.fed[-1]
    stamp_ns = frame.stamp_ns + 10**8
    message = conversions.tracked_frame_to_msg(
        replace(frame, stamp_ns=stamp_ns, keyframe_id=NO_ID), "map", "camera"
    )
    message.pose.pose.orientation.w = float("nan")
    mapped.peer.send("neuse/frames", message)
    mapped.send(replace(frame, stamp_ns=stamp_ns + 1, keyframe_id=NO_ID), keyframes)
    mapped.peer.wait_for_count("pose")
    mapped.wait_for_frames(len(told.fed) + 1)
    assert "pose: " in mapper.output


def test_frame_of_wrong_array_length_is_counted_and_the_next_is_used(mapped: Mapper, told: Told, sent):
    frame, keyframes = told.fed[-1]
    bad, good = (replace(frame, stamp_ns=frame.stamp_ns + n * 10**8, keyframe_id=NO_ID) for n in (2, 3))
    message = conversions.tracked_frame_to_msg(bad, "map", "camera")
    message.observations[0].observation.code.z = message.observations[0].observation.code.z[:-1]
    frames = mapped.peer.count("frames")
    mapped.peer.send("neuse/frames", message)
    mapped.send(good, keyframes)
    mapped.peer.wait_for_count("array_length")
    mapped.wait_for_frames(frames + 1)


def test_map_is_saved_forgotten_and_loaded_with_the_same_ids(
    mapped: Mapper, told: Told, sent, tmp_path: Path
):
    path = str(tmp_path / "table.map")
    before = [o.object_id for o in mapped.maps[-1].objects]
    saved = mapped.peer.call(SaveMap, "mapper_node/save_map", SaveMap.Request(path=path))
    assert saved.success, saved.message
    assert Path(path).stat().st_size > 0

    mapped.peer.heard["neuse/markers"].clear()
    reset = mapped.peer.call(Trigger, "mapper_node/reset", Trigger.Request())
    assert reset.success
    markers = mapped.peer.heard["neuse/markers"]
    mapped.peer.wait_for(
        lambda: any([m.action for m in drawing.markers] == [Marker.DELETEALL] for drawing in markers),
        "a clean sheet",
    )
    mapped.peer.wait_for(lambda: not mapped.maps[-1].objects, "an empty map")

    loaded = mapped.peer.call(LoadMap, "mapper_node/load_map", LoadMap.Request(path=path))
    assert loaded.success, loaded.message
    mapped.peer.wait_for(
        lambda: [o.object_id for o in mapped.maps[-1].objects] == before, "the objects again"
    )


@pytest.mark.parametrize("content", [None, b"", b"no map at all"])
def test_map_file_that_is_none_is_refused_and_the_map_is_kept(
    mapped: Mapper, sent, tmp_path: Path, content: bytes | None
):
    path = tmp_path / "broken.map"
    if content is not None:
        path.write_bytes(content)
    failures = mapped.peer.count("service_failed")
    loaded = mapped.peer.call(LoadMap, "mapper_node/load_map", LoadMap.Request(path=str(path)))
    assert not loaded.success
    assert str(path) in loaded.message
    mapped.peer.wait_for_count("service_failed", failures + 1)


def test_map_that_cannot_be_written_is_told(mapped: Mapper, sent, tmp_path: Path):
    path = str(tmp_path / "missing" / "folder" / "table.map")
    (tmp_path / "missing").write_text("a file in the way")
    saved = mapped.peer.call(SaveMap, "mapper_node/save_map", SaveMap.Request(path=path))
    assert not saved.success
    assert saved.message


def test_stamps_that_go_back_start_a_new_map_and_the_end_tells_what_was_held_back(
    mapped: Mapper, told: Told, sent, mapper, save_path: Path
):
    known = {known.object_id for known in mapped.maps[-1].objects}
    frames, heard = mapped.peer.count("frames"), mapped.peer.heard["neuse/changes"]
    heard.clear()
    for frame, keyframes in told.fed:
        mapped.send(frame, keyframes)
    mapped.wait_for_frames(frames + len(told.fed))
    mapped.peer.wait_for_count("time_jump")
    mapper.process.send_signal(signal.SIGINT)
    wanted = [*told.changes, *told.held_back]
    assert ChangeKind.REMOVED in {change.kind for change in told.held_back}
    mapped.peer.wait_for(lambda: len(heard) >= len(wanted), "all changes")
    assert [(m.kind, m.object_id) for m in heard] == [(c.kind, c.object_id) for c in wanted]
    assert mapper.end() == 0
    assert "Traceback" not in mapper.output
    kept = ObjectMapper({})
    kept.load(f"{save_path}.before-reset")
    assert kept.places().keys() == known
    assert f"{len(known)} objects written to {save_path}.before-reset" in mapper.output
