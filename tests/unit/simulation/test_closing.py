"""Open meshes become solids that look as they did."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from neuse.errors import MeshError
from neuse.simulation.closing import CELLS, WALL_CELLS, solid_of
from neuse.simulation.shapes import sample_shape


@pytest.fixture(scope="module")
def mug() -> trimesh.Trimesh:
    return sample_shape("mug", np.random.default_rng(3), "train").mesh


def farthest_m(mesh: trimesh.Trimesh, other: trimesh.Trimesh) -> float:
    """How far the surface of a mesh is from that of another."""
    points, _ = trimesh.sample.sample_surface(mesh, 3000, seed=1)
    dense, _ = trimesh.sample.sample_surface(other, 300_000, seed=2)
    return float(np.percentile(cKDTree(dense).query(points)[0], 99))


def with_hole(mesh: trimesh.Trimesh, share: float) -> trimesh.Trimesh:
    """Without the triangles near one point of its side."""
    torn = mesh.copy()
    middle = torn.triangles_center[np.argmax(torn.triangles_center[:, 1])]
    distance = np.linalg.norm(torn.triangles_center - middle, axis=1)
    torn.update_faces(distance > share * torn.extents.max())
    return torn


def test_closed_mesh_stays_what_it_was(mug: trimesh.Trimesh) -> None:
    solid = solid_of(mug)
    assert solid.is_volume
    assert solid.volume == pytest.approx(mug.volume, rel=0.02)
    assert farthest_m(mug, solid) < 0.6 * mug.extents.max() / CELLS


def test_doubled_and_disconnected_faces_bound_the_same_solid(mug: trimesh.Trimesh) -> None:
    soup = trimesh.Trimesh(
        mug.triangles.reshape(-1, 3), np.arange(3 * len(mug.faces)).reshape(-1, 3), process=False
    )
    doubled = trimesh.util.concatenate([soup, soup])
    doubled.faces[: len(soup.faces)] = doubled.faces[: len(soup.faces), ::-1]  # and turned inside out
    assert solid_of(doubled).volume == pytest.approx(mug.volume, rel=0.02)


def test_what_is_torn_becomes_thin_walls_about_the_same_surface(mug: trimesh.Trimesh) -> None:
    torn = with_hole(mug, 0.1)
    assert not torn.is_volume
    solid = solid_of(torn)
    assert solid.is_volume
    assert farthest_m(torn, solid) < 1.5 * WALL_CELLS * mug.extents.max() / CELLS
    assert farthest_m(solid, torn) < 1.5 * WALL_CELLS * mug.extents.max() / CELLS


def test_sheet_becomes_a_wall_of_even_thickness() -> None:
    bowl = trimesh.creation.icosphere(4, 0.05)
    bowl.update_faces(bowl.triangles_center[:, 2] < 0.0)
    cell_m = bowl.extents.max() / CELLS
    solid = solid_of(bowl)
    assert solid.is_volume
    assert solid.volume / bowl.area == pytest.approx(2 * WALL_CELLS * cell_m, rel=0.1)


def test_flat_surface_is_refused() -> None:
    square = trimesh.Trimesh([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]], [[0, 1, 2]])
    with pytest.raises(MeshError, match="is flat and bounds no solid"):
        solid_of(square)
