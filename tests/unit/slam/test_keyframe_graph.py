"""Keyframes leave the graph where the camera comes by again and again; what they were is not lost."""

import numpy as np
import pytest

from neuse.evaluation.code_worlds import make_code_world, walk
from neuse.geometry import inverse
from neuse.slam.keyframes import KeyframeParams
from neuse.slam.params import SlamParams
from neuse.slam.slam import ObjectSlam

SPACING_M = 0.15
WORLD = make_code_world(40)
LAP = round(WORLD.lap_m / SPACING_M)
MARKS = (round(0.8 * LAP), 2 * LAP, 3 * LAP)  # before the loop is closed, and after rounds
PARAMS = SlamParams(keyframes=KeyframeParams(near_m=0.2, views=1))


def errors_m(slam, path):
    """Of all keyframes; every frame was one."""
    T_world_map = path[0][0]
    T_map_camera = np.array([keyframe.T_map_camera for keyframe in slam.keyframes])
    T_world_camera = np.array([T for T, _ in path[: len(T_map_camera)]])
    return np.linalg.norm((T_world_map @ T_map_camera - T_world_camera)[:, :3, 3], axis=1)


@pytest.fixture(scope="module")
def rounds():
    """Three rounds; at each mark, how many keyframes the graph has, and the errors of all that ever were."""
    slam, rng, path = ObjectSlam(PARAMS), np.random.default_rng(0), walk(WORLD, 3 * LAP, SPACING_M)
    sizes, errors = [], []
    for i, (T_world_camera, sample) in enumerate(path, start=1):
        slam.step(WORLD.observe(T_world_camera, sample.stamp_ns, rng), sample)
        if i in MARKS:
            sizes.append(len(slam._graph._backend.ids))
            errors.append(errors_m(slam, path))
    return slam, path, sizes, errors


def test_graph_does_not_grow_when_the_camera_goes_the_same_way_again(rounds):
    _, _, sizes, _ = rounds
    assert 0.5 * MARKS[0] < sizes[0] < MARKS[0]
    assert sizes[2] - sizes[1] < 0.1 * LAP


def test_keyframes_that_left_are_in_their_places_with_all_others(rounds):
    slam, path, _, errors = rounds
    assert [keyframe.keyframe_id for keyframe in slam.keyframes] == list(range(3 * LAP))
    assert [keyframe.stamp_ns for keyframe in slam.keyframes] == [sample.stamp_ns for _, sample in path]
    assert errors[2].max() < 0.05


def test_keyframes_that_left_follow_when_a_loop_is_closed(rounds):
    slam, _, _, errors = rounds
    left = np.setdiff1d(np.arange(MARKS[0]), slam._graph._backend.ids)
    assert len(left)
    assert errors[2][left].max() < 0.5 * errors[0][left].max()


def test_frames_of_keyframes_that_left_are_in_the_trajectory(rounds):
    slam, path, _, _ = rounds
    stamps_ns, T_map_camera = zip(*slam.trajectory(), strict=True)
    assert list(stamps_ns) == [sample.stamp_ns for _, sample in path]
    T_world_camera = np.array([T for T, _ in path])
    errors = inverse(T_world_camera) @ path[0][0] @ np.array(T_map_camera)
    assert np.linalg.norm(errors[:, :3, 3], axis=1).max() < 0.05


def test_loops_close_to_keyframes_of_the_graph_alone(rounds):
    slam, _, _, _ = rounds
    tracks = slam._tracker.library.tracks.values()
    targets = {target for track in tracks for period in track.periods for target in period}
    recent = set(range(3 * LAP - 20, 3 * LAP))
    assert targets - recent <= set(slam._graph._backend.ids.tolist())
