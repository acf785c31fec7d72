import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuse.errors import DegenerateGeometryError
from neuse.evaluation.pose_errors import trajectory_errors
from neuse.evaluation.trajectory import Trajectory, trajectory_of
from neuse.geometry import Array, inverse, make_transform


def _umeyama(source: Array, target: Array) -> Array:
    """Rotation and translation between point sets, by scipy."""
    rotation, _ = Rotation.align_vectors(target - target.mean(axis=0), source - source.mean(axis=0))
    R = rotation.as_matrix()
    return make_transform(R, target.mean(axis=0) - R @ source.mean(axis=0))


def _noisy(path: Trajectory, sigma_m: float, seed: int = 0) -> Trajectory:
    poses = path.T_frame_camera.copy()
    poses[:, :3, 3] += np.random.default_rng(seed).normal(0, sigma_m, (len(path), 3))
    return Trajectory(path.stamps_ns, poses)


def test_same_path_in_another_frame_has_no_error(helix: Trajectory, T_any: Array) -> None:
    errors = trajectory_errors(helix.transformed(T_any), helix)
    assert errors.ate_rmse_m < 1e-12
    assert errors.rpe_trans_rmse_m == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(errors.T_world_map, inverse(T_any), atol=1e-12)


def test_alignment_and_ate_equal_those_of_scipy(helix: Trajectory, T_any: Array) -> None:
    estimate = _noisy(helix, 0.05).transformed(T_any)
    errors = trajectory_errors(estimate, helix)
    T_world_map = _umeyama(estimate.positions, helix.positions)
    aligned = estimate.transformed(T_world_map).positions
    expected = np.sqrt(np.mean(np.sum((aligned - helix.positions) ** 2, axis=1)))
    np.testing.assert_allclose(errors.T_world_map, T_world_map, atol=1e-9)
    assert errors.ate_rmse_m == pytest.approx(expected, rel=1e-9)


def test_scale_is_not_corrected(helix: Trajectory) -> None:
    poses = helix.T_frame_camera.copy()
    poses[:, :3, 3] *= 1.1
    centered = helix.positions - helix.positions.mean(axis=0)
    expected = 0.1 * np.sqrt(np.mean(np.sum(centered**2, axis=1)))
    assert trajectory_errors(Trajectory(helix.stamps_ns, poses), helix).ate_rmse_m == pytest.approx(
        expected, rel=1e-6
    )


def test_rpe_of_one_jump_is_the_jump_shared_over_the_pairs(helix: Trajectory) -> None:
    poses = helix.T_frame_camera.copy()
    poses[30:, :3, 3] += [0.0, 0.0, 0.59]
    errors = trajectory_errors(Trajectory(helix.stamps_ns, poses), helix)
    assert errors.rpe_trans_rmse_m == pytest.approx(0.59 / np.sqrt(len(helix) - 1), rel=1e-6)


def test_rpe_over_a_metre_is_unknown_on_a_shorter_path(helix: Trajectory) -> None:
    short = helix.between(int(helix.stamps_ns[0]), int(helix.stamps_ns[4]))
    assert trajectory_errors(short, helix).rpe_per_m_rmse_m is None


def test_errors_come_with_the_estimates_own_stamps(helix: Trajectory) -> None:
    late = Trajectory(helix.stamps_ns[::2] + 3_000_000, helix.T_frame_camera[::2])
    errors = trajectory_errors(late, helix)
    np.testing.assert_array_equal(errors.stamps_ns, late.stamps_ns)
    assert errors.ate_rmse_m < 1e-9


def test_fewer_than_three_poses_are_refused(helix: Trajectory) -> None:
    with pytest.raises(DegenerateGeometryError, match="2 estimated"):
        trajectory_errors(trajectory_of(helix.stamps_ns[:2].tolist(), list(helix.T_frame_camera[:2])), helix)


def test_paths_of_other_times_are_refused(helix: Trajectory) -> None:
    other = Trajectory(helix.stamps_ns + 10**12, helix.T_frame_camera)
    with pytest.raises(DegenerateGeometryError, match="is it the right bag"):
        trajectory_errors(other, helix)


def test_too_little_overlap_is_refused(helix: Trajectory) -> None:
    shift_ns = int(helix.stamps_ns[-2] - helix.stamps_ns[0])
    with pytest.raises(DegenerateGeometryError, match="in common"):
        trajectory_errors(Trajectory(helix.stamps_ns + shift_ns, helix.T_frame_camera), helix)


def test_a_camera_that_stands_still_cannot_be_aligned(helix: Trajectory) -> None:
    still = Trajectory(helix.stamps_ns, np.tile(np.eye(4), (len(helix), 1, 1)))
    with pytest.raises(DegenerateGeometryError, match="cannot be aligned"):
        trajectory_errors(still, still)
