"""The graph against gtsam used by hand, and the window against a batch solution."""

from itertools import accumulate

import gtsam
import numpy as np
import pytest

from neuse.errors import SolverError
from neuse.geometry import exp, inverse, log, transform_points
from neuse.records import Edge, EdgeKind
from neuse.slam.factors import (
    bias_key,
    cauchy,
    edge_factor,
    huber,
    pose_key,
    sighting_factor,
    smooth_motion_factor,
    velocity_key,
)
from neuse.slam.pose_graph import PoseGraph
from neuse.slam.sliding_window import SlidingWindow
from neuse.slam.smoother import SolverParams

SIGMAS = np.array([0.01, 0.02, 0.03, 0.1, 0.2, 0.3])


def make_edge(from_id, to_id, T_from_to, sigmas=SIGMAS, object_ids=(0,)):
    return Edge(from_id, to_id, 0, 1, EdgeKind.SHORT_RANGE, T_from_to, np.diag(sigmas**2), object_ids)


def poses_on_a_way(rng, n):
    poses = [np.eye(4)]
    for _ in range(n - 1):
        poses.append(poses[-1] @ exp(np.array([0, 0, 0.1, 0.3, 0, 0]) + 0.02 * rng.normal(size=6)))
    return poses


def noisy_edges(rng, poses, lags):
    return [
        make_edge(i - lag, i, inverse(poses[i - lag]) @ poses[i] @ exp(0.1 * SIGMAS * rng.normal(size=6)))
        for i in range(1, len(poses))
        for lag in lags
        if i >= lag
    ]


def batch_solution(edges, starts, params):
    """All edges at once by Levenberg-Marquardt."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    prior = gtsam.noiseModel.Isotropic.Sigma(6, 1e-4)
    graph.add(gtsam.PriorFactorPose3(gtsam.symbol("x", 0), gtsam.Pose3(starts[0]), prior))
    for i, T in enumerate(starts):
        values.insert(gtsam.symbol("x", i), gtsam.Pose3(T))
    for edge in edges:
        graph.add(edge_factor(edge, huber(params.huber_sigmas)))
    solution = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    return np.stack([solution.atPose3(gtsam.symbol("x", i)).matrix() for i in range(len(starts))])


def solve(graph, times):
    for _ in range(times):
        graph.solve()


def test_edge_factor_has_no_error_where_the_points_agree():
    rng = np.random.default_rng(0)
    T_map_from, T_from_to = exp(rng.normal(size=6)), exp(rng.normal(size=6))
    values = gtsam.Values()
    values.insert(gtsam.symbol("x", 3), gtsam.Pose3(T_map_from))
    values.insert(gtsam.symbol("x", 5), gtsam.Pose3(T_map_from @ T_from_to))
    assert edge_factor(make_edge(3, 5, T_from_to), None).error(values) == pytest.approx(0.0, abs=1e-12)


def test_edge_factor_weighs_perturbations_in_the_frame_of_the_covariance():
    rng = np.random.default_rng(1)
    T_map_from, T_from_to, xi = exp(rng.normal(size=6)), exp(rng.normal(size=6)), 1e-3 * rng.normal(size=6)
    values = gtsam.Values()
    values.insert(gtsam.symbol("x", 0), gtsam.Pose3(T_map_from))
    values.insert(gtsam.symbol("x", 1), gtsam.Pose3(T_map_from @ T_from_to @ exp(xi)))
    error = edge_factor(make_edge(0, 1, T_from_to), None).error(values)
    assert error == pytest.approx(0.5 * (xi**2 / SIGMAS**2).sum(), rel=1e-2)


def test_sighting_factor_weighs_a_small_error_as_its_covariance_says():
    rng = np.random.default_rng(2)
    for _ in range(10):
        T_map_camera, p_camera = exp(rng.normal(size=6)), rng.normal(size=3) + np.array([0, 0, 2])
        A = 0.01 * rng.normal(size=(3, 3))
        covariance = A @ A.T + 1e-5 * np.eye(3)
        error = 1e-4 * rng.normal(size=3)
        values = gtsam.Values()
        values.insert(0, gtsam.Pose3(T_map_camera))
        values.insert(1, transform_points(T_map_camera, p_camera + error))
        factor = sighting_factor(0, 1, p_camera, covariance, kernel=cauchy(1e3))
        assert factor.error(values) == pytest.approx(
            0.5 * error @ np.linalg.solve(covariance, error), rel=1e-2
        )


def test_sighting_factor_linearises_like_numerical_differences():
    rng = np.random.default_rng(3)
    T, p_camera = exp(rng.normal(size=6)), np.array([0.3, -0.2, 1.5])
    point, values = transform_points(T, p_camera), gtsam.Values()
    values.insert(0, gtsam.Pose3(T))
    values.insert(1, point)
    factor = sighting_factor(0, 1, p_camera, 1e-4 * np.eye(3), kernel=cauchy(1e6))
    A, b = factor.linearize(values).jacobian()
    for column in range(6):
        moved = gtsam.Values(values)
        moved.update(0, gtsam.Pose3(T @ exp(1e-6 * np.eye(6)[column])))
        change = -(factor.linearize(moved).jacobian()[1] - b) / 1e-6
        np.testing.assert_allclose(A[:, column], change, rtol=1e-3, atol=1e-2)


def test_poses_come_back_in_order_of_their_ids():
    rng = np.random.default_rng(4)
    poses, graph = poses_on_a_way(rng, 12), PoseGraph()
    graph.add_origin(0, poses[0])
    for i, T in enumerate(poses):
        graph.add_pose(i, T)
    for edge in noisy_edges(rng, poses, lags=(1,)):
        graph.add_edge(edge)
    graph.solve()
    last = graph.poses(first=9)
    assert graph.poses().shape == (12, 4, 4)
    np.testing.assert_array_equal(last, graph.poses()[9:])
    np.testing.assert_array_equal(last, graph.poses(first=9))
    np.testing.assert_allclose(graph.poses(), poses, atol=0.2)
    np.testing.assert_allclose(
        graph.poses()[:, :3, :3] @ graph.poses()[:, :3, :3].swapaxes(1, 2),
        np.tile(np.eye(3), (12, 1, 1)),
        atol=1e-9,
    )


def test_incremental_solution_equals_the_batch_solution():
    rng = np.random.default_rng(5)
    params = SolverParams(relinearize_m=1e-6, relinearize_rad=1e-6, relinearize_every=1)
    poses = poses_on_a_way(rng, 15)
    edges, graph = noisy_edges(rng, poses, lags=(1, 2, 7)), PoseGraph(params)
    graph.add_origin(0, poses[0])
    for i, T in enumerate(poses):
        graph.add_pose(i, T)
        for edge in edges:
            if edge.to_id == i:
                graph.add_edge(edge)
        solve(graph, times=3)
    np.testing.assert_allclose(graph.poses(), batch_solution(edges, poses, params), atol=1e-4)


def test_landmark_seen_from_two_poses_is_placed_and_ties_them():
    rng = np.random.default_rng(6)
    points = rng.uniform(-1, 1, size=(4, 3)) + np.array([0, 0, 2])
    poses, graph = [np.eye(4), exp([0, 0.1, 0, 0.3, 0, 0])], PoseGraph()
    graph.add_origin(0, poses[0])
    graph.add_pose(0, poses[0])
    graph.add_pose(1, poses[1] @ exp(0.03 * rng.normal(size=6)))
    for i, T in enumerate(poses):
        for j, point in enumerate(points):
            p_camera = transform_points(inverse(T), point)
            graph.add_sighting(i, j, p_camera, 1e-4 * np.eye(3), point + 0.02)
    solve(graph, times=10)
    np.testing.assert_allclose(graph.poses()[1], poses[1], atol=1e-4)
    for j, point in enumerate(points):
        np.testing.assert_allclose(graph.points()[j], point, atol=1e-3)
    assert list(graph.points([2, 99])) == [2]


def test_loose_points_are_no_reason_to_relinearise_what_sees_them():
    """A point that is hardly known along one direction is pulled along it by 5 cm, and nothing else is."""
    ranges_m, relinearised = [2.0, 2.0, 2.05, 2.05, 2.05], {}
    for loose in (False, True):
        graph = PoseGraph(SolverParams(relinearize_every=1))
        graph.add_origin(0, np.eye(4))
        graph.add_pose(0, np.eye(4))
        moved_m = []
        for range_m in ranges_m:
            seen = np.array([0.0, 0.0, range_m])
            graph.add_sighting(0, 7, seen, np.diag([1e-4, 1e-4, 0.09]), seen, loose)
            graph.solve()
            moved_m.append(np.abs(graph._smoother.isam.getDelta().at(graph._points[7])).max())
        relinearised[loose] = min(moved_m[2:])
        assert graph.points()[7][2] == pytest.approx(2.03, abs=0.005)
    assert relinearised[False] < 0.01 < relinearised[True]


def test_covariance_of_a_chain_adds_up():
    graph = PoseGraph()
    graph.add_origin(0, np.eye(4))
    for i in range(3):
        graph.add_pose(i, np.eye(4))
    for i in (1, 2):
        graph.add_edge(make_edge(i - 1, i, np.eye(4)), robust=False)
    graph.solve()
    np.testing.assert_allclose(np.diag(graph.covariance(2)), 2 * SIGMAS**2, rtol=1e-2)


def test_window_that_forgets_nothing_equals_the_batch_solution():
    rng = np.random.default_rng(7)
    poses, params = poses_on_a_way(rng, 8), SolverParams()
    edges, window = noisy_edges(rng, poses, lags=(1, 2, 3)), SlidingWindow(size=8, params=params)
    for i, T in enumerate(poses):
        window.add(i, T, [edge for edge in edges if edge.to_id == i])
    solution = batch_solution(edges, poses, params)
    for i in range(8):
        np.testing.assert_allclose(window.pose(i), solution[i], atol=1e-4)


def test_window_forgets_poses_but_not_what_they_said():
    rng = np.random.default_rng(8)
    poses, params = poses_on_a_way(rng, 20), SolverParams(huber_sigmas=100.0)
    edges, window = noisy_edges(rng, poses, lags=(1, 2, 3)), SlidingWindow(size=5, params=params)
    for i, T in enumerate(poses):
        window.add(i, T, [edge for edge in edges if edge.to_id == i])
    with pytest.raises(KeyError):
        window.pose(14)
    solution = batch_solution(edges, poses, params)
    assert np.linalg.norm(log(inverse(window.pose(19)) @ solution[19])) < 0.02


def test_graph_that_nothing_ties_down_is_refused():
    graph = PoseGraph()
    graph.add_pose(0, np.eye(4))
    graph.add_pose(1, np.eye(4))
    graph.add_edge(make_edge(0, 1, np.eye(4)))
    with pytest.raises(SolverError, match="reset"):
        graph.solve()


def test_sigmas_too_far_apart_for_the_fast_factorisation_are_solved_by_the_safe_one():
    sigmas = np.array([0.01, 0.01, 0.01, 1e-6, 1e-6, 10.0])
    poses, fast, safe = [exp([0, 0, 0, 0.1 * i, 0, 0]) for i in range(6)], [], []
    graph = PoseGraph(SolverParams())
    graph.add_origin(0, poses[0])
    for i, T_map_camera in enumerate(poses):
        graph.add_pose(i, T_map_camera @ exp(np.full(6, 0.001)))
        if i:
            noise = SIGMAS if i < 3 else sigmas
            graph.add_edge(make_edge(i - 1, i, inverse(poses[i - 1]) @ T_map_camera, noise), robust=False)
        before = graph._smoother.isam
        graph.solve()
        (fast if graph._smoother.isam is before else safe).append(i)
    assert fast[:3] == [0, 1, 2]
    assert safe
    solve(graph, times=10)
    np.testing.assert_allclose(graph.poses(), poses, atol=1e-3)


def test_smooth_motion_is_white_noise_of_an_acceleration_that_is_constant_over_a_step():
    duration_s, acceleration = 0.5, 0.3
    gain = np.array([duration_s**2 / 2, duration_s]) * acceleration / np.sqrt(duration_s)
    Q = np.kron(np.outer(gain, gain) + np.diag([1e-6 * duration_s, 0.0]), np.eye(3))
    factor = smooth_motion_factor(0, 1, duration_s, acceleration)
    values, error = gtsam.Values(), np.array([0.02, -0.03, 0.05, 0.1, 0.04, -0.2])
    velocity = np.array([0.2, 0.1, -0.1])
    values.insert(pose_key(0), gtsam.Pose3())
    values.insert(velocity_key(0), velocity)
    values.insert(pose_key(1), gtsam.Pose3(gtsam.Rot3(), duration_s * velocity + error[:3]))
    values.insert(velocity_key(1), velocity + error[3:])
    values.insert(bias_key(1), gtsam.imuBias.ConstantBias())
    assert factor.error(values) == pytest.approx(0.5 * error @ np.linalg.solve(Q, error), rel=0.02)


def test_covariance_of_an_unknown_keyframe_is_refused():
    graph = PoseGraph()
    graph.add_origin(0, np.eye(4))
    graph.add_pose(0, np.eye(4))
    graph.solve()
    with pytest.raises(SolverError):
        graph.covariance(7)


def test_window_refuses_an_edge_to_a_keyframe_that_it_never_had():
    window = SlidingWindow(4)
    window.add(0, np.eye(4), [])
    with pytest.raises(SolverError):
        window.add(1, np.eye(4), [make_edge(7, 1, np.eye(4))])


@pytest.mark.parametrize(("smooth", "least_m", "most_m"), [(False, 0.1, 1.0), (True, 0.0, 0.03)])
def test_smooth_motion_carries_the_camera_through_a_blind_gap(smooth, least_m, most_m):
    """Constant speed; steps 10 to 30 are known to 5 cm, the others to a millimetre, and the end is seen."""
    rng, n, step_m = np.random.default_rng(0), 41, 0.05
    graph = PoseGraph(SolverParams(acceleration_mps2=0.1))
    graph.add_origin(0, np.eye(4))
    poses = [np.eye(4)]
    graph.add_pose(0, poses[0])
    for i in range(1, n):
        sigma_m = 0.05 if 10 < i <= 30 else 0.001
        T_from_to = exp(np.r_[0, 0, 0, np.array([step_m, 0, 0]) + sigma_m * rng.normal(size=3)])
        poses.append(poses[-1] @ T_from_to)
        graph.add_pose(i, poses[i])
        graph.add_edge(make_edge(i - 1, i, T_from_to, np.repeat([0.001, sigma_m], 3)), robust=False)
        if smooth:
            graph.add_smooth_motion(i - 1, i, 0.1, poses[i - 1], poses[i])
    graph.add_edge(make_edge(0, n - 1, exp([0, 0, 0, (n - 1) * step_m, 0, 0]), np.full(6, 0.001)))
    solve(graph, times=3)
    errors_m = np.linalg.norm(graph.poses()[:, :3, 3] - step_m * np.arange(n)[:, None] * [1, 0, 0], axis=1)
    assert least_m <= errors_m.max() <= most_m


def test_smooth_motion_says_nothing_of_turns():
    rng = np.random.default_rng(1)
    graph = PoseGraph()
    graph.add_origin(0, np.eye(4))
    turns = [exp(np.r_[0.3 * rng.normal(size=3), 0.05, 0, 0]) for _ in range(5)]
    poses = list(accumulate([np.eye(4), *turns], np.matmul))
    for i, T_map_camera in enumerate(poses):
        graph.add_pose(i, T_map_camera)
        if i:
            graph.add_edge(make_edge(i - 1, i, turns[i - 1]))
            graph.add_smooth_motion(i - 1, i, 0.1, poses[i - 1], T_map_camera)
    solve(graph, times=3)
    assert np.allclose(graph.poses()[:, :3, :3], np.array(poses)[:, :3, :3], atol=1e-3)


T_NEW_OLD = exp([0.4, -0.3, 2.0, 5.0, -3.0, 1.0])
LANDMARKS = np.array([[0.5, 0.5, 2.0], [-0.5, 0.2, 2.5], [0.1, -0.6, 1.5]])


def wandered(n=6):
    """A solved graph with edges, smooth motion and landmarks, and the way it has gone."""
    params = SolverParams(relinearize_m=1e-6, relinearize_rad=1e-6, relinearize_every=1)
    rng, graph = np.random.default_rng(11), PoseGraph(params)
    poses = poses_on_a_way(rng, n)
    graph.add_origin(0, poses[0])
    graph.add_pose(0, poses[0])
    for i in range(1, n):
        graph.add_pose(i, poses[i])
        graph.add_edge(make_edge(i - 1, i, inverse(poses[i - 1]) @ poses[i], 0.1 * SIGMAS))
        graph.add_smooth_motion(i - 1, i, 0.1, poses[i - 1], poses[i])
    for j, point in enumerate(LANDMARKS):
        for i, T in enumerate(poses):
            p_camera = transform_points(inverse(T), point) + 0.01 * rng.normal(size=3)
            graph.add_sighting(i, j, p_camera, 1e-4 * np.eye(3), point)
    solve(graph, times=30)
    return graph, poses


def test_moved_graph_is_the_same_graph_elsewhere():
    graph, _ = wandered()
    poses, points, covariance = graph.poses(), graph.points(), graph.covariance(2)
    graph.move(T_NEW_OLD)
    graph.add_hold(0, T_NEW_OLD @ poses[0], 1e-8 * np.eye(6))
    solve(graph, times=30)
    np.testing.assert_allclose(graph.poses(), T_NEW_OLD @ poses, atol=2e-4)
    for j, point in graph.points().items():
        np.testing.assert_allclose(point, transform_points(T_NEW_OLD, points[j]), atol=2e-4)
    np.testing.assert_allclose(graph.covariance(2), covariance, atol=0.02 * covariance.max())


def test_moved_graph_goes_on_as_it_would_have_gone():
    (stayed, poses), (moved, _) = wandered(), wandered()
    moved.move(T_NEW_OLD)
    moved.add_hold(0, T_NEW_OLD @ poses[0], 1e-8 * np.eye(6))
    further = poses[-1] @ exp([0, 0, 0.1, 0.3, 0, 0])
    for graph, T in ((stayed, np.eye(4)), (moved, T_NEW_OLD)):
        graph.add_pose(len(poses), T @ further)
        graph.add_edge(make_edge(len(poses) - 1, len(poses), inverse(poses[-1]) @ further))
        graph.add_smooth_motion(len(poses) - 1, len(poses), 0.1, T @ poses[-1], T @ further)
        p_camera = transform_points(inverse(further), LANDMARKS[0]) + 0.02
        graph.add_sighting(len(poses), 0, p_camera, 1e-4 * np.eye(3), LANDMARKS[0])
        solve(graph, times=30)
    np.testing.assert_allclose(moved.poses(), T_NEW_OLD @ stayed.poses(), atol=1e-4)


def test_known_points_pull_a_moved_graph_to_where_they_are():
    graph, poses = wandered()
    graph.move(T_NEW_OLD @ exp([0.02, -0.01, 0.03, 0.1, -0.05, 0.05]))
    graph.add_hold(len(poses) - 1, T_NEW_OLD @ poses[-1] @ exp([0, 0, 0, 0.1, 0, 0]), np.eye(6))
    for j, point in enumerate(LANDMARKS):
        graph.add_known_point(j, transform_points(T_NEW_OLD, point), 1e-6 * np.eye(3))
    solve(graph, times=20)
    assert np.linalg.norm(log(inverse(T_NEW_OLD @ poses[-1]) @ graph.poses()[-1])) < 0.03


def test_keyframe_goes_with_all_that_was_said_of_it():
    """And does not come back when the graph is moved elsewhere."""
    (graph, poses), (other, _) = wandered(), wandered()
    graph.add_edge(make_edge(1, 3, inverse(poses[1]) @ poses[3], 0.1 * SIGMAS))
    graph.remove(2)
    solve(graph, times=10)
    assert graph.ids.tolist() == [0, 1, 3, 4, 5]
    np.testing.assert_allclose(graph.poses(), other.poses()[[0, 1, 3, 4, 5]], atol=0.05)
    np.testing.assert_array_equal(graph.poses(first=3), graph.poses()[3:])
    with pytest.raises(SolverError):
        graph.covariance(2)
    before = graph.poses()
    graph.move(T_NEW_OLD)
    graph.add_hold(0, T_NEW_OLD @ before[0], 1e-8 * np.eye(6))
    solve(graph, times=30)
    np.testing.assert_allclose(graph.poses(), T_NEW_OLD @ before, atol=1e-3)


def test_keyframe_that_waits_to_go_does_not_come_back_with_a_graph_begun_anew():
    graph, poses = wandered()
    graph.remove(2)
    graph.move(T_NEW_OLD)
    graph.add_hold(0, T_NEW_OLD @ poses[0], 1e-8 * np.eye(6))
    graph.solve()
    assert graph.ids.tolist() == [0, 1, 3, 4, 5]
    assert len(graph.poses()) == 5


def test_keyframe_goes_whose_velocity_nothing_tells_any_more():
    graph, _ = wandered(n=3)
    graph.remove(1)
    graph.solve()
    graph.remove(0)
    graph.add_hold(2, np.eye(4), 1e-4 * np.eye(6))
    graph.solve()
    assert graph.ids.tolist() == [2]
