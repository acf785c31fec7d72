import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from neuse.geometry import (
    adjoint,
    covariance_from_ros,
    covariance_to_ros,
    exp,
    inverse,
    log,
    make_transform,
    quaternion_xyzw,
    renormalized,
    rotation_angle,
    skew,
    transform_from_quaternion,
    transform_points,
)

SEEDS = range(5)


def random_tangent(rng, largest_rad=3.0):
    omega = rng.normal(size=3)
    return np.concatenate([omega * rng.uniform(0, largest_rad) / np.linalg.norm(omega), rng.normal(size=3)])


def random_transform(rng):
    return exp(random_tangent(rng))


def random_covariance(rng):
    root = rng.normal(size=(6, 6))
    return root @ root.T


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-7, 1e-5, 1e-2, 1.0, 3.0])
def test_exponential_logarithm_and_adjoint_are_those_of_gtsam(scale):
    rng = np.random.default_rng(0)
    direction = rng.normal(size=3)
    xi = np.concatenate([scale * direction / np.linalg.norm(direction), rng.normal(size=3)])
    pose = gtsam.Pose3.Expmap(xi)
    np.testing.assert_allclose(exp(xi), pose.matrix(), atol=1e-9)
    np.testing.assert_allclose(log(pose.matrix()), xi, atol=1e-7)
    np.testing.assert_allclose(adjoint(pose.matrix()), pose.AdjointMap(), atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_logarithm_is_the_inverse_of_the_exponential(seed):
    xi = random_tangent(np.random.default_rng(seed))
    np.testing.assert_allclose(log(exp(xi)), xi, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_adjoint_carries_a_perturbation_to_the_other_side(seed):
    rng = np.random.default_rng(seed)
    T, xi = random_transform(rng), 0.1 * random_tangent(rng)
    np.testing.assert_allclose(T @ exp(xi), exp(adjoint(T) @ xi) @ T, atol=1e-12)


def test_inverse_undoes_one_and_many_transforms():
    rng = np.random.default_rng(1)
    T = np.stack([random_transform(rng) for _ in range(6)]).reshape(2, 3, 4, 4)
    np.testing.assert_allclose(inverse(T) @ T, np.broadcast_to(np.eye(4), T.shape), atol=1e-12)
    np.testing.assert_allclose(inverse(T[0, 0]), np.linalg.inv(T[0, 0]), atol=1e-12)


def test_transform_puts_rotation_and_translation_in_their_places():
    T = make_transform(np.arange(9).reshape(3, 3), [1, 2, 3])
    np.testing.assert_array_equal(T, [[0, 1, 2, 1], [3, 4, 5, 2], [6, 7, 8, 3], [0, 0, 0, 1]])
    many = make_transform(np.stack([np.eye(3)] * 4), np.zeros((4, 3)))
    np.testing.assert_array_equal(many, np.stack([np.eye(4)] * 4))


def test_points_are_transformed_as_homogeneous_columns():
    rng = np.random.default_rng(2)
    T, points = random_transform(rng), rng.normal(size=(7, 3))
    expected = (T @ np.concatenate([points, np.ones((7, 1))], axis=1).T).T[:, :3]
    np.testing.assert_allclose(transform_points(T, points), expected, atol=1e-12)
    np.testing.assert_allclose(transform_points(T, points[0]), expected[0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-8, 0.5, 3.0, np.pi])
def test_rotation_angle_is_the_length_of_the_rotation_vector(angle):
    R = Rotation.from_rotvec(np.array([0.6, 0.0, 0.8]) * angle).as_matrix()
    assert rotation_angle(R) == pytest.approx(angle, abs=1e-9)


def test_skew_matrix_is_the_cross_product():
    v, w = np.random.default_rng(3).normal(size=(2, 3))
    np.testing.assert_allclose(skew(v) @ w, np.cross(v, w))


@pytest.mark.parametrize("seed", SEEDS)
def test_quaternion_round_trip_keeps_the_transform(seed):
    T = random_transform(np.random.default_rng(seed))
    q_xyzw = quaternion_xyzw(T)
    assert q_xyzw[3] >= 0
    np.testing.assert_allclose(transform_from_quaternion(q_xyzw, T[:3, 3]), T, atol=1e-12)


def test_quaternion_has_its_scalar_last():
    np.testing.assert_allclose(quaternion_xyzw(np.eye(4)), [0, 0, 0, 1])
    quarter_turn = transform_from_quaternion([0, 0, np.sqrt(0.5), np.sqrt(0.5)], [0, 0, 0])
    np.testing.assert_allclose(transform_points(quarter_turn, [1, 0, 0]), [0, 1, 0], atol=1e-12)


def test_many_quaternions_are_converted_at_once():
    rng = np.random.default_rng(4)
    T = np.stack([random_transform(rng) for _ in range(5)])
    np.testing.assert_allclose(transform_from_quaternion(quaternion_xyzw(T), T[:, :3, 3]), T, atol=1e-12)


@pytest.mark.parametrize("seed", SEEDS)
def test_covariance_to_ros_and_back_is_the_same(seed):
    rng = np.random.default_rng(seed)
    covariance, T = random_covariance(rng), random_transform(rng)
    np.testing.assert_allclose(covariance_from_ros(covariance_to_ros(covariance, T), T), covariance)


def test_ros_covariance_is_of_the_shift_and_turn_about_the_target_axes():
    rng = np.random.default_rng(5)
    T, scale = random_transform(rng), 1e-5
    covariance = random_covariance(rng) * scale**2
    xi = rng.multivariate_normal(np.zeros(6), covariance, 2000)
    perturbed = T @ np.array([exp(x) for x in xi])
    shift = perturbed[:, :3, 3] - T[:3, 3]
    turn = Rotation.from_matrix(perturbed[:, :3, :3] @ T[:3, :3].T).as_rotvec()
    sampled = np.cov(np.concatenate([shift, turn], axis=1).T)
    expected = covariance_to_ros(covariance, T)
    np.testing.assert_allclose(sampled, expected, atol=0.1 * np.abs(expected).max())


def test_renormalized_transform_is_rigid_and_near():
    rng = np.random.default_rng(0)
    T = random_transform(rng)
    rough = T + 1e-4 * np.pad(rng.normal(size=(3, 3)), (0, 1))
    R = renormalized(rough)[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(R, T[:3, :3], atol=1e-3)
    np.testing.assert_array_equal(renormalized(rough)[:3, 3], T[:3, 3])
