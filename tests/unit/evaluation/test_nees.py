from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from neuse.evaluation.nees import edge_nees, nees_by_objects, pose_nees, summarize_nees
from neuse.evaluation.trajectory import FramePose, Trajectory
from neuse.geometry import Array, exp, inverse
from neuse.records import Edge, EdgeKind

KINDS = (EdgeKind.SHORT_RANGE, EdgeKind.LOOP_CLOSURE)


def _edge(path: Trajectory, i: int, j: int, xi: Array, covariance: Array, kind=EdgeKind.SHORT_RANGE) -> Edge:
    """An edge whose true pose is T_from_to @ exp(xi)."""
    T_true = inverse(path.T_frame_camera[i]) @ path.T_frame_camera[j]
    stamps_ns = path.stamps_ns.tolist()
    return Edge(i, j, stamps_ns[i], stamps_ns[j], kind, T_true @ inverse(exp(xi)), covariance)


def test_nees_of_a_known_error_is_its_squared_mahalanobis_length(helix: Trajectory) -> None:
    xi, covariance = np.array([0.01, 0, 0, 0, 0.02, 0]), np.diag([1e-4] * 3 + [4e-4] * 3)
    assert edge_nees(_edge(helix, 3, 9, xi, covariance), helix) == pytest.approx(1.0 + 1.0, rel=1e-6)


def test_nees_does_not_depend_on_the_frame_of_ground_truth(helix: Trajectory, T_any: Array) -> None:
    edge = _edge(helix, 3, 9, np.full(6, 0.01), np.eye(6) * 1e-4)
    assert edge_nees(edge, helix.transformed(T_any)) == pytest.approx(edge_nees(edge, helix), rel=1e-9)


def test_nees_is_unknown_where_ground_truth_lacks_an_end(helix: Trajectory) -> None:
    edge = _edge(helix, 3, 59, np.zeros(6), np.eye(6))
    assert edge_nees(edge, helix.between(0, int(helix.stamps_ns[50]))) is None


def test_honest_edges_have_mean_six(helix: Trajectory) -> None:
    rng = np.random.default_rng(5)
    root = rng.normal(size=(6, 6)) * 0.01
    covariance = root @ root.T + np.eye(6) * 1e-6
    errors = rng.multivariate_normal(np.zeros(6), covariance, size=1500)
    edges = [_edge(helix, n % 50, n % 50 + 5, xi, covariance) for n, xi in enumerate(errors)]
    nees = summarize_nees(edges, helix, KINDS)
    assert nees is not None
    assert nees.mean == pytest.approx(6.0, abs=0.35)
    assert nees.median == pytest.approx(chi2.median(6), abs=0.35)
    assert nees.inside_95 == pytest.approx(0.95, abs=0.02)
    assert (nees.n, nees.dof) == (1500, 6)


def test_summary_is_over_the_kinds_that_are_asked_for(helix: Trajectory) -> None:
    odometry = _edge(helix, 1, 2, np.full(6, 0.1), np.eye(6) * 1e-4, EdgeKind.ODOMETRY)
    loop = _edge(helix, 1, 40, np.zeros(6), np.eye(6) * 1e-4, EdgeKind.LOOP_CLOSURE)
    nees = summarize_nees([odometry, loop], helix, KINDS)
    assert nees is not None
    assert (nees.n, round(nees.mean, 9)) == (1, 0.0)


def test_summary_of_no_edges_is_none(helix: Trajectory) -> None:
    assert summarize_nees([], helix, KINDS) is None


def test_edges_are_grouped_by_the_categories_of_their_objects(helix: Trajectory) -> None:
    edge = _edge(helix, 1, 2, np.full(6, 0.1), np.eye(6))
    edges = [replace(edge, object_ids=ids) for ids in ((0,), (0, 1), (0, 2), (2, 3), (9,), ())]
    groups = nees_by_objects(edges, {0: "mug", 1: "mug", 2: "bottle", 3: "bottle"}, helix)
    assert {name: nees and nees.n for name, nees in groups.items()} == {"bottle": 1, "mixed": 1, "mug": 2}


def test_poses_are_judged_relative_to_the_first(helix: Trajectory, T_any: Array) -> None:
    xi, covariance = np.array([0.02, 0, 0, 0, 0, 0.01]), np.diag([1e-4] * 6)
    path = helix.transformed(T_any)
    frames = [
        FramePose(stamp_ns, T @ inverse(exp(xi if i else np.zeros(6))), covariance=covariance)
        for i, (stamp_ns, T) in enumerate(zip(path.stamps_ns.tolist(), path.T_frame_camera, strict=True))
    ]
    nees = pose_nees(frames, helix)
    assert nees is not None
    assert (nees.n, nees.mean) == (59, pytest.approx(5.0, rel=1e-6))


def test_poses_without_covariance_are_not_judged(helix: Trajectory) -> None:
    assert pose_nees([FramePose(int(s), np.eye(4)) for s in helix.stamps_ns], helix) is None
