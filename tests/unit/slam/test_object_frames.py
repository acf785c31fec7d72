"""Reduction of codes to object frames."""

from dataclasses import fields, replace

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.object_frames import SigmaParams, frames_at, is_usable, join_frames, reduce_codes, skews

from .synthetic import make_code, make_thing

SIGMAS = np.array([0.03, 0.02, 0.1, 0.003, 0.004, 0.005])


@pytest.fixture
def codes():
    rng = np.random.default_rng(0)
    made = [make_thing(i, i % 2 == 1, rng.normal(size=3), rng) for i in range(4)]
    return [make_code(thing, exp(rng.normal(size=6)) @ thing.T_world_object, SIGMAS) for thing in made]


def test_frames_are_those_of_the_codes(codes):
    frames = reduce_codes(codes)
    for i, code in enumerate(codes):
        np.testing.assert_allclose(frames.centers[i], code.center)
        np.testing.assert_allclose(frames.axes[i], code.T_frame_object[:3, 2])
        if not code.ambiguous:
            np.testing.assert_allclose(frames.vectors[2, i], code.T_frame_object[:3, 0])


def test_vectors_to_the_handle_are_orthogonal_to_the_axes(codes):
    frames = reduce_codes(codes)
    np.testing.assert_allclose((frames.axes * frames.vectors[2]).sum(axis=1), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(frames.vectors[2], axis=1), 1.0)


def test_noise_is_the_derivative_by_the_object_frame(codes):
    frames = reduce_codes(codes[:1], SigmaParams(1.0, 0.0, 0.0))
    T, step = codes[0].T_frame_object, 1e-6
    for column in range(6):
        moved = T @ exp(step * np.eye(6)[column])
        change = np.stack([moved[:3, 3] - T[:3, 3], moved[:3, 2] - T[:3, 2], moved[:3, 0] - T[:3, 0]]) / step
        np.testing.assert_allclose(frames.noise[:, 0, :, column], change * SIGMAS[column], atol=1e-6)


def test_sigmas_are_scaled_and_have_a_floor(codes):
    frames = reduce_codes(codes, SigmaParams(scale=2.0, rotation_floor_rad=0.5, translation_floor_m=0.0))
    np.testing.assert_allclose(frames.sigmas[0, :3], np.hypot(2 * SIGMAS[:3], 0.5))
    np.testing.assert_allclose(frames.sigmas[0, 3:], 2 * SIGMAS[3:])
    assert np.isinf(frames.variances[2, 1])


def test_code_without_handle_direction_still_gives_a_frame(codes):
    flat = replace(codes[0], z=np.tile(codes[0].center, (len(codes[0].z), 1)))
    assert np.isfinite(reduce_codes([flat]).vectors).all()


def test_codes_of_different_size_reduce_together(codes):
    rng = np.random.default_rng(1)
    larger = replace(codes[0], z=rng.normal(size=(128, 3)))
    frames = reduce_codes([codes[1], larger])
    np.testing.assert_allclose(frames.centers[1], larger.center)
    np.testing.assert_allclose(frames.axes[1], larger.T_frame_object[:3, 2])


def test_joining_parts_undoes_taking_them_apart(codes):
    frames = reduce_codes(codes)
    joined = join_frames([frames[[0, 1]], frames[np.array([False, False, True, True])]])
    for name in (field.name for field in fields(frames)):
        np.testing.assert_array_equal(getattr(joined, name), getattr(frames, name))


def half_hidden(code, correlation, error_m):
    """A code whose half height is wrong by error_m, with the centre as the correlation says."""
    moved = np.eye(4)
    axis = code.T_frame_object[:3, 2]
    moved[:3, 3] = correlation * error_m * axis
    stretched = code.z + error_m / code.half_height * ((code.z - code.center) @ axis)[:, None] * axis
    return replace(code, z=stretched, height_correlation=correlation).transformed(moved)


@pytest.mark.parametrize("correlation", [-1.0, 1.0])
def test_an_end_that_is_seen_tells_the_centre_once_the_height_is_known(codes, correlation):
    true = reduce_codes(codes)
    wrong = reduce_codes([half_hidden(code, correlation, 0.03) for code in codes])
    assert np.abs(wrong.centers - true.centers).max() > 0.01
    told = wrong.given_heights(true.half_heights, np.zeros(4))
    np.testing.assert_allclose(told.centers, true.centers, atol=1e-12)
    assert (told.sigmas[:, 5] < 0.2 * wrong.sigmas[:, 5]).all()
    np.testing.assert_array_equal(told.sigmas[:, :5], wrong.sigmas[:, :5])


def test_heights_that_are_not_known_or_tell_nothing_move_no_centre(codes):
    wrong = reduce_codes([half_hidden(code, -1.0, 0.03) for code in codes])
    other = wrong.half_heights + 0.05
    np.testing.assert_allclose(wrong.given_heights(other, np.full(4, 1e9)).centers, wrong.centers, atol=1e-9)
    free = reduce_codes(codes)
    np.testing.assert_array_equal(free.given_heights(other, np.zeros(4)).centers, free.centers)
    np.testing.assert_allclose(free.given_heights(other, np.zeros(4)).sigmas, free.sigmas)


def test_frames_at_places_have_the_given_sigmas(codes):
    frames = reduce_codes(codes)
    placed = frames_at(frames.vectors, SIGMAS, frames.ambiguous, frames.half_heights)
    np.testing.assert_array_equal(placed.sigmas, np.tile(SIGMAS, (4, 1)))
    own = SIGMAS * np.arange(1, 5)[:, None]
    placed = frames_at(frames.vectors, own, frames.ambiguous, frames.half_heights)
    np.testing.assert_array_equal(placed.sigmas, own)


def test_axis_as_uncertain_as_any_is_not_told(codes):
    assert reduce_codes(codes).tell_axes.all()
    box = replace(codes[0], sigmas=np.array([np.pi, np.pi, np.pi, 0.001, 0.001, 0.001]))
    assert reduce_codes([box, codes[1]], SigmaParams(scale=1.0)).tell_axes.tolist() == [False, True]


@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["z", "descriptor", "sigmas"])
def test_code_with_a_number_that_is_not_finite_is_unusable(codes, name, value):
    broken = np.array(getattr(codes[0], name))
    broken.flat[0] = value
    assert is_usable(codes[0])
    assert not is_usable(replace(codes[0], **{name: broken}))


def test_code_with_a_sigma_of_zero_is_unusable(codes):
    assert not is_usable(replace(codes[0], sigmas=np.zeros(6)))


def test_skews_are_cross_products():
    rng = np.random.default_rng(2)
    v, w = rng.normal(size=(2, 5, 3))
    np.testing.assert_allclose((skews(v) @ w[..., None])[..., 0], np.cross(v, w))
