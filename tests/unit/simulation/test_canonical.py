"""Canonical frames of meshes in any orientation, against the frame in which they were made."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, make_transform, rotation_angle
from neuse.simulation.canonical import canonical_frame
from neuse.simulation.shapes import sample_shape, symmetry_of
from neuse.symmetry import AXIAL, BOX, HALF_TURN, NONE, QUARTER_TURN, Symmetry

N_SEEDS = 24
Y_UP = make_transform(Rotation.from_euler("x", -90, degrees=True).as_matrix(), np.zeros(3))


def frame_error(category: str, seed: int, T_mesh_object: Array) -> Array:
    """T from the true object frame to the one that was found."""
    mesh = sample_shape(category, np.random.default_rng(seed), "test").mesh.copy()
    return canonical_frame(mesh.apply_transform(T_mesh_object), symmetry_of(category)) @ T_mesh_object


def random_transform(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return make_transform(Rotation.random(random_state=seed).as_matrix(), rng.normal(size=3))


def test_mugs_in_any_orientation_get_their_frame() -> None:
    errors = [frame_error("mug", seed, random_transform(seed)) for seed in range(N_SEEDS)]
    right = [rotation_angle(T[:3, :3]) < np.radians(2) and np.linalg.norm(T[:3, 3]) < 1e-3 for T in errors]
    assert np.mean(right) >= 0.95


def test_bottles_in_any_orientation_get_their_axis_and_their_neck_up() -> None:
    errors = [frame_error("bottle", seed, random_transform(seed)) for seed in range(N_SEEDS)]
    right = [T[2, 2] > np.cos(np.radians(2)) and np.linalg.norm(T[:3, 3]) < 2e-3 for T in errors]
    assert np.mean(right) >= 0.95


@pytest.mark.parametrize("seed", range(4))
def test_mug_with_y_up_gets_its_frame(seed: int) -> None:
    assert rotation_angle(frame_error("mug", seed, Y_UP)[:3, :3]) < np.radians(2)


def test_bowls_open_upwards() -> None:
    errors = [frame_error("bowl", seed, random_transform(seed)) for seed in range(8)]
    assert all(T[2, 2] > np.cos(np.radians(2)) and np.linalg.norm(T[:3, 3]) < 2e-3 for T in errors)


def test_boxes_lie_along_their_edges_the_longest_upright() -> None:
    for seed in range(8):
        mesh = sample_shape("box", np.random.default_rng(seed)).mesh.copy()
        sizes = np.sort(mesh.extents)
        T_mesh_object = random_transform(seed)
        found = mesh.apply_transform(T_mesh_object).apply_transform(canonical_frame(mesh, BOX))
        np.testing.assert_allclose(found.extents, sizes, atol=2e-3)
        np.testing.assert_allclose(found.bounds.mean(axis=0), 0, atol=1e-4)


@pytest.mark.parametrize(("sections", "symmetry"), [(4, QUARTER_TURN), (2, HALF_TURN)])
def test_what_stands_out_of_the_body_lies_on_an_axis(sections: int, symmetry: Symmetry) -> None:
    body = trimesh.creation.cylinder(radius=0.05, height=0.1, sections=64)
    bars = [trimesh.creation.box((0.18, 0.02, 0.02)), trimesh.creation.box((0.02, 0.18, 0.02))]
    mesh = trimesh.boolean.union([body, *bars[: sections // 2]]).apply_translation([0, 0, 0.1])
    cone = trimesh.creation.cylinder(radius=0.03, height=0.1, sections=64).apply_translation([0, 0, 0.19])
    mesh = trimesh.boolean.union([mesh, cone])
    T = random_transform(sections)
    found = mesh.apply_transform(T).apply_transform(canonical_frame(mesh, symmetry))
    assert found.extents[0] == pytest.approx(0.18, abs=2e-3)
    assert found.bounds[1, 2] == pytest.approx(-found.bounds[0, 2], abs=1e-4)


def test_size_and_place_of_the_mesh_do_not_matter() -> None:
    mesh = sample_shape("mug", np.random.default_rng(2)).mesh
    large = mesh.copy().apply_scale(10.0).apply_translation([5, -3, 1])
    R_small, R_large = (canonical_frame(m, NONE)[:3, :3] for m in (mesh, large))
    assert rotation_angle(R_small @ R_large.T) < np.radians(0.5)


def test_cylinder_gets_its_axis_and_its_middle() -> None:
    cylinder = trimesh.creation.cylinder(radius=0.03, height=0.2, sections=48)
    cylinder.apply_translation([0.1, 0.2, 0.3])
    T_object_mesh = canonical_frame(cylinder, AXIAL)
    assert abs(T_object_mesh[2, 2]) == pytest.approx(1, abs=1e-5)
    np.testing.assert_allclose(T_object_mesh @ [0.1, 0.2, 0.3, 1], [0, 0, 0, 1], atol=2e-4)
