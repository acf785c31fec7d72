"""Closed solids from curves: rounded polylines, surfaces of revolution and sweeps."""

from collections.abc import Sequence

import manifold3d
import numpy as np
import trimesh
from numpy.typing import ArrayLike

from neuse.geometry import Array

Range = tuple[float, float]
Control = tuple[Range, Range, Range]  # ranges of the two coordinates and of the rounding of a corner

SAME_POINT_M = 1e-6


def sample_controls(controls: Sequence[Control], rng: np.random.Generator) -> tuple[Array, Array]:
    """One draw of a curve's corners, (n, 2), and of their roundings, (n,)."""
    low, high = np.array(controls).transpose(2, 0, 1)
    corners = rng.uniform(low, high)
    return corners[:, :2], corners[:, 2]


def rounded_polyline(corners: ArrayLike, rounding: ArrayLike, steps: int = 9) -> Array:
    """A polyline whose corners are replaced by parabolic arcs.

    Args:
        corners: (n, 2).    rounding: (n,) how far from a corner its arc starts, at most half of each adjacent
            side (so that infinity everywhere gives a quadratic B-spline); 0 keeps the corner. The ends stay.
    Returns:
        (m, 2) points without repetition.
    """
    corners = np.asarray(corners, dtype=np.float64)
    sides = np.diff(corners, axis=0)
    lengths = np.linalg.norm(sides, axis=1, keepdims=True)
    cut = np.broadcast_to(np.asarray(rounding, dtype=np.float64), len(corners))[1:-1, None]
    before, corner, after = (
        np.minimum(cut / lengths[:-1], 0.5),
        corners[1:-1],
        np.minimum(cut / lengths[1:], 0.5),
    )
    start, end = corner - before * sides[:-1], corner + after * sides[1:]
    t = np.linspace(0, 1, steps)[:, None, None]
    arcs = (1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end  # (steps, n - 2, 2)
    points = np.concatenate([corners[:1], arcs.transpose(1, 0, 2).reshape(-1, 2), corners[-1:]])
    distinct = np.linalg.norm(np.diff(points, axis=0), axis=1) > SAME_POINT_M
    return points[np.concatenate([[True], distinct])]


def lathe(profile: Array, segments: int = 64, aspect: ArrayLike = 1.0, sides: int = 0) -> manifold3d.Manifold:
    """The solid that a profile encloses when it turns about the z axis.

    Args:
        profile: (n, 2) radius and height, metres, upwards; the ends are closed by flat discs.
        aspect: ratio of x radius to y radius, one number or (n,).
        sides: 0 for circular cross-sections, else that many flat sides (one of them towards +x).
    """
    angle = np.arange(segments) * (2 * np.pi / segments)
    corner = (
        np.cos(np.pi / sides) / np.cos((angle + np.pi / sides) % (2 * np.pi / sides) - np.pi / sides)
        if sides
        else 1.0
    )
    ratio = np.sqrt(np.broadcast_to(np.asarray(aspect, dtype=np.float64), len(profile)))[:, None]
    radius = profile[:, :1] * corner
    height = np.broadcast_to(profile[:, 1:], (len(profile), segments))
    rings = np.stack([radius * ratio * np.cos(angle), radius / ratio * np.sin(angle), height], axis=-1)
    return _tube(rings)


def sweep(
    path: Array, half_sizes: ArrayLike, squareness: float = 2.0, segments: int = 20
) -> manifold3d.Manifold:
    """The solid that a super-elliptic section covers along a path in the x-z plane.

    Args:
        path: (n, 2) x and z, metres.    half_sizes: (n, 2) or (2,), metres, in the plane and along y.
        squareness: exponent of the section: 2 is an ellipse, 8 nearly a rectangle.
    """
    directions = np.diff(path, axis=0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mean = np.concatenate([directions[:1], directions[:-1] + directions[1:], directions[-1:]])
    mean /= np.linalg.norm(mean, axis=1, keepdims=True)
    mitre = 1.0 / np.maximum(
        (mean * np.concatenate([directions[:1], directions])).sum(axis=1, keepdims=True), 0.5
    )
    normal = np.stack([mean[:, 1], -mean[:, 0]], axis=1) * mitre
    angle = np.arange(segments) * (2 * np.pi / segments)
    section = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    section /= (np.abs(section) ** squareness).sum(axis=1, keepdims=True) ** (1 / squareness)
    local = section * np.broadcast_to(np.asarray(half_sizes, dtype=np.float64), (len(path), 2))[:, None]
    in_plane = path[:, None] + local[..., :1] * normal[:, None]  # (n, segments, 2)
    return _tube(np.stack([in_plane[..., 0], local[..., 1], in_plane[..., 1]], axis=-1))


def to_trimesh(solid: manifold3d.Manifold) -> trimesh.Trimesh:
    """Closed mesh of a solid."""
    mesh = solid.to_mesh()
    vertices = np.asarray(mesh.vert_properties, dtype=np.float64)[:, :3]
    return trimesh.Trimesh(vertices, np.asarray(mesh.tri_verts), process=False)


def _tube(rings: Array) -> manifold3d.Manifold:
    """Solid between consecutive rings (n, segments, 3), closed by a fan at each end."""
    n, segments = rings.shape[:2]
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(axis=1)]).astype(np.float32)
    here = np.arange(n * segments).reshape(n, segments)
    beside = np.roll(here, -1, axis=1)
    walls = [[here[:-1], beside[:-1], beside[1:]], [here[:-1], beside[1:], here[1:]]]
    first, last = np.full(segments, n * segments), np.full(segments, n * segments + 1)
    fans = [[first, beside[0], here[0]], [last, here[-1], beside[-1]]]
    faces = [np.stack(corners, axis=-1).reshape(-1, 3) for corners in walls + fans]
    mesh = manifold3d.Mesh(vertices, np.concatenate(faces).astype(np.uint32))
    return manifold3d.Manifold(mesh)
