"""The in-process pipeline over a bag, recorded and read back for the evaluation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from neuse.embedding.code import Code
from neuse.errors import BagError, InputError
from neuse.geometry import exp, make_transform
from neuse.pipeline import PipelineResult
from neuse.records import (
    NO_ID,
    ChangeKind,
    Edge,
    EdgeKind,
    Keyframe,
    MapObject,
    MatchStatus,
    ObjectChange,
    ObjectMap,
    ObjectStatus,
    Observation,
    ObservedFrame,
    OdometrySample,
    Rejection,
    RgbdFrame,
    TrackedFrame,
    TrackedObservation,
)
from neuse_bags import topics
from neuse_bags.evaluate import main as evaluate
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.recording import read_estimate
from neuse_bags.run import _summary, main, run_pipeline
from neuse_bags.views import read_observed

CODE = Code("mug", False, np.arange(24.0).reshape(8, 3), np.full(8, 8**-0.5), np.full(6, 0.1))
SIXTH = exp([0.1, 0.2, 0.3, 1.0, 2.0, 3.0])
COVARIANCE = np.diag([1e-4, 2e-4, 3e-4, 4e-4, 5e-4, 6e-4])


class MadeUpPipeline:
    """Answers every frame with known results; its own `slam` and `mapper`."""

    def __init__(self) -> None:
        self.slam = self.mapper = self
        self.made: list[Keyframe] = []
        self.times_read = 0
        self.odometry: list[OdometrySample | None] = []
        self.changes: tuple[ObjectChange, ...] = ()
        self.object_map = ObjectMap(0)

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        self.times_read += 1
        return tuple(self.made)

    def step(self, frame: RgbdFrame, odometry: OdometrySample | None) -> PipelineResult:
        number = len(self.odometry)
        self.odometry.append(odometry)
        if number == 1:
            raise InputError("made_up", "this frame is refused")
        if number != 3:
            self.made.append(Keyframe(number, frame.stamp_ns, exp(np.full(6, 0.05 * number))))
        self.object_map = ObjectMap(frame.stamp_ns, (_map_object(frame.stamp_ns),))
        tracked = _tracked(frame, number, self.made[-1].T_map_camera)
        change = ObjectChange(frame.stamp_ns, ChangeKind.ADDED, 4, "mug", None, SIXTH)
        return PipelineResult(
            ObservedFrame(frame.stamp_ns, (_observation(),), frame.intrinsics, frame.depth_m[::4, ::4]),
            tracked,
            (change,) if number == 2 else (),
            {"encode": 10.0 + number, "encode_per_object": 5.0, "slam": 2.0, "map": 1.0},
        )

    def finalize(self) -> tuple[ObjectChange, ...]:
        return (
            ObjectChange(self.object_map.stamp_ns, ChangeKind.MOVED, 1, "mug", SIXTH, np.eye(4), merged_id=4),
        )

    def mesh(self, object_id: int) -> None:
        raise InputError("unknown_object", "no shapes here")


def _observation() -> Observation:
    return Observation(7, 0.9, CODE, np.ones((4, 3), np.float32), np.zeros(3), 42)


def _map_object(stamp_ns: int) -> MapObject:
    center = SIXTH[:3, 3]
    return MapObject(4, "mug", ObjectStatus.ADDED, SIXTH, center, np.full(3, 0.1), CODE, 1, stamp_ns, 3)


def _tracked(frame: RgbdFrame, number: int, T_map_camera: np.ndarray) -> TrackedFrame:
    edge = Edge(number - 1, number, 1, frame.stamp_ns, EdgeKind.SHORT_RANGE, SIXTH, COVARIANCE, (4,), 0.002)
    return TrackedFrame(
        stamp_ns=frame.stamp_ns,
        T_map_camera=T_map_camera @ make_transform(np.eye(3), [0.01, 0, 0]),
        covariance=COVARIANCE,
        observations=(TrackedObservation(_observation(), MatchStatus.MATCHED, 4),),
        intrinsics=frame.intrinsics,
        coarse_depth_m=frame.depth_m[::4, ::4],
        keyframe_id=NO_ID if number == 3 else number,
        odometry_only=number == 3,
        edges=(edge,) if number else (),
        rejected_edges=number,
    )


@pytest.fixture
def ran(
    frames_bag: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Path, MadeUpPipeline, dict]:
    monkeypatch.setattr("neuse_bags.run_recorder.scene_markers", lambda *_: [])
    monkeypatch.setattr("neuse_bags.run_recorder.map_points", lambda *_: (np.zeros((0, 3)), np.zeros((0, 3))))
    pipeline, path = MadeUpPipeline(), tmp_path / "recording.mcap"
    with BagReader(frames_bag) as bag, BagWriter(path) as writer:
        faults = run_pipeline(bag, writer, pipeline)
    return path, pipeline, dict(faults)


def test_every_frame_meets_its_own_odometry(ran, frames: list[RgbdFrame]) -> None:
    _, pipeline, _ = ran
    assert [sample.stamp_ns for sample in pipeline.odometry] == [frame.stamp_ns for frame in frames]


def test_refused_frame_is_counted_and_the_run_goes_on(ran) -> None:
    path, _, faults = ran
    assert faults == {"made_up": 1}
    assert len(read_estimate(path).frames) == 4


def test_recording_has_every_topic_of_the_nodes(ran) -> None:
    with BagReader(ran[0]) as bag:
        counts = {name: topic.n_messages for name, topic in bag.topics.items()}
    assert set(counts) == {topic.name for topic in topics.OUTPUT_TOPICS}
    assert min(counts.values()) > 0


def test_estimate_is_what_the_pipeline_gave(ran, frames: list[RgbdFrame]) -> None:
    path, pipeline, _ = ran
    estimate = read_estimate(path)
    assert [frame.stamp_ns for frame in estimate.frames] == [f.stamp_ns for f in (frames[0], *frames[2:])]
    assert [frame.blind for frame in estimate.frames] == [False, False, True, False]
    assert estimate.rejected_edges == 2 + 3 + 4
    for found, keyframe in zip(estimate.keyframes, pipeline.made, strict=True):
        np.testing.assert_allclose(found.T_map_camera, keyframe.T_map_camera, atol=1e-12)
    assert [edge.to_id for edge in estimate.edges] == [2, 3, 4]
    np.testing.assert_allclose(estimate.edges[0].T_from_to, SIXTH, atol=1e-12)
    np.testing.assert_allclose(estimate.edges[0].covariance, COVARIANCE, atol=1e-15)


def test_keyframes_are_read_and_recorded_only_where_they_may_have_moved(ran) -> None:
    path, pipeline, _ = ran
    with BagReader(path) as bag:
        n_keyframes, n_paths = (bag.topics[t.name].n_messages for t in (topics.KEYFRAMES, topics.PATH))
    assert n_keyframes == len(pipeline.made) == 3
    assert pipeline.times_read == n_keyframes + n_paths


def test_reports_that_a_later_move_supersedes_are_not_counted(ran) -> None:
    (move,) = read_estimate(ran[0]).changes
    assert (move.kind, move.object_id, move.merged_id) == (ChangeKind.MOVED, 1, 4)


def test_final_map_comes_last_and_stamps_of_maps_increase(ran, frames: list[RgbdFrame]) -> None:
    maps = read_estimate(ran[0]).maps
    assert [m.stamp_ns for m in maps] == [frames[0].stamp_ns, frames[2].stamp_ns, frames[4].stamp_ns]
    np.testing.assert_allclose(maps[-1].objects[0].code.z, CODE.z)


def test_stage_times_are_means_over_the_frames(ran) -> None:
    stage_ms = read_estimate(ran[0]).stage_ms
    assert stage_ms["encode"] == pytest.approx(np.mean([10, 12, 13, 14]), abs=1e-3)
    assert stage_ms["encode_per_object"] == pytest.approx(5.0, abs=1e-3)


def test_bag_that_is_no_recording_is_refused(frames_bag: Path, tmp_path: Path) -> None:
    with pytest.raises(BagError, match="lacks /neuse/frames"):
        read_estimate(frames_bag)
    with BagWriter(tmp_path / "empty.mcap") as writer:
        topics.declare(writer, topics.OUTPUT_TOPICS)
    with pytest.raises(BagError, match="did the run see any frame"):
        read_estimate(tmp_path / "empty.mcap")


def test_two_runs_record_the_same(ran, frames_bag: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.mcap"
    with BagReader(frames_bag) as bag, BagWriter(again) as writer:
        run_pipeline(bag, writer, MadeUpPipeline())
    timeless = [topic.name for topic in topics.OUTPUT_TOPICS if topic is not topics.DIAGNOSTICS]
    with BagReader(ran[0]) as first, BagReader(again) as second:
        for a, b in zip(first.messages(timeless), second.messages(timeless), strict=True):
            assert (a.topic, a.stamp_ns, a.decode()) == (b.topic, b.stamp_ns, b.decode())


BROKEN = {
    "truncated": (lambda bag: bag[:-200], "truncated"),
    "foreign": (lambda bag: b"hello", "not a ROS 2 bag"),
    "empty": (lambda bag: b"", "not a ROS 2 bag"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_bag_that_cannot_be_read_is_told_in_one_line(
    frames_bag: Path, tmp_path: Path, capsys, name: str
) -> None:
    spoil, complaint = BROKEN[name]
    path = tmp_path / "a bag with spaces.mcap"
    path.write_bytes(spoil(frames_bag.read_bytes()))
    assert main([str(path), "--out", str(tmp_path / "out")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert str(path) in line
    assert complaint in line


def test_bag_with_only_some_topics_is_told_and_nothing_is_written(tmp_path: Path, capsys) -> None:
    with BagWriter(tmp_path / "some.mcap") as writer:
        topics.declare(writer, (topics.DEPTH, topics.ODOMETRY))
    assert main([str(tmp_path / "some.mcap"), "--out", str(tmp_path / "out")]) == 2
    assert "lacks /depth/camera_info, /segmentation/instances, /segmentation/mask" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bag_without_a_whole_frame_is_told(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "hollow.mcap") as writer:
        topics.declare(writer, topics.FRAME_TOPICS)
    with (
        BagReader(tmp_path / "hollow.mcap") as bag,
        BagWriter(tmp_path / "recording.mcap") as writer,
        pytest.raises(BagError, match="has no frame of depth, mask"),
    ):
        run_pipeline(bag, writer, MadeUpPipeline())


def test_categories_of_ones_own_are_encoded_and_drawn_with_their_weights(
    frames: list[RgbdFrame], kettle_weights: Path, tmp_path: Path, capsys
) -> None:
    bag, out = tmp_path / "kettles.mcap", tmp_path / "out"
    with BagWriter(bag) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        for frame in frames:
            kettles = tuple(replace(instance, category="kettle") for instance in frame.instances)
            write_frame(writer, replace(frame, depth_m=np.full_like(frame.depth_m, 0.6), instances=kettles))
    assert main([str(bag), "--out", str(out), "--weights", str(kettle_weights)]) == 0
    observed = read_observed(out / "recording.mcap")
    assert [[o.code.category for o in frame.observations] for frame in observed] == [["kettle"] * 2] * 5
    assert "drawn as boxes" not in capsys.readouterr().out
    assert evaluate([str(out / "recording.mcap"), "--truth", str(bag), "--out", str(out / "again")]) == 0
    assert "category kettle are drawn as boxes; --weights" in capsys.readouterr().out


def test_weights_that_cannot_be_read_are_told_before_anything_is_written(
    frames_bag: Path, tmp_path: Path, capsys
) -> None:
    weights = ["--weights", str(tmp_path / "kettle.safetensors")]
    assert main([str(frames_bag), "--out", str(tmp_path / "out"), *weights]) == 2
    assert "kettle.safetensors" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_bag_is_not_overwritten_by_its_own_run(frames_bag: Path, capsys) -> None:
    bag = frames_bag.rename(frames_bag.with_name("recording.mcap"))
    before = bag.read_bytes()
    assert main([str(bag), "--out", str(bag.parent)]) == 2
    assert "choose another --out" in capsys.readouterr().err
    assert bag.read_bytes() == before


class RejectingPipeline(MadeUpPipeline):
    """Finds every instance without points, and maps nothing."""

    def step(self, frame: RgbdFrame, odometry: OdometrySample | None) -> PipelineResult:
        result = super().step(frame, odometry)
        self.object_map = ObjectMap(frame.stamp_ns)
        refused = (Rejection("too_few_points", "instance 7 (mug): 0 of 42 px have a usable depth"),) * 2
        return replace(result, observed=replace(result.observed, rejections=refused))


def test_refused_instances_are_counted_by_reason(frames_bag: Path, tmp_path: Path, capsys) -> None:
    with BagReader(frames_bag) as bag, BagWriter(tmp_path / "recording.mcap") as writer:
        faults = run_pipeline(bag, writer, RejectingPipeline())
    assert faults == {"too_few_points": 8, "made_up": 1}
    assert "run: too_few_points: instance 7 (mug): 0 of 42" in capsys.readouterr().err


def test_map_without_objects_is_told_with_the_most_frequent_reason() -> None:
    told, why = _summary({"made_up": 1, "too_few_points": 8}, 0)
    assert told == "not used: 8 x too_few_points, 1 x made_up"
    assert why.startswith("no object was mapped; most frequent fault: too_few_points")
    assert list(_summary({}, 3)) == []
    assert next(iter(_summary({}, 0))).startswith("no object was mapped; too few frames")
