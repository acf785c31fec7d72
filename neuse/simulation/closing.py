"""Open meshes as solids: the space that a surface walls in, and the surface itself as a thin wall.

Scanned and modelled meshes often have holes, doubled faces, or walls of a single sheet, and bound nothing.
What can be reached from outside without coming near the surface is outside; all else is solid.
"""

import manifold3d
import numpy as np
import trimesh
from scipy.ndimage import binary_dilation, distance_transform_edt, label
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes

from neuse.errors import MeshError
from neuse.geometry import Array

CELLS = 120  # along the longest side
WALL_CELLS = 0.75  # from a sheet to either face of the wall that it becomes
SEAL_CELLS = 1.0  # no way leads through a surface for what stays as far away from it
LEAST_FLATNESS = 0.02
_BORDER_CELLS = 3
_FAR_CELLS = 3.0
_SAMPLES_PER_CELL, _MOST_SAMPLES = 8, 3_000_000  # on a cell's face; in all, of surfaces in many layers
_NEIGHBOURS = np.ones((3, 3, 3), dtype=bool)


def solid_of(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A closed mesh of an open one: what it encloses, and its sheets as walls, thick by WALL_CELLS each way.

    Raises:
        MeshError: it is flat, and so no surface of a solid.
    """
    size_m = float(mesh.extents.max())
    if mesh.extents.min() < LEAST_FLATNESS * size_m:
        raise MeshError(f"a surface of {mesh.extents.round(4)} m is flat and bounds no solid")
    cell_m = size_m / CELLS
    origin = mesh.bounds[0] - _BORDER_CELLS * cell_m
    vertices, faces, _, _ = marching_cubes(_signed(_distance(mesh, origin, cell_m)), 0.0)
    return _simplified(vertices * cell_m + origin, faces, cell_m)


def _distance(mesh: trimesh.Trimesh, origin: Array, cell_m: float) -> Array:
    """Of each point of a grid from the surface, in cells, up to _FAR_CELLS."""
    n_samples = int(min(_SAMPLES_PER_CELL * mesh.area / cell_m**2, _MOST_SAMPLES))
    points, _ = trimesh.sample.sample_surface(mesh, n_samples, seed=0)
    samples = (np.asarray(points) - origin) / cell_m
    shape = np.ceil(mesh.extents / cell_m).astype(int) + 2 * _BORDER_CELLS + 1
    touched = np.zeros(shape, dtype=bool)
    touched[tuple(samples.round().astype(int).T)] = True
    near = np.argwhere(binary_dilation(touched, _NEIGHBOURS, iterations=2))
    distance = np.full(shape, _FAR_CELLS)
    distance[tuple(near.T)], _ = cKDTree(samples).query(near, distance_upper_bound=_FAR_CELLS)
    return np.minimum(distance, _FAR_CELLS)


def _signed(distance: Array) -> Array:
    """The distance from the solid, in cells, negative within it.

    Near the surface a point lies on that side, outside or enclosed, which is nearer.
    """
    clear = distance > SEAL_CELLS
    parts, _ = label(clear)
    nearest = distance_transform_edt(~clear, return_distances=False, return_indices=True)
    enclosed = (clear & (parts != parts[0, 0, 0]))[tuple(nearest)]
    is_sheet = ~binary_dilation(enclosed, _NEIGHBOURS, iterations=2)
    signed = np.where(is_sheet, distance - WALL_CELLS, np.where(enclosed, -distance, distance))
    parts, _ = label(signed > 0)
    return np.where(parts == parts[0, 0, 0], signed, -np.abs(signed))  # no bubbles within walls


def _simplified(vertices: Array, faces: Array, cell_m: float) -> trimesh.Trimesh:
    """The mesh with triangles merged where that moves the surface by less than a tenth of a cell."""
    raw = manifold3d.Mesh(vertices.astype(np.float32), faces.astype(np.uint32))
    light = manifold3d.Manifold(raw).simplify(0.1 * cell_m).to_mesh()
    return trimesh.Trimesh(light.vert_properties[:, :3], light.tri_verts, process=False)
