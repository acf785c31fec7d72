"""Worlds of codes: what the camera sees lies where the world has it."""

import numpy as np
import pytest

from neuse.evaluation.code_worlds import GROUP, SIGMAS, make_code_world, walk
from neuse.geometry import inverse, log, transform_points
from neuse.slam.registration import align


@pytest.fixture
def world():
    return make_code_world(40, seed=3)


def test_camera_sees_the_group_before_it_where_it_stands(world):
    T_world_camera = world.camera(0.0)
    frame = world.observe(T_world_camera, 7, np.random.default_rng(0))
    assert (frame.stamp_ns, len(frame.observations)) == (7, GROUP)
    places = [transform_points(T_world_camera, o.code.center) for o in frame.observations]
    offsets = np.linalg.norm(np.array(places)[:, None] - world.T_world_object[None, :, :3, 3], axis=-1)
    assert offsets.min(axis=1).max() < 5 * SIGMAS[3] * np.sqrt(3)
    assert len(set(offsets.argmin(axis=1))) == GROUP


def test_codes_move_with_the_camera(world):
    T_a, T_b = world.camera(0.0), world.camera(0.3)
    codes = [[world.true_code(i).transformed(inverse(T)) for i in range(GROUP)] for T in (T_a, T_b)]
    np.testing.assert_allclose(align(*codes).T_b_a, inverse(T_b) @ T_a, atol=1e-9)


def test_camera_stands_upright_and_a_lap_ends_where_it_began(world):
    T_world_camera = world.camera(1.0)
    assert np.linalg.det(T_world_camera[:3, :3]) == pytest.approx(1.0)
    np.testing.assert_allclose(T_world_camera[:3, 1], [0.0, 0.0, -1.0], atol=1e-12)
    np.testing.assert_allclose(world.camera(1.0 + world.lap_m), T_world_camera, atol=1e-9)


def test_odometry_of_a_walk_drifts_slowly(world):
    path = walk(world, 20, 0.05)
    true_motion = inverse(path[0][0]) @ path[-1][0]
    drift = log(inverse(true_motion) @ path[-1][1].T_odom_camera)
    assert 0 < np.linalg.norm(drift[3:]) < 0.1
    assert np.all(np.diff([sample.stamp_ns for _, sample in path]) > 0)
