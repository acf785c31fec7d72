import numpy as np
import pytest
import trimesh

from neuse.evaluation.render import ColoredMesh, View, render, view_from_above, view_obliquely
from neuse.geometry import Array, make_transform

RED = (1.0, 0.0, 0.0)


def _ball(x: float, y: float = 0.0, radius: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(3, radius).apply_translation([x, y, radius])


def _is_red(picture: np.ndarray) -> np.ndarray:
    return (picture[..., 0] > 60) & (picture[..., 1] < 20)


def test_picture_from_above_has_x_to_the_right_and_y_up() -> None:
    view = view_from_above(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 0.2]]), 0.0, 100)
    rows, columns = np.nonzero(_is_red(render([ColoredMesh(_ball(0.75, 0.75), RED)], view)))
    assert view.shape_px == (200, 200)
    assert (columns.mean(), rows.mean()) == (pytest.approx(74.5, abs=1), pytest.approx(24.5, abs=1))


def test_size_in_the_picture_is_the_size_in_metres() -> None:
    view = view_from_above(np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 0.2]]), 0.0, 400)
    area_m2 = _is_red(render([ColoredMesh(_ball(0.0), RED)], view)).sum() / 400**2
    assert area_m2 == pytest.approx(np.pi * 0.1**2, rel=0.03)


@pytest.mark.parametrize("azimuth", [0.0, 1.0, -2.5])
def test_oblique_view_shows_all_points_and_wastes_no_width(azimuth: float) -> None:
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    view = view_obliquely(points, azimuth, 0.7, 0.0, 320)
    pixels = view.project(points)
    assert view.shape_px[1] == 640
    np.testing.assert_allclose([pixels[:, 0].min(), pixels[:, 0].max()], [-0.5, 319.5], atol=1e-6)
    np.testing.assert_allclose(
        [pixels[:, 1].min(), pixels[:, 1].max()], [-0.5, view.shape_px[0] / 2 - 0.5], atol=1
    )


def test_projection_is_where_the_ray_caster_draws() -> None:
    mesh = _ball(0.3, -0.2, 0.02)
    view = view_obliquely(np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 0.3]]), -1.1, 0.6, 0.1, 400)
    rows, columns = np.nonzero(_is_red(render([ColoredMesh(mesh, RED)], view)))
    np.testing.assert_allclose(
        [columns.mean(), rows.mean()], view.project(mesh.bounds.mean(axis=0)[None])[0], atol=1
    )


def test_object_casts_a_shadow_on_the_plane() -> None:
    view = view_from_above(np.array([[-0.5, -0.5, 0.0], [0.5, 0.5, 0.2]]), 0.0, 100)
    empty, full = render([], view, 0.0), render([ColoredMesh(_ball(0.0), RED)], view, 0.0)
    shadow = (full.astype(int) < empty.astype(int) - 20).all(axis=-1) & ~_is_red(full)
    assert shadow.sum() > 50


def test_nearer_object_hides_the_farther_one() -> None:
    view = view_from_above(np.array([[-0.2, -0.2, 0.0], [0.2, 0.2, 1.0]]), 0.0, 100)
    below, above = _ball(0.0), _ball(0.0).apply_translation([0, 0, 0.5])
    picture = render([ColoredMesh(below, (0.0, 1.0, 0.0)), ColoredMesh(above, RED)], view)
    assert _is_red(picture)[20, 20]


def test_nothing_to_draw_gives_a_white_picture() -> None:
    view = View(make_transform(np.eye(3), np.zeros(3)), (0.3, 0.2), 100)
    picture: Array = render([], view)
    assert picture.shape == (20, 30, 3)
    assert (picture == 255).all()
