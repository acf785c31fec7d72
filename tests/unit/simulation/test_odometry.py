import numpy as np
import pytest

from neuse.geometry import exp, inverse, log
from neuse.simulation.odometry import OdometryNoise, drifting_odometry, paper_noise, visual_odometry_noise


def random_walk(n=400):
    rng = np.random.default_rng(2)
    poses = [exp(rng.normal(size=6))]
    for _ in range(n - 1):
        poses.append(poses[-1] @ exp(rng.normal(scale=[0.05] * 3 + [0.1] * 3)))
    return np.stack(poses)


def increment_errors(T_world_camera, T_odom_camera):
    true, odom = (inverse(T[:-1]) @ T[1:] for T in (T_world_camera, T_odom_camera))
    return np.stack([log(inverse(a) @ b) for a, b in zip(true, odom, strict=True)])


def test_odometry_without_noise_is_the_trajectory_seen_from_its_start():
    T_world_camera = random_walk(50)
    T_odom_camera = drifting_odometry(T_world_camera, OdometryNoise(0.0, 0.0), np.random.default_rng(0))
    assert T_odom_camera == pytest.approx(inverse(T_world_camera[0]) @ T_world_camera, abs=1e-9)


def test_increments_have_the_noise_asked_for():
    T_world_camera = random_walk(3000)
    errors = increment_errors(
        T_world_camera, drifting_odometry(T_world_camera, paper_noise(), np.random.default_rng(0))
    )
    assert errors.mean(axis=0) == pytest.approx(0.0, abs=0.005)
    assert errors[:, :3].std() == pytest.approx(0.003, rel=0.05)
    assert errors[:, 3:].std() == pytest.approx(0.05, rel=0.05)


def test_visual_odometry_drifts_with_the_distance():
    T_world_camera = np.tile(np.eye(4), (2001, 1, 1))
    T_world_camera[:, 0, 3] = np.arange(2001) * 0.2
    T_odom_camera = drifting_odometry(T_world_camera, visual_odometry_noise(), np.random.default_rng(0))
    errors = increment_errors(T_world_camera, T_odom_camera)
    assert errors[:, 3:].std() == pytest.approx(0.005 * 0.2, rel=0.1)


def test_odometry_starts_at_the_identity_and_repeats_with_its_seed():
    first, second = (
        drifting_odometry(random_walk(), paper_noise(), np.random.default_rng(3)) for _ in range(2)
    )
    np.testing.assert_array_equal(first[0], np.eye(4))
    np.testing.assert_array_equal(first, second)
