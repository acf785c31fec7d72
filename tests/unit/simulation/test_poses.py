"""Shapes at rest on the table."""

import numpy as np
import pytest
import trimesh

from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, make_transform, transform_points
from neuse.simulation.poses import lying_rotations, place
from neuse.simulation.shapes import Shape, make_shape, sample_shape


@pytest.fixture(
    scope="module", params=[(category, seed) for category in ("mug", "bottle") for seed in range(8)]
)
def shape(request: pytest.FixtureRequest) -> Shape:
    category, seed = request.param
    return sample_shape(category, np.random.default_rng(seed), "test")


def lowest(shape: Shape, T_table_object: Array) -> float:
    return float(transform_points(T_table_object, shape.mesh.vertices)[:, 2].min())


def lying_poses(shape: Shape) -> list[Array]:
    """T_table_object of all of them."""
    return [
        make_transform(R, [0.0, 0.0, -(shape.mesh.vertices @ R[2]).min()]) for R in lying_rotations(shape)
    ]


def test_every_shape_stands_and_lies_on_the_table(shape: Shape) -> None:
    assert place(shape, "upright", 0.0, (0.0, 0.0))[2, 2] == pytest.approx(1.0)
    for kind in ("upright", "lying"):
        assert lowest(shape, place(shape, kind, 0.0, (0.0, 0.0))) == pytest.approx(0.0, abs=1e-6)
    assert np.abs([R[2, 2] for R in lying_rotations(shape)]).max() < 0.9


def test_center_of_mass_is_above_the_hull_of_the_contact(shape: Shape) -> None:
    for T in lying_poses(shape):
        points = transform_points(T, shape.mesh.vertices)
        contact = points[points[:, 2] < 1e-4][:, :2]
        assert len(contact) >= 3
        offset = contact - transform_points(T, shape.mesh.center_mass)[:2]
        directions = np.stack([np.cos(np.arange(24) * np.pi / 12), np.sin(np.arange(24) * np.pi / 12)])
        assert np.all((offset @ directions).max(axis=0) > -1e-4)


def test_shape_with_a_heavy_side_rolls_onto_it() -> None:
    body = trimesh.creation.cylinder(radius=0.04, height=0.1, sections=64)
    weight = trimesh.creation.box([0.03, 0.02, 0.06]).apply_translation([0.045, 0, 0])
    shape = make_shape("heavy", "mug", trimesh.boolean.union([body, weight]))
    lying = lying_poses(shape)
    assert {int(np.sign(T[2, 1])) for T in lying} >= {-1, 1}
    assert all(T[2, 0] < -0.3 for T in lying)


def test_bottle_may_lie_on_any_side() -> None:
    bottle = sample_shape("bottle", np.random.default_rng(7))
    lying = lying_poses(bottle)
    sides = np.sort([np.arctan2(T[2, 1], T[2, 0]) for T in lying])
    assert np.diff(sides).max() < 0.3


def test_lying_pose_without_a_generator_is_the_lowest(shape: Shape) -> None:
    lying = lying_poses(shape)
    heights = [transform_points(T, shape.mesh.center_mass)[2] for T in lying]
    T = place(shape, "lying", 0.3, (0.1, 0.2))
    assert transform_points(T, shape.mesh.center_mass)[2] == pytest.approx(min(heights), abs=1e-6)


@pytest.mark.parametrize(("kind", "axis"), [("upright", 0), ("lying", 2)])
def test_yaw_is_the_direction_of_the_handle_or_of_the_opening(shape: Shape, kind: str, axis: int) -> None:
    T = place(shape, kind, 0.7, (0.1, -0.2), np.random.default_rng(1))
    assert np.arctan2(T[1, axis], T[0, axis]) == pytest.approx(0.7)
    np.testing.assert_allclose(T[:2, 3], [0.1, -0.2])
    assert lowest(shape, T) == pytest.approx(0, abs=1e-9)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)


def test_generator_picks_among_the_lying_poses() -> None:
    mug = sample_shape("mug", np.random.default_rng(0))
    rng = np.random.default_rng(0)
    ups = {tuple(place(mug, "lying", 0.0, (0, 0), rng)[2, :3].round(6)) for _ in range(20)}
    assert len(ups) > 1


def test_unknown_kind_is_refused() -> None:
    with pytest.raises(InputError, match="floating"):
        place(sample_shape("mug", np.random.default_rng(0)), "floating", 0.0, (0, 0))


def test_shape_that_cannot_lie_is_refused_by_name() -> None:
    pyramid = trimesh.convex.convex_hull(
        [[0.1, 0, -0.01], [-0.05, 0.09, -0.01], [-0.05, -0.09, -0.01], [0, 0, 0.01]]
    )
    with pytest.raises(DegenerateGeometryError, match="pyramid"):
        place(make_shape("pyramid", "mug", pyramid), "lying", 0.0, (0, 0))
