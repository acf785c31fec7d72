"""The scene over a stand-in for Rerun that keeps what is logged; with Rerun itself where it is installed."""

import importlib
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from nodes import samples
from visualization_msgs.msg import MarkerArray

from neuse.errors import NeuseError
from neuse.geometry import exp
from neuse.mapping.markers import CLEAN_SHEET, Marker, MarkerKind
from neuse.records import ChangeKind, EdgeKind, Keyframe, ObjectChange, ObjectMap, RgbdFrame
from neuse_bags import topics, view
from neuse_bags.mcap_file import BagWriter
from neuse_mapper_node.conversions import markers_to_msg, object_map_to_msg
from neuse_slam_node.conversions import change_to_msg, keyframes_to_msg, tracked_frame_to_msg

STAMP_NS = samples.STAMP_NS


class Component:
    """Any component of Rerun: keeps its arguments."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        self.args = args
        vars(self).update(kwargs)

    def compress(self, jpeg_quality: int) -> "Component":
        return self


class Stream:
    """A recording that keeps what is logged, by entity, as (stamp, component)."""

    def __init__(self, *args: Any) -> None:
        self.logged: dict[str, list[tuple[int, Any]]] = {}
        self.stamp_ns = 0

    def set_time(self, timeline: str, timestamp: np.datetime64) -> None:
        self.stamp_ns = int(timestamp.astype(np.int64))

    def log(self, entity: str, component: Any, static: bool) -> None:
        self.logged.setdefault(entity, []).append((self.stamp_ns, component))

    def only(self, entity: str) -> Any:
        ((_, component),) = self.logged[entity]
        return component


class StandIn(ModuleType):
    """The module: every name that is asked for is a component of its own kind."""

    RecordingStream = Stream
    ViewCoordinates = SimpleNamespace(RDF=None)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        setattr(self, name, type(name, (Component,), {}))
        return getattr(self, name)


@pytest.fixture
def scene(monkeypatch: pytest.MonkeyPatch) -> Any:
    stand_in, layout = StandIn("rerun"), StandIn("rerun.blueprint")
    monkeypatch.setitem(sys.modules, "rerun", stand_in)
    monkeypatch.setitem(sys.modules, "rerun.blueprint", layout)
    stand_in.blueprint = layout  # as `import rerun.blueprint as rrb` looks it up
    monkeypatch.delitem(sys.modules, "neuse_bags.rerun_scene", raising=False)
    module = importlib.import_module("neuse_bags.rerun_scene")
    del sys.modules[module.__name__]
    return module.RerunScene(Stream())


def drawn(scene: Any, path: Path, *messages: tuple[topics.TopicSpec, Any]) -> Stream:
    """What a scene logs of a bag of some messages."""
    with BagWriter(path) as writer:
        topics.declare(writer, tuple({spec.name: spec for spec, _ in messages}.values()))
        for spec, message in messages:
            writer.write(spec.name, message, 1)
    view.draw_bags(scene, [path])
    return scene._recording


def test_images_of_a_bag_hang_below_the_camera(scene: Any, frames_bag: Path, frames: list[RgbdFrame]) -> None:
    counts = view.draw_bags(scene, [frames_bag])
    logged = scene._recording.logged
    assert counts[topics.DEPTH.name] == len(frames)
    assert [stamp for stamp, _ in logged["map/camera/image/depth"]] == [frame.stamp_ns for frame in frames]
    depth, color, pinhole = (logged[f"map/camera/image{name}"][0][1] for name in ("/depth", "/color", ""))
    depth_mm = cv2.imdecode(np.frombuffer(depth.args[0], np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_allclose(depth_mm / depth.meter, frames[0].depth_m, atol=1e-3)
    np.testing.assert_array_equal(color.args[0], frames[0].color)
    assert pinhole.image_from_camera[1, 1] == frames[0].intrinsics.fy


def test_mask_has_a_colour_for_each_label_and_none_for_the_background(
    scene: Any, frames_bag: Path, frames: list[RgbdFrame]
) -> None:
    view.draw_bags(scene, [frames_bag])
    mask = scene._recording.logged["map/camera/image/mask"][0][1]
    bgra = cv2.imdecode(np.frombuffer(mask.contents, np.uint8), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(bgra[..., 3] > 0, frames[0].mask > 0)
    assert len({tuple(bgra[frames[0].mask == label][0]) for label in (7, 200)}) == 2


def test_camera_moves_and_its_codes_move_along(scene: Any, tmp_path: Path) -> None:
    frame = samples.tracked_frame()
    message = tracked_frame_to_msg(frame, "map", "camera")
    stream = drawn(scene, tmp_path / "b.mcap", (topics.FRAMES, message))
    pose = stream.only("map/camera")
    np.testing.assert_allclose(pose.translation, frame.T_map_camera[:3, 3])
    np.testing.assert_allclose(pose.mat3x3, frame.T_map_camera[:3, :3], atol=1e-12)
    landmarks = [item.observation.code.landmarks for item in frame.observations]
    np.testing.assert_allclose(stream.only("map/camera/codes").args[0], np.concatenate(landmarks))


def test_edges_are_drawn_between_keyframes_where_they_are_now(scene: Any, tmp_path: Path) -> None:
    (edge, *_) = samples.tracked_frame().edges
    edge = replace(edge, from_id=1, to_id=2, kind=EdgeKind.LOOP_CLOSURE)
    frame = tracked_frame_to_msg(replace(samples.tracked_frame(), edges=(edge,)), "map", "camera")
    keyframes = [Keyframe(index, STAMP_NS, exp([0, 0, 0, index, 0, 0])) for index in (1, 2)]
    message = keyframes_to_msg(keyframes, STAMP_NS, "map")
    stream = drawn(scene, tmp_path / "b.mcap", (topics.FRAMES, frame), (topics.KEYFRAMES, message))
    (strip,) = stream.only("map/graph/loop_closure").args[0]
    np.testing.assert_allclose(strip, [[1, 0, 0], [2, 0, 0]])
    assert "map/graph/odometry" not in stream.logged


def test_objects_are_boxes_with_names(scene: Any, tmp_path: Path) -> None:
    known = samples.object_map().objects[0]
    message = object_map_to_msg(ObjectMap(STAMP_NS, (known,)), "map")
    boxes = drawn(scene, tmp_path / "b.mcap", (topics.MAP, message)).only("map/boxes")
    np.testing.assert_allclose(boxes.centers, [known.box_center])
    assert boxes.labels[0].startswith(f"{known.category} {known.object_id}")


def _mesh(height_m: float) -> Marker:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, height_m], [1, 0, 0], [0, 1, 0]])
    return Marker("objects", 7, MarkerKind.MESH, corners, (1.0, 0.5, 0.0, 1.0))


def test_meshes_are_drawn_once_and_cleared_when_they_go(scene: Any, tmp_path: Path) -> None:
    boards = [[CLEAN_SHEET, *meshes] for meshes in ([_mesh(1)], [_mesh(1)], [_mesh(2)], [], [_mesh(2)], [])]
    messages = [(topics.MARKERS, markers_to_msg(board, STAMP_NS, "map")) for board in boards]
    stream = drawn(scene, tmp_path / "b.mcap", *messages, (topics.MARKERS, MarkerArray()))
    kinds = [type(component).__name__ for _, component in stream.logged["map/objects/7"]]
    assert kinds == ["Mesh3D", "Mesh3D", "Clear", "Mesh3D", "Clear"]
    mesh = stream.logged["map/objects/7"][0][1]
    assert len(mesh.vertex_positions) == 4  # corners at one place are one vertex


def test_changes_are_told_and_moves_are_arrows(scene: Any, tmp_path: Path) -> None:
    before, after = exp([0, 0, 0, 1, 0, 0]), exp([0, 0, 1, 1, 2, 0])
    moved = ObjectChange(STAMP_NS, ChangeKind.MOVED, 7, "mug", before, after)
    added = ObjectChange(STAMP_NS, ChangeKind.ADDED, 8, "bottle", None, after)
    messages = [(topics.CHANGES, change_to_msg(change, "map")) for change in (moved, added)]
    stream = drawn(scene, tmp_path / "b.mcap", *messages)
    assert [text.args[0] for _, text in stream.logged["changes"]] == ["mug 7 moved", "bottle 8 added"]
    np.testing.assert_allclose(stream.only("map/changes/7").vectors, [(after - before)[:3, 3]])


def test_message_that_cannot_be_used_is_told_and_the_others_are_drawn(
    scene: Any, tmp_path: Path, capsys
) -> None:
    bad = tracked_frame_to_msg(samples.tracked_frame(), "map", "camera")
    bad.pose.pose.orientation.w = 9.0
    good = tracked_frame_to_msg(samples.tracked_frame(), "map", "camera")
    stream = drawn(scene, tmp_path / "b.mcap", (topics.FRAMES, bad), (topics.FRAMES, good))
    assert len(stream.logged["map/camera"]) == 1
    assert "view: /neuse/frames: " in capsys.readouterr().err


def test_without_rerun_the_way_to_get_it_is_told(
    frames_bag: Path, monkeypatch: pytest.MonkeyPatch, capsys
) -> None:
    monkeypatch.setitem(sys.modules, "rerun", None)
    monkeypatch.delitem(sys.modules, "neuse_bags.rerun_scene", raising=False)
    assert view.main([str(frames_bag)]) == 2
    assert "rerun-sdk is not installed; get it: pip install '.[view]'" in capsys.readouterr().err


def test_file_of_another_name_is_refused(frames_bag: Path, capsys) -> None:
    assert view.main([str(frames_bag), "--out", "scene.mcap"]) == 2
    assert "ends in .rrd; rename it" in capsys.readouterr().err


def test_bag_becomes_a_file_of_rerun(frames_bag: Path, tmp_path: Path, capsys) -> None:
    pytest.importorskip("rerun")
    out = tmp_path / "scenes" / "frames.rrd"
    assert view.main([str(frames_bag), "--out", str(out)]) == 0
    assert "20 messages of 4 topics" in capsys.readouterr().out
    assert out.read_bytes()[:4] == b"RRF2"


def test_bag_without_anything_to_look_at_is_refused(tmp_path: Path, capsys) -> None:
    pytest.importorskip("rerun")
    with BagWriter(tmp_path / "b.mcap") as writer:
        topics.declare(writer, (topics.ODOMETRY,))
    assert view.main([str(tmp_path / "b.mcap"), "--out", str(tmp_path / "x.rrd")]) == 2
    assert "has nothing to look at" in capsys.readouterr().err


def test_viewer_that_cannot_be_started_is_told_with_a_way_out() -> None:
    class Unseen:
        def spawn(self, default_blueprint: object) -> None:
            raise RuntimeError("no viewer here\nmore")

    rerun = SimpleNamespace(RecordingStream=lambda name: Unseen())
    scenes = SimpleNamespace(rr=rerun, blueprint=lambda: None)
    with pytest.raises(
        NeuseError, match=r"cannot be started: no viewer here; write a file instead: --out X\.rrd"
    ):
        view._open(scenes, None)
