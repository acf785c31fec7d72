from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import trimesh

from neuse.errors import MeshError, ParamError
from neuse.geometry import inverse, transform_points
from neuse.records import ChangeKind, Intrinsics
from neuse.simulation import worlds
from neuse.simulation.changes import change_scene
from neuse.simulation.scene import footprint, gap
from neuse.simulation.sensor import SensorFaults, ideal
from neuse.simulation.worlds import PRESETS, make_world, simulate

SMALL = replace(
    PRESETS["tabletop"], frames=24, intrinsics=Intrinsics(160, 120, 154.0, 154.0, 79.5, 59.5), faults=ideal()
)


@pytest.fixture(scope="module")
def world():
    return make_world(SMALL, seed=3)


@pytest.fixture(scope="module")
def frames(world):
    return list(simulate(world))


def points_of(frame, label, T_world_camera):
    """Measured points of an instance in the world, (n, 3)."""
    k = frame.intrinsics
    v, u = np.nonzero((frame.mask == label) & (frame.depth_m > 0))
    z = frame.depth_m[v, u]
    points_camera = np.stack([(u - k.cx) / k.fx * z, (v - k.cy) / k.fy * z, z], axis=1)
    return transform_points(T_world_camera, points_camera)


def assert_equal(first, second):
    np.testing.assert_array_equal(first.frame.depth_m, second.frame.depth_m)
    np.testing.assert_array_equal(first.frame.mask, second.frame.mask)
    np.testing.assert_array_equal(first.frame.color, second.frame.color)
    np.testing.assert_array_equal(first.odometry.T_odom_camera, second.odometry.T_odom_camera)
    assert first.frame.instances == second.frame.instances
    assert first.visible_px == second.visible_px


def test_unknown_preset_is_refused_with_the_known_ones():
    with pytest.raises(ParamError, match=r"'table-top'.*tabletop, .*synthetic-planar, .*triple-infinity"):
        make_world("table-top", seed=0)


def test_negative_seed_is_refused():
    with pytest.raises(ParamError, match="seed -1"):
        make_world(SMALL, seed=-1)


def test_layout_without_room_for_its_changes_is_drawn_again(monkeypatch):
    unlucky = iter([ParamError("no unchanged object is out of sight")])

    def fails_once(*args):
        for error in unlucky:
            raise error
        return change_scene(*args)

    monkeypatch.setattr(worlds, "change_scene", fails_once)
    assert make_world(SMALL, seed=4).timeline.changes


def test_world_is_the_same_for_the_same_seed(frames):
    for first, second in zip(frames[:3], simulate(make_world(SMALL, seed=3), stop=3), strict=True):
        assert_equal(first, second)


def test_another_seed_gives_another_world(world):
    other = make_world(SMALL, seed=4)
    assert not np.allclose(world.trajectory.T_world_camera, other.trajectory.T_world_camera)
    assert world.timeline.initial[0].shape.name != other.timeline.initial[0].shape.name


def test_frames_do_not_depend_on_where_simulation_starts(world, frames):
    start = world.trajectory.start_of(1) - 1
    for first, second in zip(frames[start : start + 3], simulate(world, start, start + 3), strict=True):
        assert_equal(first, second)


@pytest.mark.parametrize(("start", "stop"), [(-1, 3), (0, 25), (5, 4)])
def test_frames_outside_the_world_are_refused(world, start, stop):
    with pytest.raises(ParamError, match="not inside 0 to 24"):
        simulate(world, start, stop)


def test_stamps_are_a_tenth_of_a_second_apart(frames):
    stamps_ns = [simulated.frame.stamp_ns for simulated in frames]
    assert stamps_ns == [1_000_000_000 + 100_000_000 * i for i in range(24)]
    assert [simulated.odometry.stamp_ns for simulated in frames] == stamps_ns


def test_measured_points_lie_on_the_objects(frames):
    checked = 0
    for simulated in frames[::6]:
        counts = list(simulated.visible_px.values())
        shapes = {px: o for o in simulated.objects if (px := simulated.visible_px.get(o.object_id))}
        for instance in simulated.frame.instances:
            n_pixels = int((simulated.frame.mask == instance.label).sum())
            if counts.count(n_pixels) > 1:
                continue  # the count does not tell which object it is
            true_object = shapes[n_pixels]
            points = points_of(simulated.frame, instance.label, simulated.T_world_camera)
            in_object = transform_points(inverse(true_object.T_world_object), points)
            low, high = true_object.shape.mesh.bounds
            assert np.all(in_object >= low - 1e-3)
            assert np.all(in_object <= high + 1e-3)
            assert instance.category == true_object.shape.category
            checked += 1
    assert checked > 8


def test_instances_are_exactly_the_labels_of_the_mask(frames):
    for simulated in frames:
        labels = [instance.label for instance in simulated.frame.instances]
        assert labels == [label for label in np.unique(simulated.frame.mask) if label > 0]
        assert sorted(simulated.visible_px.values()) == sorted(
            int((simulated.frame.mask == label).sum()) for label in labels
        )


def test_labels_say_nothing_of_identity(frames):
    by_object: dict[int, set[int]] = {}
    for simulated in frames:
        size_of = {int((simulated.frame.mask == i.label).sum()): i.label for i in simulated.frame.instances}
        for object_id, px in simulated.visible_px.items():
            by_object.setdefault(object_id, set()).add(size_of[px])
    assert sum(len(labels) for labels in by_object.values()) > 3 * len(by_object)


def test_missed_masks_have_no_instance_but_stay_in_the_truth(world):
    blind = replace(world, preset=replace(SMALL, faults=SensorFaults(miss_rate=1.0)))
    simulated = next(simulate(blind))
    assert simulated.frame.instances == ()
    assert not simulated.frame.mask.any()
    assert simulated.visible_px


def test_changes_come_with_the_frame_in_which_they_are_first_seen(world, frames):
    at = [index for index, simulated in enumerate(frames) if simulated.changes]
    assert at == [world.trajectory.start_of(1)]
    before, after = ({o.object_id: o for o in frames[i].objects} for i in (at[0] - 1, at[0]))
    for change in frames[at[0]].changes:
        assert change.stamp_ns == frames[at[0]].frame.stamp_ns
        for objects, T_map in ((before, change.T_map_before), (after, change.T_map_after)):
            expected = objects[change.object_id].T_world_object if T_map is not None else None
            assert T_map is expected
            assert (change.object_id in objects) == (T_map is not None)
    assert sorted(change.kind for change in frames[at[0]].changes) == sorted(ChangeKind)


def test_odometry_drifts_from_the_identity(world, frames):
    np.testing.assert_array_equal(frames[0].odometry.T_odom_camera, np.eye(4))
    true = inverse(frames[0].T_world_camera) @ frames[-1].T_world_camera
    assert 0.0 < np.abs(frames[-1].odometry.T_odom_camera - true).max() < 0.3


def test_own_meshes_take_the_place_of_procedural_shapes(tmp_path):
    (tmp_path / "bottle").mkdir()
    trimesh.creation.cylinder(0.03, 0.2).export(tmp_path / "bottle" / "pipe.ply")
    names = {o.shape.category: o.shape.name for o in make_world(SMALL, 0, tmp_path).timeline.initial}
    assert names["bottle"] == "pipe"
    assert names["mug"].startswith("mug_")


def test_tabletop_is_what_the_demo_needs():
    world = make_world("tabletop", seed=0)
    assert world.trajectory.length_m >= 12.0
    assert len(world.tables) == 3
    assert len(world.timeline.initial) == 12
    assert sorted(change.kind for change in world.timeline.changes) == sorted(ChangeKind)


def test_kitchen_has_all_categories_by_turns():
    world = make_world("kitchen", seed=100)
    found = [tracked.shape.category for tracked in world.timeline.initial]
    assert found == ["mug", "bottle", "bowl", "box"] * 3
    assert len(world.timeline.changes) == 3


def test_own_categories_join_those_of_the_preset(tmp_path):
    (tmp_path / "kettle").mkdir()
    (tmp_path / "empty").mkdir()
    trimesh.creation.cylinder(radius=0.05, height=0.12).export(tmp_path / "kettle" / "own.ply")
    world = make_world(SMALL, seed=100, meshes=tmp_path)
    found = [tracked.shape.category for tracked in world.timeline.initial]
    assert found[:6] == ["mug", "bottle", "kettle"] * 2
    assert found.count("kettle") == 4


def test_folder_without_any_mesh_is_refused(tmp_path):
    (tmp_path / "kettle").mkdir()
    with pytest.raises(MeshError, match=r"no meshes below .* expected .*<category>"):
        make_world(SMALL, seed=100, meshes=tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize("name", list(PRESETS))
def test_layout_of_every_preset_is_sound(name):
    world = make_world(name, seed=1)
    planned = world.preset.changes
    kinds = [change.kind for change in world.timeline.changes]
    assert kinds.count(ChangeKind.ADDED) == sum(plan.added for plan in planned)
    assert kinds.count(ChangeKind.REMOVED) == sum(plan.removed for plan in planned)
    assert kinds.count(ChangeKind.MOVED) == sum(plan.moved + 2 * plan.swapped_pairs for plan in planned)
    for frame in {0, *(change.frame for change in world.timeline.changes)}:
        outlines = [footprint(o.shape, o.T_world_object) for o in world.timeline.objects_at(frame)]
        assert all(any(table.holds(outline) for table in world.tables) for outline in outlines)
        assert min(gap(a, b) for i, a in enumerate(outlines) for b in outlines[:i]) >= 0.02
    steps_m = [np.linalg.norm(b[:3, 3] - a[:3, 3]) for a, b in pairwise(world.trajectory.T_world_camera)]
    assert max(steps_m) < 0.16
    lying = sum(o.T_world_object[2, 2] < 0.9 for o in world.timeline.initial)
    assert 0.3 <= lying / 50 <= 0.7 if name == "synthetic-nonplanar" else lying == 0
