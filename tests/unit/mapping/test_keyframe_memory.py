from dataclasses import replace

import numpy as np

from neuse import geometry
from neuse.geometry import make_transform
from neuse.mapping.keyframe_memory import KeyframeMemory
from neuse.records import NO_ID, Keyframe, TrackedFrame

from .synthetic import CAMERA, COARSE


def frame(keyframe_id, x=0.0, depth=None):
    depth = np.full(COARSE, 1.2345, dtype=np.float32) if depth is None else depth
    T_map_camera = make_transform(np.eye(3), [x, 0.0, 0.0])
    return TrackedFrame(0, T_map_camera, np.eye(6), (), CAMERA, depth, keyframe_id)


def test_frames_that_are_no_keyframes_are_tied_to_the_latest_one():
    memory = KeyframeMemory(10)
    memory.update(frame(0, x=1.0), (), 1)
    keyframe_id, T_keyframe_camera = memory.reference(frame(NO_ID, x=1.5))
    assert keyframe_id == 0
    np.testing.assert_allclose(T_keyframe_camera[:3, 3], [0.5, 0.0, 0.0])


def test_without_any_keyframe_views_are_tied_to_the_map():
    keyframe_id, T_map_camera = KeyframeMemory(10).reference(frame(NO_ID, x=1.5))
    assert keyframe_id == NO_ID
    np.testing.assert_allclose(T_map_camera[:3, 3], [1.5, 0.0, 0.0])


def test_latest_estimates_replace_poses_and_name_what_moved():
    memory = KeyframeMemory(10)
    memory.update(frame(0), (), 1)
    memory.update(frame(1), (), 2)
    T_new = geometry.exp([0.1, 0, 0, 0.2, 0, 0])
    moved = memory.update(frame(NO_ID), [Keyframe(0, 0, T_new), Keyframe(1, 0, np.eye(4))], 3)
    assert moved == {0}
    np.testing.assert_array_equal(memory.poses[0], T_new)


def test_depth_is_kept_in_millimetres_and_non_readings_as_zero():
    memory = KeyframeMemory(10)
    depth = np.full(COARSE, 1.2345, dtype=np.float32)
    depth[0, :4] = np.nan, np.inf, -1.0, 100.0
    memory.update(frame(0, depth=depth), (), 1)
    stored = memory.seen[0].coarse_depth_m
    np.testing.assert_allclose(stored[0, :3], 0.0)
    np.testing.assert_allclose(stored[0, 3], 65.535)
    np.testing.assert_allclose(stored[1:], 1.2345, atol=1e-3)


def test_depth_is_thinned_out_evenly_at_the_limit():
    memory = KeyframeMemory(8)
    for i in range(100):
        memory.update(frame(i), (), i)
        kept = [k.keyframe_id for k in memory.seen.values() if k.depth_mm is not None]
        assert len(kept) <= 8
        assert kept[-1] == i
    assert kept[0] == 0
    assert max(np.diff(kept)) <= 30
    assert len(memory.poses) == 101


def test_nearest_views_are_in_view_in_range_of_the_steps_and_sorted():
    memory = KeyframeMemory(10)
    place = np.array([0.0, 0.0, 2.0])
    for i, z in enumerate([0.0, 1.0, 3.0, -5.0, 0.5]):
        T = make_transform(np.eye(3), [0.0, 0.0, z])
        memory.update(TrackedFrame(0, T, np.eye(6), (), CAMERA, np.ones(COARSE, np.float32), i), (), 10 + i)
    found = memory.nearest_views(place, range(10, 20), 3.0, 10)
    assert [k.keyframe_id for k in found] == [1, 4, 0]
    assert [k.keyframe_id for k in memory.nearest_views(place, range(10, 14), 3.0, 1)] == [1]
    assert memory.nearest_views(place, range(0, 10), 3.0, 10) == []


def test_each_view_is_judged_by_its_own_camera():
    memory, tele = KeyframeMemory(10), replace(CAMERA, fx=10 * CAMERA.fx, fy=10 * CAMERA.fy)
    place = np.array([0.3, 0.0, 2.0])
    for i, intrinsics in enumerate([CAMERA, tele, CAMERA, tele]):
        view = TrackedFrame(0, np.eye(4), np.eye(6), (), intrinsics, np.ones(COARSE, np.float32), i)
        memory.update(view, (), i)
    assert [k.keyframe_id for k in memory.nearest_views(place, range(10), 3.0, 10)] == [0, 2]


def test_camera_that_was_blind_for_long_has_lost_sight_and_so_it_has_at_its_start():
    memory = KeyframeMemory(10)
    for tick in range(1, 41):
        memory.update(replace(frame(NO_ID), odometry_only=tick in (10, 20, 21, 22, 23, 24)), (), tick)
    assert memory.in_sight_until(5, 10) == 15  # one blind frame is none
    assert memory.in_sight_until(15, 30) == 22
    assert memory.in_sight_since(30, 100) == 21
    assert memory.in_sight_since(15, 100) == 1
    assert memory.in_sight_until(-3, 100) == 0
    assert memory.in_sight_since(-3, 100) == -3
