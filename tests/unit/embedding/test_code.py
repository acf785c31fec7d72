from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding.code import Code, landmark_template
from neuse.symmetry import BOX

from .tiny import EXTENTS, make_code, random_transform

K_VALUES = (8, 16, 64, 128)


@pytest.mark.parametrize("k", K_VALUES)
def test_landmark_template_has_zero_mean_and_no_preferred_direction(k):
    template = landmark_template(k)
    assert template.shape == (k // 2, 3)
    np.testing.assert_allclose(template.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(template.T @ template, k // 2 / 3 * np.eye(3), atol=1e-12)


def test_landmark_template_is_fixed_and_cannot_be_written():
    assert landmark_template(16) is landmark_template(16)
    with pytest.raises(ValueError, match="read-only"):
        landmark_template(16)[0, 0] = 1.0


@pytest.mark.parametrize("seed", range(5))
def test_code_of_a_mug_recovers_its_frame_and_extents(seed):
    T_frame_object = random_transform(np.random.default_rng(seed))
    code = make_code(T_frame_object)
    np.testing.assert_allclose(code.center, T_frame_object[:3, 3], atol=1e-12)
    np.testing.assert_allclose(code.axes, T_frame_object[:3, :3] * EXTENTS, atol=1e-12)
    np.testing.assert_allclose(code.T_frame_object, T_frame_object, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_code_of_a_bottle_recovers_its_centre_and_axis_alone(seed):
    T_frame_object = random_transform(np.random.default_rng(seed))
    code = make_code(T_frame_object, "bottle")
    T = code.T_frame_object
    np.testing.assert_allclose(T[:3, 3], T_frame_object[:3, 3], atol=1e-12)
    np.testing.assert_allclose(T[:3, 2], T_frame_object[:3, 2], atol=1e-12)
    np.testing.assert_allclose(code.axes[:, :2], 0.0, atol=1e-12)


@pytest.mark.parametrize("category", ["mug", "bottle"])
def test_transformed_code_lies_where_its_object_lies(category):
    rng = np.random.default_rng(3)
    T_camera_object, T_world_camera = random_transform(rng), random_transform(rng)
    moved = make_code(T_camera_object, category).transformed(T_world_camera)
    expected = make_code(T_world_camera @ T_camera_object, category)
    np.testing.assert_allclose(moved.z, expected.z, atol=1e-12)
    np.testing.assert_array_equal(moved.descriptor, expected.descriptor)
    np.testing.assert_array_equal(moved.sigmas, expected.sigmas)


@pytest.mark.parametrize("turn", BOX.turns[::5])
def test_code_of_a_box_takes_the_names_of_another(turn):
    rng = np.random.default_rng(5)
    code = replace(make_code(random_transform(rng), "box"), sigmas=np.full(6, np.pi))
    template = landmark_template(len(code.z))
    landmarks = code.center + template @ (code.axes @ turn).T
    renamed = replace(code, z=np.concatenate([landmarks, code.z[len(landmarks) :]]))
    np.testing.assert_allclose(renamed.named_like(code).z, code.z, atol=1e-12)
    np.testing.assert_allclose(renamed.center, code.center, atol=1e-12)


def test_code_that_tells_its_rotation_keeps_its_names():
    rng = np.random.default_rng(6)
    code = make_code(random_transform(rng))
    assert code.named_like(make_code(random_transform(rng))) is code


def test_transforming_there_and_back_gives_the_code_again():
    rng = np.random.default_rng(4)
    T, code = random_transform(rng), make_code(random_transform(rng))
    np.testing.assert_allclose(code.transformed(T).transformed(np.linalg.inv(T)).z, code.z, atol=1e-12)


def test_handle_direction_is_kept_at_right_angles_to_the_axis():
    sheared = np.eye(4)
    sheared[:3, 0] = [1.0, 0.2, 0.5]  # a network's axes are not exactly orthogonal
    R = make_code(sheared).T_frame_object[:3, :3]
    np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R[:, 2], [0, 0, 1], atol=1e-12)
    assert R[:, 0] @ sheared[:3, 0] > 0


@pytest.mark.parametrize(
    "axes",
    [np.zeros((3, 3)), np.outer([0, 0, 1], [1, 1, 1]), np.diag([1.0, 1.0, 0.0])],
    ids=["no extent", "handle along the axis", "no height"],
)
@pytest.mark.parametrize("ambiguous", [False, True])
def test_frame_of_a_degenerate_code_is_still_finite(axes, ambiguous):
    z = np.concatenate([landmark_template(16) @ axes.T, np.zeros((8, 3))])
    code = Code("mug", ambiguous, z, np.full(16, 0.25), np.full(6, 0.01))
    assert np.isfinite(code.T_frame_object).all()
