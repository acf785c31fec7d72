"""Views of an object and their average."""

from dataclasses import replace

import numpy as np
import pytest

from neuse import geometry
from neuse.geometry import inverse
from neuse.mapping.views import average_codes, make_view, tells_shape

from .synthetic import make_code, standing

MUG = standing("mug", 0.2, 0.1, category="mug")
RNG = np.random.default_rng(0)


def poses(count, seed=0):
    rng = np.random.default_rng(seed)
    return np.stack([geometry.exp(rng.normal(size=6)) for _ in range(count)])


def views_from(T_world_cameras, noise_m=0.0):
    rng = np.random.default_rng(1)
    return [make_code(MUG, inverse(T) @ MUG.T_world_object, rng, noise_m) for T in T_world_cameras]


def test_average_of_exact_views_is_the_object():
    T = poses(5)
    code = average_codes(views_from(T), T, np.ones(5))
    np.testing.assert_allclose(code.T_frame_object, MUG.T_world_object, atol=1e-9)


def test_average_is_better_than_single_views():
    T = poses(16)
    views = views_from(T, noise_m=0.01)
    true_center = MUG.T_world_object[:3, 3]
    centers = [view.transformed(T_i).center for view, T_i in zip(views, T, strict=True)]
    mean = average_codes(views, T, np.ones(16)).center
    assert np.linalg.norm(mean - true_center) < np.linalg.norm(centers - true_center, axis=1).mean() / 2


def test_flipped_view_among_good_ones_hardly_counts():
    T = poses(6)
    views = views_from(T)
    upside_down = geometry.exp([np.pi, 0, 0, 0, 0, 0])
    views[2] = make_code(MUG, inverse(T[2]) @ MUG.T_world_object @ upside_down, RNG, 0.0)
    code = average_codes(views, T, np.ones(6))
    angle = geometry.rotation_angle(code.T_frame_object[:3, :3].T @ MUG.T_world_object[:3, :3])
    assert angle < 0.05


def test_average_of_boxes_does_not_depend_on_what_each_view_calls_its_edges():
    T = poses(6)
    untold = [replace(code, sigmas=np.full(6, np.pi)) for code in views_from(T)]
    named = [
        view.named_like(replace(view, z=view.z @ geometry.exp([1, 2, i, 0, 0, 0])[:3, :3]))
        for i, view in enumerate(untold)
    ]
    assert len({int(np.abs(view.axes).argmax()) for view in named}) > 1
    code = average_codes(named, T, np.ones(6))
    sizes = np.sort(np.linalg.norm(code.axes, axis=0))
    np.testing.assert_allclose(sizes, np.sort(np.linalg.norm(untold[0].axes, axis=0)), atol=1e-9)
    np.testing.assert_allclose(code.center, MUG.T_world_object[:3, 3], atol=1e-9)


def test_average_moves_with_the_frame():
    T, G = poses(4), geometry.exp([0.3, -0.2, 0.1, 1.0, 2.0, 3.0])
    views = views_from(T, noise_m=0.01)
    still = average_codes(views, T, np.ones(4)).transformed(G)
    moved = average_codes(views, G @ T, np.ones(4))
    np.testing.assert_allclose(moved.z, still.z, atol=1e-9)


def test_view_keeps_the_asked_number_of_points_and_drops_the_farthest():
    code = make_code(MUG, MUG.T_world_object, RNG, 0.0)
    near = code.center + RNG.normal(scale=0.02, size=(100, 3))
    stray = code.center + np.array([3.0, 0.0, 0.0]) + RNG.normal(scale=0.02, size=(10, 3))
    view = make_view(code, np.concatenate([near, stray]), np.eye(4), False, 48)
    assert len(view.points) == 48
    assert np.linalg.norm(view.points - code.center, axis=1).max() < 0.2


def test_view_without_points_has_its_centre():
    code = make_code(MUG, MUG.T_world_object, RNG)
    np.testing.assert_array_equal(
        make_view(code, np.zeros((0, 3)), np.eye(4), False, 8).points, [code.center]
    )


def test_view_that_the_border_cuts_weighs_less():
    code, cloud = make_code(MUG, MUG.T_world_object, RNG), RNG.normal(size=(20, 3))
    assert (
        make_view(code, cloud, np.eye(4), True, 8).weight < make_view(code, cloud, np.eye(4), False, 8).weight
    )


@pytest.mark.parametrize(("sigma_m", "tells"), [(0.001, True), (0.008, False)])
def test_view_with_a_well_known_centre_tells_the_shape(sigma_m, tells):
    code = replace(views_from(poses(1))[0], sigmas=np.full(6, sigma_m))
    assert tells_shape(code) is tells
