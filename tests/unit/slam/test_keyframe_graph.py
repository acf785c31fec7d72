"""Keyframes leave the graph where the camera comes by again and again; what they were is not lost."""

import numpy as np
import pytest

from neuse.evaluation.code_worlds import make_code_world, walk
from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.backends import NOTICEABLE_M
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
    sizes, errors, told = [], [], {}
    for i, (T_world_camera, sample) in enumerate(path, start=1):
        slam.step(WORLD.observe(T_world_camera, sample.stamp_ns, rng), sample)
        told |= {keyframe.keyframe_id: keyframe.T_map_camera for keyframe in slam.moved_keyframes()}
        if i in MARKS:
            sizes.append(len(slam._graph._backend.ids))
            errors.append(errors_m(slam, path))
    return slam, path, sizes, errors, told


def test_graph_does_not_grow_when_the_camera_goes_the_same_way_again(rounds):
    _, _, sizes, _, _ = rounds
    assert 0.5 * MARKS[0] < sizes[0] < MARKS[0]
    assert sizes[2] - sizes[1] < 0.1 * LAP


def test_keyframes_that_left_are_in_their_places_with_all_others(rounds):
    slam, path, _, errors, _ = rounds
    assert [keyframe.keyframe_id for keyframe in slam.keyframes] == list(range(3 * LAP))
    assert [keyframe.stamp_ns for keyframe in slam.keyframes] == [sample.stamp_ns for _, sample in path]
    assert errors[2].max() < 0.05


def test_keyframes_that_left_follow_when_a_loop_is_closed(rounds):
    slam, _, _, errors, _ = rounds
    left = np.setdiff1d(np.arange(MARKS[0]), slam._graph._backend.ids)
    assert len(left)
    assert errors[2][left].max() < 0.5 * errors[0][left].max()


def test_frames_of_keyframes_that_left_are_in_the_trajectory(rounds):
    slam, path, _, _, _ = rounds
    stamps_ns, T_map_camera = zip(*slam.trajectory(), strict=True)
    assert list(stamps_ns) == [sample.stamp_ns for _, sample in path]
    T_world_camera = np.array([T for T, _ in path])
    errors = inverse(T_world_camera) @ path[0][0] @ np.array(T_map_camera)
    assert np.linalg.norm(errors[:, :3, 3], axis=1).max() < 0.05


def test_loops_close_to_keyframes_of_the_graph_alone(rounds):
    slam, _, _, _, _ = rounds
    tracks = slam._tracker.library.tracks.values()
    targets = {target for track in tracks for period in track.periods for target in period}
    recent = set(range(3 * LAP - 20, 3 * LAP))
    assert targets - recent <= set(slam._graph._backend.ids.tolist())


def test_who_is_told_what_has_moved_knows_where_everything_is(rounds):
    """Also of what moves in the solutions after a closure, in which nothing closes a loop."""
    slam, _, _, errors, told = rounds
    latest = {keyframe.keyframe_id: keyframe.T_map_camera for keyframe in slam.keyframes}
    assert told.keys() == latest.keys()
    off_m = [np.linalg.norm((told[i] - latest[i])[:3, 3]) for i in latest]
    assert max(off_m) < 2 * NOTICEABLE_M
    assert errors[0].max() > 4 * NOTICEABLE_M  # there was something to tell


def closures_of(slam, T_wrong):
    T = slam._graph.library.T_map_camera
    last = len(T) - 1
    ends = [(0, last, inverse(T[0]) @ T[last]), (1, last, inverse(T[1]) @ T[last] @ T_wrong)]
    covariance = np.diag([0.01**2] * 6)
    return [Edge(a, b, 0, 1, EdgeKind.LOOP_CLOSURE, T_a_b, covariance) for a, b, T_a_b in ends]


def test_wrong_loop_closures_are_not_told_where_the_solution_can_judge(rounds, monkeypatch):
    graph = rounds[0]._graph
    right, wrong = closures_of(rounds[0], exp(np.array([0.0, 0.0, 0.0, 0.15, 0.0, 0.0])))
    monkeypatch.setattr(graph, "_can_judge", True)
    assert graph.borne_out([right, wrong]) == [right]
    assert graph.borne_out([]) == []
    monkeypatch.setattr(graph, "_can_judge", False)
    assert graph.borne_out([right, wrong]) == [right, wrong]
