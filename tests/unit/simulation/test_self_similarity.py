"""Symmetries of meshes in any orientation."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from neuse.geometry import make_transform
from neuse.simulation.self_similarity import find_symmetry, symmetry_of_mesh
from neuse.simulation.shapes import sample_shape, symmetry_of
from neuse.symmetry import AXIAL, BOX, HALF_TURN, NONE, QUARTER_TURN


def pot(n_handles: int) -> trimesh.Trimesh:
    """A tapered body with handles all around."""
    body = trimesh.creation.revolve([[0, 0], [0.07, 0], [0.09, 0.12], [0, 0.12]], sections=64)
    handles = []
    for i in range(n_handles):
        handle = trimesh.creation.box((0.06, 0.03, 0.015)).apply_translation([0.1, 0, 0.09])
        handles.append(
            handle.apply_transform(
                trimesh.transformations.rotation_matrix(2 * np.pi * i / n_handles, [0, 0, 1])
            )
        )
    return trimesh.boolean.union([body, *handles])


SHAPES = {
    "can": (trimesh.creation.cylinder(radius=0.04, height=0.12, sections=48), AXIAL),
    "funnel": (trimesh.creation.cone(radius=0.05, height=0.1, sections=48), AXIAL),
    "carton": (trimesh.creation.box((0.06, 0.1, 0.2)), BOX),
    "cube": (trimesh.creation.box((0.1, 0.1, 0.1)), BOX),
    "pyramid": (trimesh.creation.cone(radius=0.08, height=0.12, sections=4), QUARTER_TURN),
    "pan": (pot(1), NONE),
    "pot": (pot(2), HALF_TURN),
    "crown": (pot(4), QUARTER_TURN),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_symmetry_is_found_in_any_orientation(name: str) -> None:
    mesh, expected = SHAPES[name]
    T = make_transform(Rotation.random(random_state=len(name)).as_matrix(), np.ones(3))
    assert symmetry_of_mesh(mesh.copy().apply_transform(T)) is expected


@pytest.mark.parametrize("category", ["mug", "bottle", "bowl", "box"])
def test_simulated_shapes_have_the_symmetry_of_their_category(category: str) -> None:
    meshes = [sample_shape(category, np.random.default_rng(seed)).mesh for seed in range(3)]
    assert find_symmetry(meshes) is symmetry_of(category)


def test_most_of_the_meshes_decide() -> None:
    can, pan = SHAPES["can"][0], SHAPES["pan"][0]
    assert find_symmetry([can, pan, can]) is AXIAL
    assert find_symmetry([can, pan]) is NONE
