from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding.layouts import draw_layout
from neuse.embedding.views import (
    HALF_CAMERA,
    MAX_POINTS,
    POINT_UNIT_M,
    draw_camera,
    draw_view,
    handle_share,
)
from neuse.geometry import inverse, transform_points

from .conftest import CLEAN
from .tiny import block_bottle, block_mug, distance_to_surface


@pytest.fixture(scope="module")
def clean_views():
    """Views of a solid mug among clutter, without any fault, and the mug."""
    rng, mug = np.random.default_rng(3), block_mug()
    layout = draw_layout(mug, [block_bottle()], rng, CLEAN.clutter)
    drawn = [draw_view(layout, rng, CLEAN) for _ in range(8)]
    return [view for view in drawn if view is not None], mug


def points_object(view):
    points_camera = view["points"] * POINT_UNIT_M + view["partial_center"]
    return transform_points(inverse(view["T_camera_object"].astype(float)), points_camera)


def test_points_of_a_view_without_faults_lie_on_the_object(clean_views):
    drawn, mug = clean_views
    assert len(drawn) >= 4
    for view in drawn:
        assert distance_to_surface(mug.mesh, points_object(view)[::16]).max() < 2e-4


def test_points_of_a_view_lie_in_front_of_the_camera(clean_views):
    for view in clean_views[0]:
        assert (view["points"] * POINT_UNIT_M + view["partial_center"])[:, 2].min() > 0.1


def test_partial_centre_is_the_mean_of_what_was_seen(clean_views):
    for view in clean_views[0]:
        n = int(view["n_points"])
        if n <= MAX_POINTS:
            np.testing.assert_allclose(view["points"][:n].mean(axis=0) * POINT_UNIT_M, 0.0, atol=1e-4)


def test_visible_share_is_a_share(clean_views):
    for view in clean_views[0]:
        assert 0.0 < view["visible"] <= 1.1  # counted on every third row and column


def test_faults_move_points_off_the_surface():
    rng, mug = np.random.default_rng(4), block_mug()
    noisy = replace(CLEAN, fixed_noise_m=0.003)
    view = draw_view(draw_layout(mug, [block_bottle()], rng, noisy.clutter), rng, noisy)
    error = distance_to_surface(mug.mesh, points_object(view)[::8])
    assert 0.001 < np.sqrt(np.mean(error**2)) < 0.0035
    assert view["noise_m"] == pytest.approx(0.003)


def test_view_of_too_few_points_is_none():
    rng = np.random.default_rng(5)
    far = replace(CLEAN, range_m=(40.0, 41.0))
    layout = draw_layout(block_mug(), [block_bottle()], rng, far.clutter)
    assert draw_view(layout, rng, far) is None


def test_object_that_reaches_to_the_lens_gives_no_view():
    """Its outline in the image would have no end."""
    rng = np.random.default_rng(5)
    close = replace(CLEAN, range_m=(0.06, 0.07))
    layout = draw_layout(block_mug(), [block_bottle()], rng, close.clutter)
    assert [draw_view(layout, rng, close) for _ in range(20)] == 20 * [None]


@pytest.mark.parametrize("seed", range(5))
def test_camera_sees_the_origin_at_its_range_and_elevation(seed):
    rng = np.random.default_rng(seed)
    azimuth, elevation, range_m = rng.uniform(0, 6.2), rng.uniform(-0.2, 1.4), rng.uniform(0.3, 5.0)
    T_camera_world = draw_camera(azimuth, elevation, range_m, rng)
    assert np.linalg.norm(T_camera_world[:3, 3]) == pytest.approx(range_m)
    x, y, z = inverse(T_camera_world)[:3, 3]
    assert z == pytest.approx(range_m * np.sin(elevation))
    assert np.arctan2(y, x) % (2 * np.pi) == pytest.approx(azimuth)
    assert HALF_CAMERA.window_around(T_camera_world[None, :3, 3]) is not None


def test_handle_share_counts_points_beyond_the_body():
    mug = block_mug()
    on_body, on_handle = [0.04, 0.0, 0.0], [0.06, 0.0, 0.0]
    assert handle_share(mug, np.array([on_body, on_body, on_body, on_handle])) == 0.25
    assert handle_share(mug, np.empty((0, 3))) == 0.0
    assert handle_share(block_bottle(), np.array([on_handle])) == 0.0
