"""Keyframes and the frames held by them."""

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.keyframes import KeyframeLibrary, KeyframeRecord
from neuse.slam.object_frames import reduce_codes


def library_with(poses):
    library = KeyframeLibrary()
    for i, T in enumerate(poses):
        library.records.append(KeyframeRecord(i, i, np.zeros(0, int), reduce_codes([]), None))
        library.T_map_camera = np.concatenate([library.T_map_camera, T[None]])
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
    library.T_map_camera = np.stack([np.eye(4), exp([0, 0, np.pi / 2, 0, 0, 0])])
    stamp_ns, T = library.trajectory()[-1]
    assert stamp_ns == 150
    np.testing.assert_allclose(T[:3, 3], [0.0, 0.5, 0.0], atol=1e-12)


def test_trajectory_of_nothing_is_empty():
    assert KeyframeLibrary().trajectory() == []


def test_frame_is_found_by_its_stamp_within_the_tolerance():
    library = library_with([np.eye(4), np.eye(4)])
    assert library.frame_near(96, tolerance_ns=5).stamp_ns == 100
    assert library.frame_near(94, tolerance_ns=5) is None
    assert KeyframeLibrary().frame_near(0, tolerance_ns=5) is None
