"""Solids against closed forms."""

import numpy as np
import pytest

from neuse.simulation.solids import lathe, rounded_polyline, sample_controls, sweep, to_trimesh


def test_lathe_of_a_rectangle_is_a_prism() -> None:
    mesh = to_trimesh(lathe(np.array([[0.03, 0.0], [0.03, 0.1]]), segments=48))
    area = 24 * 0.03**2 * np.sin(2 * np.pi / 48)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(area * 0.1, rel=1e-5)


def test_lathe_of_a_half_circle_is_nearly_a_ball() -> None:
    angle = np.linspace(-np.pi / 2, np.pi / 2, 80)[1:-1]
    mesh = to_trimesh(lathe(0.05 * np.stack([np.cos(angle), np.sin(angle)], axis=1), segments=96))
    assert mesh.volume == pytest.approx(4 / 3 * np.pi * 0.05**3, rel=5e-3)


def test_aspect_stretches_x_and_keeps_the_volume() -> None:
    profile = np.array([[0.03, 0.0], [0.03, 0.1]])
    round_solid, flat_solid = to_trimesh(lathe(profile)), to_trimesh(lathe(profile, aspect=1.3))
    assert flat_solid.extents[0] / flat_solid.extents[1] == pytest.approx(1.3, rel=1e-5)
    assert flat_solid.volume == pytest.approx(round_solid.volume, rel=1e-5)


def test_lathe_with_eight_sides_is_an_octagonal_prism_with_a_flat_to_x() -> None:
    mesh = to_trimesh(lathe(np.array([[0.03, 0.0], [0.03, 0.1]]), segments=64, sides=8))
    assert mesh.volume == pytest.approx(0.1 * 2 * np.sqrt(2) * 0.03**2, rel=1e-5)
    assert mesh.bounds[1, 0] == pytest.approx(0.03 * np.cos(np.pi / 8), rel=1e-5)


def test_straight_sweep_has_the_volume_of_its_section() -> None:
    mesh = to_trimesh(sweep(np.array([[0.0, 0.0], [0.1, 0.0]]), [0.01, 0.005], segments=200))
    assert mesh.volume == pytest.approx(np.pi * 0.01 * 0.005 * 0.1, rel=1e-3)
    np.testing.assert_allclose(mesh.extents, [0.1, 0.01, 0.02], rtol=1e-4)


def test_sweep_keeps_its_thickness_around_a_mitred_corner() -> None:
    path = np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.1]])
    mesh = to_trimesh(sweep(path, [0.01, 0.005], squareness=60.0, segments=8))
    section = mesh.section(plane_origin=[0.05, 0, 0], plane_normal=[1, 0, 0])
    assert mesh.is_volume
    assert np.ptp(section.vertices[:, 2]) == pytest.approx(0.02, rel=1e-3)
    assert mesh.bounds[1, 0] == pytest.approx(0.11, rel=1e-3)


def test_unrounded_polyline_is_unchanged() -> None:
    corners = np.array([[0, 0], [1, 0], [1, 2.0]])
    np.testing.assert_allclose(rounded_polyline(corners, 0.0), corners)


def test_rounding_starts_at_its_distance_and_stays_inside_the_corner() -> None:
    points = rounded_polyline([[0, 0], [1, 0], [1, 2.0]], 0.25)
    np.testing.assert_allclose(points[[0, 1, -2, -1]], [[0, 0], [0.75, 0], [1, 0.25], [1, 2]])
    assert np.all(points[2:-2, 0] < 1)
    assert np.all(points[2:-2, 1] > 0)


def test_rounding_takes_at_most_half_a_side() -> None:
    points = rounded_polyline([[0, 0], [1, 0], [1, 2.0]], np.inf)
    np.testing.assert_allclose(points[[0, 1, -2, -1]], [[0, 0], [0.5, 0], [1, 1], [1, 2]])


def test_controls_are_drawn_within_their_ranges() -> None:
    controls = (((0, 1), (2, 3), (4, 4)), ((5, 6), (7, 7), (8, 9)))
    corners, rounding = sample_controls(controls, np.random.default_rng(0))
    drawn = np.column_stack([corners, rounding])
    low, high = np.moveaxis(np.array(controls, dtype=float), -1, 0)
    assert np.all((drawn >= low) & (drawn <= high))
