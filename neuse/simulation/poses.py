"""How objects stand and lie on a table: T_table_object, where z = 0 is the table and z points up."""

from functools import lru_cache

import manifold3d
import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, make_transform
from neuse.simulation.shapes import Shape

N_TILTS, TILT_RAD = 12, np.radians(20.0)
ROLL_TOLERANCE = 0.003  # change of height that a bottle's facets make when it rolls, of that height
LYING_TILT_RAD = np.radians([30.0, 150.0])  # beyond it an object stands, on its bottom or on its head


def place(
    shape: Shape, kind: str, yaw_rad: float, xy: ArrayLike, rng: np.random.Generator | None = None
) -> Array:
    """T_table_object of the shape at rest, its origin above `xy` (2,), metres, its lowest point at z = 0.

    yaw_rad: direction on the table of the object's x axis where upright, and of its z axis where lying.
    rng: picks one of several lying poses; without it the one with the lowest centre of mass is taken.

    Raises:
        InputError: an unknown kind.    DegenerateGeometryError: the shape has no lying pose.
    """
    if kind == "upright":
        return _rest(shape, np.eye(3), yaw_rad, xy)
    if kind != "lying":
        raise InputError("unknown_pose", f"unknown kind of pose {kind!r}; choose upright or lying")
    rotations = lying_rotations(shape)
    if not len(rotations):
        raise DegenerateGeometryError(f"{shape.name} rests only upright; place it upright")
    return _rest(shape, rotations[rng.integers(len(rotations)) if rng else 0], yaw_rad, xy)


def _rest(shape: Shape, R_table_object: Array, yaw_rad: float, xy: ArrayLike) -> Array:
    R = Rotation.from_euler("z", yaw_rad).as_matrix() @ R_table_object
    return make_transform(R, [*np.asarray(xy, dtype=np.float64), -(shape.mesh.vertices @ R[2]).min()])


@lru_cache(maxsize=128)
def lying_rotations(shape: Shape) -> Array:
    """(n, 3, 3) R_table_object of the lying poses, z axis of the object above +x, lowest first.

    On a facet of the convex hull that has the centre of mass above it; of these, where there are any, on
    those from which the shape does not roll away.
    """
    vertices, faces = _hull(shape.mesh)  # relative to the centre of mass
    down = _resting_directions(vertices[faces])
    tilt = np.arccos(np.clip(-down[:, 2], -1, 1))
    down = down[(tilt > LYING_TILT_RAD[0]) & (tilt < LYING_TILT_RAD[1])]
    steady = _springs_back(down, vertices)
    down = down[steady] if steady.any() else down
    up = -down[np.argsort((down @ vertices.T).max(axis=1), kind="stable")]  # table z in the object frame
    ahead = np.array([0.0, 0.0, 1.0]) - up[:, 2:] * up  # table x: the object's axis, made level
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack([ahead, np.cross(up, ahead), up], axis=1)


def _hull(mesh: trimesh.Trimesh) -> tuple[Array, np.ndarray]:
    """Vertices (n, 3) of the convex hull, relative to the mesh's centre of mass, and its triangles (m, 3)."""
    points = np.asarray(mesh.vertices - mesh.center_mass, dtype=np.float32)
    hull = manifold3d.Manifold.hull_points(points).to_mesh()
    return np.asarray(hull.vert_properties, dtype=np.float64), np.asarray(hull.tri_verts)


def _resting_directions(triangles: Array) -> Array:
    """Outward normals (k, 3) of the triangles (m, 3, 3) that have the origin's projection inside."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled_area = np.linalg.norm(normals, axis=1)
    whole = doubled_area > 1e-9
    triangles, normals = triangles[whole], normals[whole] / doubled_area[whole, None]
    foot = (triangles[:, 0] * normals).sum(axis=1, keepdims=True) * normals
    edges = np.roll(triangles, -1, axis=1) - triangles
    sides = np.einsum("fij,fj->fi", np.cross(edges, foot[:, None] - triangles), normals)
    return normals[(sides >= 0).all(axis=1)]


def _springs_back(down: Array, vertices: Array) -> np.ndarray:
    """From which down directions (k, 3) no tilt brings the centre of mass lower.

    A facet of a round body is an artefact: where the body would roll on, it is no place to rest.
    """
    across = np.cross(down, np.eye(3)[np.abs(down).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    azimuth = np.arange(N_TILTS)[:, None, None] * (2 * np.pi / N_TILTS)
    sideways = np.cos(azimuth) * across + np.sin(azimuth) * np.cross(down, across)  # (N_TILTS, k, 3)
    tilted = np.cos(TILT_RAD) * down + np.sin(TILT_RAD) * sideways
    height, tilted_height = (down @ vertices.T).max(axis=-1), (tilted @ vertices.T).max(axis=-1)
    return (tilted_height > height - ROLL_TOLERANCE * height).all(axis=0)
