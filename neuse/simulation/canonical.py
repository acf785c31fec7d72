"""The object frame of a mesh in any orientation: its axis of revolution, its opening and its handle."""

from itertools import pairwise

import numpy as np
import trimesh
from numpy.typing import ArrayLike
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, make_transform, transform_points
from neuse.symmetry import BOX, Symmetry

N_SAMPLES = 3000
N_STARTS, N_REFINED = 20, 3  # axes tried, and how many of them are refined
N_ROWS, N_COLUMNS = 16, 36
CAVITY_SHARE = 0.25  # of the height: what opens deeper at one end than at the other is a cavity
END_SHARE = 0.2  # of the height, by which the ends of a solid are compared
TANGENTIAL_SCALE = 0.1  # of a normal's tangential part, beyond which a point is rather no part of the body


def canonical_frame(mesh: trimesh.Trimesh, symmetry: Symmetry) -> Array:
    """T_object_mesh of a closed mesh, in the object frame of `neuse.simulation.shapes.Shape`.

    A box lies along its edges. Of all others the axis is the one about which the surface is most nearly one
    of revolution; its upper end is where a cavity opens, or else the narrower end. x points to where the
    surface stands out of the body; if it is much the same all around, anywhere.
    """
    if symmetry is BOX:
        return box_frame(mesh)
    T_object_mesh = axis_frame(mesh)
    if not _is_upright(mesh.copy().apply_transform(T_object_mesh)):
        T_object_mesh = np.diag([1.0, -1.0, -1.0, 1.0]) @ T_object_mesh
    if not symmetry.ambiguous:
        points, _ = _sample(mesh)
        azimuth = _handle_azimuth(transform_points(T_object_mesh, points), len(symmetry.turns))
        T_object_mesh = _turn_about_z(-azimuth) @ T_object_mesh
    heights = transform_points(T_object_mesh, mesh.vertices)[:, 2]
    T_object_mesh[2, 3] -= (heights.min() + heights.max()) / 2
    return T_object_mesh


def axis_frame(mesh: trimesh.Trimesh) -> Array:
    """T_frame_mesh whose z axis is the best axis of revolution, either end up."""
    return _axis_frame(*_sample(mesh))


def box_frame(mesh: trimesh.Trimesh) -> Array:
    """T_frame_mesh of the smallest box around a mesh, its longest edge along z."""
    T_frame_mesh, _ = trimesh.bounds.oriented_bounds(mesh)
    return np.asarray(T_frame_mesh)


def _sample(mesh: trimesh.Trimesh) -> tuple[Array, Array]:
    """Points (n, 3) spread evenly over the surface, the same ones at each call, and their normals (n, 3)."""
    points, faces = trimesh.sample.sample_surface(mesh, N_SAMPLES, seed=0)
    return np.asarray(points), mesh.face_normals[faces]


def _turn_about_z(angle_rad: float) -> Array:
    return make_transform(Rotation.from_euler("z", angle_rad).as_matrix(), np.zeros(3))


def _axis_frame(points: Array, normals: Array) -> Array:
    """T_frame_mesh whose z axis is the best axis of revolution of points (n, 3) with normals (n, 3).

    All normals of a surface of revolution meet its axis, so that they have no part along its circles.
    """
    center, size = points.mean(axis=0), float(np.linalg.norm(np.ptp(points, axis=0)))
    inertia_axes = np.linalg.eigh(np.cov(points.T))[1].T
    starts = np.vstack([inertia_axes, np.eye(3), np.random.default_rng(0).normal(size=(N_STARTS, 3))])
    rotations = [_rotation_to_z(start) for start in starts]
    data = [((points - center) @ R.T / size, normals @ R.T) for R in rotations]
    costs = [np.minimum(np.abs(_tangential(np.zeros(4), *d)), 3 * TANGENTIAL_SCALE).sum() for d in data]
    tried = np.argsort(costs)[:N_REFINED]
    fits = [_fit_axis(*data[i]) for i in tried]
    best = int(np.argmin([fit.cost for fit in fits]))
    slope, foot = fits[best].x[:2], fits[best].x[2:]
    R_frame_start = _rotation_to_z([*slope, 1])
    R_frame_mesh = R_frame_start @ rotations[tried[best]]
    return make_transform(R_frame_mesh, -R_frame_mesh @ center - R_frame_start @ [*(size * foot), 0])


def _rotation_to_z(direction: ArrayLike) -> Array:
    return Rotation.align_vectors([0, 0, 1], direction)[0].as_matrix()


def _fit_axis(points: Array, normals: Array) -> OptimizeResult:
    """The axis near z, as `_tangential` has it, that most of the surface turns about."""
    return least_squares(
        _tangential, np.zeros(4), loss="cauchy", f_scale=TANGENTIAL_SCALE, args=(points, normals), max_nfev=30
    )


def _tangential(axis: Array, points: Array, normals: Array) -> Array:
    """Parts of the normals along the circles about an axis, (n,): zero for a surface of revolution.

    axis: (4,) slopes of the axis along x and y, and x and y of its foot in the plane z = 0.
    """
    slope_x, slope_y, foot_x, foot_y = axis
    x, y, z = points[:, 0] - foot_x, points[:, 1] - foot_y, points[:, 2]
    circles = np.stack([slope_y * z - y, x - slope_x * z, slope_x * y - slope_y * x], axis=1)
    return (normals * circles).sum(axis=1) / np.maximum(np.linalg.norm(circles, axis=1), 1e-9)


def _is_upright(mesh: trimesh.Trimesh) -> bool:
    """Whether rays down the z axis get deeper into the mesh than rays up, or else its top is narrower."""
    angle, radius = np.linspace(0, 2 * np.pi, 12, endpoint=False), 0.1 * mesh.extents.min()
    start = np.stack([radius * np.cos(angle), radius * np.sin(angle), np.zeros(12)], axis=1)
    from_above, from_below = (_median_depth(mesh, start, direction) for direction in (-1.0, 1.0))
    if abs(from_above - from_below) > CAVITY_SHARE * mesh.extents[2]:
        return from_above > from_below
    return _narrows_upwards(_sample(mesh)[0])


def _median_depth(mesh: trimesh.Trimesh, start: Array, direction: float) -> float:
    """How far beyond its box rays along z (direction -1 or 1) get until they meet the mesh; metres."""
    entry = mesh.bounds[1 if direction < 0 else 0, 2]
    origins = start + np.array([0, 0, entry - direction * mesh.extents[2]])
    locations, _, _ = mesh.ray.intersects_location(
        origins, np.tile([0, 0, direction], (12, 1)), multiple_hits=False
    )
    return (
        float(np.median((locations[:, 2] - entry) * direction)) if len(locations) else float(mesh.extents[2])
    )


def _narrows_upwards(points: Array) -> bool:
    """Whether the upper end is narrower than the lower end."""
    height = (points[:, 2] - points[:, 2].min()) / np.ptp(points[:, 2])
    radius = np.linalg.norm(points[:, :2], axis=1)
    edges = np.linspace(0, END_SHARE, 7)
    low, high = (_mean_radius(radius, share, edges) for share in (height, 1 - height))
    return high < low


def _mean_radius(radius: Array, share: Array, edges: Array) -> float:
    """Mean over slices of the outer radius, where `share` lies between consecutive edges."""
    slices = [radius[(share >= low) & (share < high)] for low, high in pairwise(edges)]
    return float(np.mean([np.percentile(part, 95) for part in slices if len(part)]))


def _handle_azimuth(points: Array, n_alike: int) -> float:
    """Direction about z, radians, in which points (n, 3) stand out of the round body, one of `n_alike`."""
    radius, azimuth = np.linalg.norm(points[:, :2], axis=1), np.arctan2(points[:, 1], points[:, 0])
    row = _bin(points[:, 2], N_ROWS)
    outline = np.zeros((N_ROWS, N_COLUMNS))
    np.maximum.at(outline, (row, _bin(azimuth, N_COLUMNS)), radius)
    body_radius = np.array([np.median(line[line > 0]) for line in outline])
    weight = np.maximum(radius - 1.1 * body_radius[row], 0) ** 2
    phase = n_alike * azimuth
    return float(np.arctan2(weight @ np.sin(phase), weight @ np.cos(phase))) / n_alike


def _bin(values: Array, count: int) -> np.ndarray:
    share = (values - values.min()) / np.ptp(values)
    return np.minimum((share * count).astype(int), count - 1)
