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

LYING_TILT_RAD = np.radians([30.0, 150.0])  # beyond it an object stands, on its bottom or on its head


def stable_poses(shape: Shape, rng: np.random.Generator) -> list[tuple[Array, str]]:
    """Poses T_table_object at rest: upright first, then lying in random order, each at random yaw.

    Lying: on a facet of the convex hull that has the centre of mass above it. The shape's origin is above the
    table's.
    """
    lying = rng.permutation(_lying_rotations(shape))
    kinds = ["upright", *["lying"] * len(lying)]
    yaws = rng.uniform(-np.pi, np.pi, size=len(kinds))
    poses = [_rest(shape, R, yaw, (0.0, 0.0)) for R, yaw in zip([np.eye(3), *lying], yaws, strict=True)]
    return list(zip(poses, kinds, strict=True))


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
    rotations = _lying_rotations(shape)
    if not len(rotations):
        raise DegenerateGeometryError(f"{shape.name} rests only upright; place it upright")
    return _rest(shape, rotations[rng.integers(len(rotations)) if rng else 0], yaw_rad, xy)


def _rest(shape: Shape, R_table_object: Array, yaw_rad: float, xy: ArrayLike) -> Array:
    R = Rotation.from_euler("z", yaw_rad).as_matrix() @ R_table_object
    return make_transform(R, [*np.asarray(xy, dtype=np.float64), -(shape.mesh.vertices @ R[2]).min()])


@lru_cache(maxsize=128)
def _lying_rotations(shape: Shape) -> Array:
    """(n, 3, 3) R_table_object of the lying poses, z axis of the object above +x, lowest first."""
    triangles, normals = _hull_triangles(shape.mesh)
    center = shape.mesh.center_mass
    distance = ((triangles[:, 0] - center) * normals).sum(axis=1)
    below_center = center + distance[:, None] * normals
    tilt = np.arccos(np.clip(-normals[:, 2], -1, 1))
    lies = (tilt > LYING_TILT_RAD[0]) & (tilt < LYING_TILT_RAD[1])
    stable = lies & _inside(triangles, normals, below_center)
    order = np.flatnonzero(stable)[np.argsort(distance[stable], kind="stable")]
    up = -normals[order]  # table z in the object frame
    ahead = np.array([0.0, 0.0, 1.0]) - up[:, 2:] * up  # table x: the object's axis, made level
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    return np.stack([ahead, np.cross(up, ahead), up], axis=1)


def _hull_triangles(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Triangles (n, 3, 3) of the convex hull and their outward normals (n, 3), without slivers."""
    hull = manifold3d.Manifold.hull_points(np.asarray(mesh.vertices, dtype=np.float32)).to_mesh()
    triangles = np.asarray(hull.vert_properties, dtype=np.float64)[np.asarray(hull.tri_verts)]
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    doubled_area = np.linalg.norm(normals, axis=1)
    kept = doubled_area > 1e-9
    return triangles[kept], normals[kept] / doubled_area[kept, None]


def _inside(triangles: Array, normals: Array, points: Array) -> Array:
    """Which points (n, 3) lie in their own triangle (n, 3, 3), in whose plane they are."""
    edges = np.roll(triangles, -1, axis=1) - triangles
    sides = np.cross(edges, points[:, None] - triangles)
    return (np.einsum("fij,fj->fi", sides, normals) >= 0).all(axis=1)
