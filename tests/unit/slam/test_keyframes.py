"""Keyframes and the frames held by them."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.geometry import exp, inverse
from neuse.slam.keyframes import KeyframeLibrary, KeyframeRecord
from neuse.slam.object_frames import reduce_codes


def library_with(poses):
    library = KeyframeLibrary()
    for i, T in enumerate(poses):
        library.records.append(KeyframeRecord(i, i, np.zeros(0, int), reduce_codes([]), None))
        library.place(np.array([i]), T[None])
        library.add_frame(100 * i, T)
    return library


def test_first_frame_is_due():
    assert KeyframeLibrary().is_due(np.eye(4))


@pytest.mark.parametrize(
    ("xi", "due"),
    [
        ([0, 0, 0, 0.039, 0, 0], False),
        ([0, 0, 0, 0, 0.041, 0], True),
        ([0.09, 0, 0, 0, 0, 0], False),
        ([0, 0.11, 0, 0, 0, 0], True),
    ],
)
def test_frame_is_due_after_enough_motion(xi, due):
    assert library_with([np.eye(4)]).is_due(exp(xi)) is due


def test_frames_follow_their_keyframe_when_it_is_corrected():
    library = library_with([np.eye(4), exp([0, 0, 0, 1, 0, 0])])
    library.add_frame(150, exp([0, 0, 0, 1.5, 0, 0]))
    library.place(np.array([1]), exp([0, 0, np.pi / 2, 0, 0, 0])[None])
    stamp_ns, T = library.trajectory(library.T_map_camera)[-1]
    assert stamp_ns == 150
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.5, 0.0], atol=1e-12)


def test_trajectory_of_nothing_is_empty():
    assert KeyframeLibrary().trajectory(np.zeros((0, 4, 4))) == []


def test_frame_is_found_by_its_stamp_within_the_tolerance():
    library = library_with([np.eye(4), np.eye(4)])
    assert library.frame_near(96, tolerance_ns=5).stamp_ns == 100
    assert library.frame_near(94, tolerance_ns=5) is None
    assert KeyframeLibrary().frame_near(0, tolerance_ns=5) is None


def test_keyframe_that_has_left_the_graph_follows_the_one_that_stands_in_for_it():
    poses = [exp([0, 0, 0.1 * i, i, 0, 0]) for i in range(4)]
    library = library_with(poses)
    library.let_go(1, 0, inverse(poses[0]) @ poses[1])
    library.let_go(2, 3, inverse(poses[3]) @ poses[2])
    T_new_old = exp([0.3, 0, 1.0, 0, 5, 0])
    placed = library.placed(np.array([0, 3]), np.stack([T_new_old @ poses[0], poses[3]]))
    np.testing.assert_allclose(placed, [T_new_old @ poses[0], T_new_old @ poses[1], *poses[2:]])
    np.testing.assert_allclose([T for _, T in library.trajectory(placed)], placed)
    np.testing.assert_array_equal(library.T_map_camera, poses)


def test_frame_of_a_keyframe_that_has_left_is_held_by_the_one_that_stands_in():
    poses = [exp([0, 0, 0.1 * i, i, 0, 0]) for i in range(3)]
    library = library_with(poses)
    library.let_go(1, 2, inverse(poses[2]) @ poses[1])
    frame = library.frame_near(100, tolerance_ns=5)
    assert (frame.keyframe_id, frame.stamp_ns) == (2, 100)
    np.testing.assert_allclose(poses[2] @ frame.T_keyframe_camera, poses[1], atol=1e-12)
    assert library.frame_near(0, tolerance_ns=5).keyframe_id == 0


def test_keyframe_that_has_left_keeps_its_name_and_stamp_alone():
    library = library_with([np.eye(4), np.eye(4)])
    library.records[1] = replace(library.records[1], keys=np.arange(3))
    library.let_go(1, 0, np.eye(4))
    assert (library.records[1].keyframe_id, library.records[1].stamp_ns) == (1, 1)
    assert len(library.records[1].keys) == len(library.records[1].frames) == 0
