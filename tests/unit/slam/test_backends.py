"""What the graph is given, in both modes."""

from dataclasses import replace

import numpy as np
import pytest

from neuse.errors import SolverError
from neuse.geometry import exp, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.backends import LandmarkBackend
from neuse.slam.edge_backend import EdgeBackend
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.landmarks import LEVER_M, landmark_points
from neuse.slam.object_frames import SigmaParams, reduce_codes
from neuse.slam.sliding_window import SlidingWindow
from neuse.slam.smoother import SolverParams
from neuse.symmetry import BOX

from .synthetic import make_code, make_thing
from .test_association import scene_of

SIGMAS = np.array([0.02, 0.03, 0.05, 0.001, 0.002, 0.003])
HIDDEN = np.array([0.02, 0.03, 1.5, 0.001, 0.002, 0.003])
PERIOD_NS = 100_000_000
POSES = [exp([0, 0.02 * i, 0, 0.05 * i, 0, 0]) for i in range(6)]


@pytest.fixture
def scene():
    rng = np.random.default_rng(0)
    spots = np.array([[-0.3, 0.1, 1.2], [0.25, -0.05, 1.3], [0.0, 0.2, 1.7]])
    return scene_of([make_thing(i, i == 1, spot, rng) for i, spot in enumerate(spots)])


def record(scene, i, sigmas=SIGMAS):
    codes = [make_code(thing, inverse(POSES[i]) @ thing.T_world_object, sigmas) for thing in scene.things]
    return KeyframeRecord(i, i * PERIOD_NS, np.arange(len(codes)), reduce_codes(codes), None)


def tie(i, sigma=0.05):
    covariance = np.diag([0.02**2] * 3 + [sigma**2] * 3)
    T = inverse(POSES[i - 1]) @ POSES[i]
    return Edge(i - 1, i, (i - 1) * PERIOD_NS, i * PERIOD_NS, EdgeKind.SHORT_RANGE, T, covariance, (0, 1))


def odometry(i):
    T = tie(i).T_from_to @ exp([0, 0, 0, 0.03, -0.04, 0.02])
    return Edge(
        i - 1,
        i,
        (i - 1) * PERIOD_NS,
        i * PERIOD_NS,
        EdgeKind.ODOMETRY,
        T,
        np.diag([0.003**2] * 3 + [0.05**2] * 3),
    )


def run(backend, scene, edges_of, wrong=0.02, record_of=record):
    poses = np.zeros((0, 4, 4))
    for i, T in enumerate(POSES):
        start = T @ exp([0, 0, 0, wrong * (i > 0), 0, 0])
        seen = record_of(scene, i)
        backend.add_keyframe(seen, start, edges_of(i) if i else [], [])
        backend.add_sightings(seen, scene.tracks)
        poses = backend.solve()
        backend.place_all(scene.tracks)
    return poses


@pytest.mark.parametrize(("acceleration_mps2", "is_smooth"), [(0.0, False), (0.3, True)])
def test_smooth_motion_outweighs_odometry_where_nothing_is_seen(acceleration_mps2, is_smooth):
    rng = np.random.default_rng(2)
    backend = LandmarkBackend(SolverParams(acceleration_mps2=acceleration_mps2))
    errors = [exp(np.r_[0, 0, 0, (0.0 if i < 10 else 0.05) * rng.normal(size=3)]) for i in range(20)]
    T_map_camera = [np.eye(4)]
    for i in range(20):
        edges = []
        if i:
            sigma_m = 0.001 if i < 10 else 0.05
            covariance = np.diag(np.repeat([0.003, sigma_m], 3) ** 2)
            T = exp([0, 0, 0, 0.05, 0, 0]) @ errors[i]
            stamps_ns = (i - 1) * PERIOD_NS, i * PERIOD_NS
            edges = [Edge(i - 1, i, *stamps_ns, EdgeKind.ODOMETRY, T, covariance)]
            T_map_camera.append(backend.poses[-1] @ T)
        nothing = KeyframeRecord(i, i * PERIOD_NS, np.zeros(0, dtype=int), reduce_codes([]), None)
        backend.add_keyframe(nothing, T_map_camera[-1], edges, [])
        backend.solve()
    jerks_m = np.diff(backend.latest_poses()[:, :3, 3], n=2, axis=0)
    assert (np.abs(jerks_m).max() < 0.03) == is_smooth


def test_landmarks_correct_odometry(scene):
    poses = run(LandmarkBackend(SolverParams()), scene, lambda i: [odometry(i)])
    np.testing.assert_allclose(poses, POSES, atol=5e-3)
    for track, thing in zip(scene.tracks, scene.things, strict=True):
        np.testing.assert_allclose(track.place[0], thing.T_world_object[:3, 3], atol=5e-3)
        assert track.anchored


def test_poses_long_past_are_read_when_asked_for(scene, monkeypatch):
    monkeypatch.setattr("neuse.slam.backends.RECENT", 2)
    backend = LandmarkBackend(SolverParams())
    poses = run(backend, scene, lambda i: [odometry(i)])
    latest = backend.latest_poses()
    np.testing.assert_array_equal(poses[-2:], latest[-2:])
    assert 0.0 < np.abs(poses[:-2] - latest[:-2]).max() < 0.01
    np.testing.assert_array_equal(backend.poses, poses)  # whoever looks changes nothing
    np.testing.assert_array_equal(backend.read_all(), latest)
    np.testing.assert_array_equal(backend.poses, latest)


@pytest.mark.parametrize(
    "make_backend", [LandmarkBackend, lambda params: EdgeBackend(params, 10)], ids=["landmarks", "edges"]
)
def test_keyframes_long_past_that_move_are_noticed(scene, monkeypatch, make_backend):
    monkeypatch.setattr("neuse.slam.backends.RECENT", 2)
    backend = make_backend(SolverParams())
    run(backend, scene, lambda i: [odometry(i)])
    assert not backend.has_moved()
    before = backend.read_all()
    assert not backend.has_moved()
    T_elsewhere = inverse(POSES[0]) @ POSES[2] @ exp([0.0, 0.0, 0.0, 0.02, 0.0, 0.0])
    backend.add_external(9 * [Edge(0, 2, 0, 2, EdgeKind.EXTERNAL, T_elsewhere, 1e-5 * np.eye(6))])
    for _ in range(10):
        backend.solve()
    assert backend.has_moved()
    assert np.linalg.norm(backend.latest_poses()[2, :3, 3] - before[2, :3, 3]) > 0.005
    assert backend.has_moved()
    backend.read_all()
    assert not backend.has_moved()


def test_landmarks_do_not_use_edges_from_codes(scene):
    """An absurd edge does no harm."""
    absurd = Edge(0, 1, 0, 1, EdgeKind.SHORT_RANGE, exp([1, 0, 0, 9, 9, 9]), 1e-9 * np.eye(6), (0,))
    poses = run(LandmarkBackend(SolverParams()), scene, lambda i: [odometry(i), absurd])
    np.testing.assert_allclose(poses, POSES, atol=5e-3)


def test_edges_correct_odometry(scene):
    poses = run(EdgeBackend(SolverParams(), window=4), scene, lambda i: [odometry(i), tie(i, sigma=0.002)])
    np.testing.assert_allclose(poses, POSES, atol=3e-3)


def test_places_in_edge_mode_are_averages_over_keyframes(scene):
    for track in scene.tracks:
        track.place = track.place + np.array([[0.5, 0, 0], [0, 0, 0], [0, 0, 0]])
    run(EdgeBackend(SolverParams(), window=4), scene, lambda i: [tie(i)], wrong=0.0)
    for track, thing in zip(scene.tracks, scene.things, strict=True):
        np.testing.assert_allclose(track.place[0], thing.T_world_object[:3, 3], atol=1e-4)
        np.testing.assert_allclose(track.place[1], thing.T_world_object[:3, 2], atol=1e-4)


def test_external_edges_pull(scene):
    backend = EdgeBackend(SolverParams(), window=4)
    run(backend, scene, lambda i: [odometry(i)], wrong=0.0)
    sure = Edge(0, 5, 0, 5, EdgeKind.EXTERNAL, inverse(POSES[0]) @ POSES[5], 1e-5 * np.eye(6))
    backend.add_external([sure])
    for _ in range(2 * SolverParams().relinearize_every):
        backend.solve()
    np.testing.assert_allclose(backend.solve()[5], POSES[5], atol=2e-3)


def test_external_edges_far_off_hardly_pull(scene):
    backend = EdgeBackend(SolverParams(), window=4)
    before = run(backend, scene, lambda i: [odometry(i)], wrong=0.0)
    T_wrong = inverse(before[0]) @ before[5] @ exp([0, 0, 0, 3.0, 0, 0])
    backend.add_external([Edge(0, 5, 0, 5, EdgeKind.EXTERNAL, T_wrong, 1e-5 * np.eye(6))])
    for _ in range(10):
        backend.solve()
    np.testing.assert_allclose(backend.solve()[5], before[5], atol=0.1)


def test_uncertainty_grows_along_odometry(scene):
    backend = EdgeBackend(SolverParams(), window=4)
    run(backend, scene, lambda i: [odometry(i)], wrong=0.0)
    assert backend.covariance(5)[3, 3] > backend.covariance(1)[3, 3] > backend.covariance(0)[3, 3]


def test_landmark_points_are_the_ends_and_lie_along_the_handle(scene):
    frames = record(scene, 0).frames
    points, _ = landmark_points(frames, 0)
    half = frames.half_heights[0] * frames.axes[0]
    np.testing.assert_allclose(points[:2] - frames.centers[0], [half, -half], atol=1e-12)
    np.testing.assert_allclose(points[2] - frames.centers[0], LEVER_M * frames.vectors[2, 0], atol=1e-12)


@pytest.mark.parametrize("correlation", [-0.6, 0.0, 0.9])
def test_covariances_of_ends_are_those_of_centre_tilt_and_height(scene, correlation):
    thing = scene.things[0]
    code = make_code(thing, np.eye(4), SIGMAS)  # object axes are camera axes
    code = replace(code, height_correlation=correlation)
    frames = reduce_codes([code], SigmaParams(1.0, 0.0, 0.0))
    _, covariances = landmark_points(frames, 0)
    turns, shifts = SIGMAS[:3] ** 2, SIGMAS[3:] ** 2
    across = shifts[:2] + frames.half_heights[0] ** 2 * turns[1::-1]
    along = shifts[2] * np.array([[1, correlation], [correlation, 1]])  # of centre and half height
    for end, covariance in zip([(1, 1), (1, -1)], covariances[:2], strict=True):
        expected = np.diag([*across, np.array(end) @ along @ end])
        np.testing.assert_allclose(covariance, expected, atol=1e-15)


def test_handle_point_tells_the_turn_about_the_axis_alone(scene):
    code = make_code(scene.things[0], np.eye(4), SIGMAS)
    _, covariances = landmark_points(reduce_codes([code], SigmaParams(1.0, 0.0, 0.0)), 0)
    turn = SIGMAS[4] ** 2 + LEVER_M**2 * SIGMAS[2] ** 2
    np.testing.assert_allclose(covariances[2], np.diag([LEVER_M**2, turn, LEVER_M**2]), atol=1e-15)


def test_hidden_handles_and_bottles_give_no_handle_point(scene):
    backend = LandmarkBackend(SolverParams())
    hidden = record(scene, 0, HIDDEN)
    backend.add_keyframe(hidden, POSES[0], [], [])
    backend.add_sightings(hidden, scene.tracks)
    backend.solve()
    assert {point % 3 for point in backend.graph.points()} == {0, 1}


UNTOLD = np.array([np.pi] * 3 + [0.001, 0.002, 0.003])


def renamed(scene, i):
    """A keyframe whose first object is a box: each view has other names for its edges."""
    first, *others = scene.things
    turn = np.eye(4)
    turn[:3, :3] = BOX.turns[(7 * i) % len(BOX.turns)]
    T_camera_box = inverse(POSES[i]) @ first.T_world_object @ turn
    codes = [make_code(first, T_camera_box, UNTOLD)]
    codes += [make_code(thing, inverse(POSES[i]) @ thing.T_world_object, SIGMAS) for thing in others]
    return KeyframeRecord(i, i * PERIOD_NS, np.arange(len(codes)), reduce_codes(codes), None)


def test_object_that_tells_no_axis_is_its_centre_alone(scene):
    code = make_code(scene.things[0], np.eye(4), UNTOLD)
    points, covariances = landmark_points(reduce_codes([code], SigmaParams(1.0, 0.0, 0.0)), 0)
    np.testing.assert_allclose(points[0], code.center, atol=1e-15)
    np.testing.assert_allclose(covariances[0], np.diag(UNTOLD[3:] ** 2), atol=1e-15)


def test_box_whose_edges_change_their_names_keeps_its_place_and_misleads_nobody(scene):
    backend, box = LandmarkBackend(SolverParams()), scene.tracks[0]
    poses = run(backend, scene, lambda i: [odometry(i)], record_of=renamed)
    np.testing.assert_allclose(poses, POSES, atol=3e-3)
    np.testing.assert_allclose(box.place[0], scene.things[0].T_world_object[:3, 3], atol=3e-3)
    np.testing.assert_allclose(np.linalg.norm(box.place[1:], axis=1), 1.0)
    assert {point for point in backend.graph.points() if point // 3 == box.key} == {3 * box.key}


def test_known_box_is_known_by_its_centre(scene):
    backend, box = LandmarkBackend(SolverParams()), scene.tracks[0]
    box.last = replace(box.last, frames=renamed(scene, 0).frames[[0]])
    backend.add_keyframe(record(scene, 0), POSES[0], [], [])
    backend.add_known([box])
    backend.solve()
    assert set(backend.graph.points()) == {3 * box.key}


def test_window_that_cannot_be_solved_begins_anew(scene, monkeypatch):
    backend = EdgeBackend(SolverParams(), window=4)
    broken = SlidingWindow.add

    def add(self, keyframe_id, T_window_camera, edges):
        if keyframe_id == 2 and edges:
            raise SolverError("open")
        broken(self, keyframe_id, T_window_camera, edges)

    monkeypatch.setattr(SlidingWindow, "add", add)
    poses = run(backend, scene, lambda i: [odometry(i), tie(i, sigma=0.002)])
    np.testing.assert_allclose(poses, POSES, atol=3e-3)
    assert not backend.window.has(1)
    assert backend.window.has(2)
