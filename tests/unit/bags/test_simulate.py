"""Simulated bags: a few frames of a made-up world around a change, with all their ground truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from neuse.evaluation.simulated_truth import CLEARLY_SEEN_M, CLEARLY_SEEN_PX
from neuse.geometry import exp, make_transform
from neuse.records import ChangeKind, ObjectChange, OdometrySample, RgbdFrame
from neuse.simulation.shapes import make_shape
from neuse.simulation.worlds import SimulatedFrame, TrueObject
from neuse_bags import topics
from neuse_bags.frames import read_frames, read_odometry
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.recording import read_truth
from neuse_bags.simulate import TruthWriter, main

HERE, THERE = make_transform(np.eye(3), [0, 0, 0.8]), make_transform(np.eye(3), [1, 0, 0.8])
SHAPE = make_shape("box", "mug", trimesh.creation.box((0.1, 0.08, 0.12)))
STAYS, GOES = TrueObject(1, SHAPE, HERE), TrueObject(2, SHAPE, HERE)
MOVED = replace(GOES, T_world_object=THERE)


@pytest.fixture
def simulated(frames: list[RgbdFrame]) -> list[SimulatedFrame]:
    """Five frames; before the third, object 2 moves and the second traversal begins."""
    return [_simulated(index, frame) for index, frame in enumerate(frames)]


def _simulated(index: int, frame: RgbdFrame) -> SimulatedFrame:
    change = ObjectChange(frame.stamp_ns, ChangeKind.MOVED, 2, "mug", HERE, THERE)
    return SimulatedFrame(
        frame=frame,
        T_world_camera=exp(np.full(6, 0.1 * index)),
        odometry=OdometrySample(frame.stamp_ns, np.eye(4)),
        objects=(STAYS, GOES if index < 2 else MOVED),
        visible_px={1: CLEARLY_SEEN_PX, 2: CLEARLY_SEEN_PX - (index == 4)},
        changes=(change,) if index == 2 else (),
        traversal=int(index >= 2),
    )


@pytest.fixture
def truth_bag(simulated: list[SimulatedFrame], tmp_path: Path) -> Path:
    path = tmp_path / "truth.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, topics.TRUTH_TOPICS)
        truth = TruthWriter(writer)
        for one in simulated:
            truth.add(one)
        truth.finish()
    return path


def test_true_path_changes_and_traversals_are_read_back(
    truth_bag: Path, simulated: list[SimulatedFrame]
) -> None:
    truth = read_truth(truth_bag)
    assert truth is not None
    np.testing.assert_allclose(
        truth.trajectory.T_frame_camera, [one.T_world_camera for one in simulated], atol=1e-12
    )
    assert truth.traversal_starts_ns == (simulated[0].frame.stamp_ns, simulated[2].frame.stamp_ns)
    (change,) = truth.changes
    assert (change.kind, change.object_id, change.stamp_ns) == (
        ChangeKind.MOVED,
        2,
        simulated[2].frame.stamp_ns,
    )
    np.testing.assert_allclose(change.T_map_after, THERE, atol=1e-12)


def test_map_is_there_at_the_start_after_the_change_and_at_the_end(truth_bag: Path) -> None:
    truth = read_truth(truth_bag)
    assert truth is not None
    places = [[item.T_world_object[0, 3] for item in one.objects] for one in truth.maps]
    assert places == [[0, 0], [0, 1], [0, 1]]
    np.testing.assert_allclose(truth.maps[0].objects[0].box_size, [0.1, 0.08, 0.12], atol=1e-12)


def test_sightings_count_clear_views_at_the_present_place_alone(truth_bag: Path) -> None:
    truth = read_truth(truth_bag)
    assert truth is not None
    assert [[item.n_seen for item in one.objects] for one in truth.maps] == [[0, 0], [2, 0], [5, 2]]


@pytest.mark.parametrize(("beyond_m", "n_seen"), [(-0.1, 5), (0.1, 0)])
def test_far_objects_are_not_clearly_seen(simulated, tmp_path: Path, beyond_m: float, n_seen: int) -> None:
    far = make_transform(np.eye(3), [CLEARLY_SEEN_M + beyond_m, 0, 0])
    path = tmp_path / "far.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, topics.TRUTH_TOPICS)
        truth = TruthWriter(writer)
        for one in simulated:
            item = TrueObject(1, SHAPE, one.T_world_camera @ far)
            truth.add(replace(one, objects=(item,), changes=()))
        truth.finish()
    read = read_truth(path)
    assert read is not None
    assert read.final_objects()[0].n_seen == n_seen


def test_bag_without_true_poses_has_no_truth(frames_bag: Path) -> None:
    assert read_truth(frames_bag) is None


@pytest.mark.slow
def test_command_writes_a_bag_of_frames_odometry_and_truth(tmp_path: Path, capsys) -> None:
    out = tmp_path / "tabletop.mcap"
    assert main(["tabletop", "--seed", "3", "--frames", "2", "--out", str(out)]) == 0
    with BagReader(out) as bag:
        frames = list(read_frames(bag, pytest.fail))
        assert len(frames) == 2
        assert read_odometry(bag, pytest.fail).at(0) is not None
        assert bag.topics["/color/image"].n_messages == 2
    assert f"{out}: 2 frames" in capsys.readouterr().out
    truth = read_truth(out)
    assert truth is not None
    assert len(truth.final_objects()) == 12


@pytest.mark.slow
def test_cameras_have_topics_and_ways_of_their_own_in_one_world(tmp_path: Path, capsys) -> None:
    out = tmp_path / "two.mcap"
    assert main(["tabletop", "--seed", "103", "--frames", "2", "--cameras", "2", "--out", str(out)]) == 0
    with BagReader(out) as bag:
        assert topics.namespaces_in(bag) == ("/a", "/b")
        counts = {name: topic.n_messages for name, topic in bag.topics.items()}
        starts = [next(bag.messages([f"{name}/ground_truth/odometry"])).decode() for name in ("/a", "/b")]
    own = (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY, topics.TRUE_ODOMETRY)
    assert {counts[topic.under(name).name] for topic in own for name in ("/a", "/b")} == {2}
    assert counts["/ground_truth/map"] == 2  # at the start and at the end
    assert starts[0].pose.pose.position != starts[1].pose.pose.position
    assert "4 frames" in capsys.readouterr().out


@pytest.mark.parametrize("count", ["0", "27"])
def test_number_of_cameras_must_have_letters(tmp_path: Path, capsys, count: str) -> None:
    assert main(["tabletop", "--cameras", count, "--out", str(tmp_path / "a.mcap")]) == 2
    assert f"{count} cameras; choose 1 to 26" in capsys.readouterr().err


def test_sightings_of_all_cameras_count(simulated: list[SimulatedFrame], tmp_path: Path) -> None:
    path = tmp_path / "two.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.TRUTH_TOPICS, topics.TRUE_ODOMETRY.under("/b")))
        truth = TruthWriter(writer, ("", "/b"))
        for one in simulated:
            truth.add(one, one)
        truth.finish()
    read = read_truth(path)
    assert read is not None
    assert [item.n_seen for item in read.final_objects()] == [10, 4]


def test_unknown_preset_is_told_in_one_line(tmp_path: Path, capsys) -> None:
    assert main(["nowhere", "--out", str(tmp_path / "a.mcap")]) == 2
    errors = capsys.readouterr().err.strip().splitlines()
    assert len(errors) == 1
    assert "unknown preset 'nowhere'; known: tabletop" in errors[0]
    assert not (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("count", ["0", "-3"])
def test_number_of_frames_must_be_positive(tmp_path: Path, capsys, count: str) -> None:
    assert main(["tabletop", "--frames", count, "--out", str(tmp_path / "a.mcap")]) == 2
    assert "--frames" in capsys.readouterr().err


def test_mesh_that_bounds_nothing_is_told_in_one_line(tmp_path: Path, capsys) -> None:
    (tmp_path / "mug").mkdir()
    (tmp_path / "mug" / "open.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n")
    assert main(["tabletop", "--meshes", str(tmp_path), "--out", str(tmp_path / "a.mcap")]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "open.obj is not closed: a surface of [0.1 0.1 0. ] m is flat and bounds no solid" in line
