"""Procedural boxes: cartons, tins and lidded boxes, in real sizes; about the same after half a turn about any
of their axes."""

from collections.abc import Callable

import manifold3d
import numpy as np
import trimesh

from neuse.geometry import Array
from neuse.simulation.solids import to_trimesh

LONGEST_M = (0.06, 0.28)
LEAST_M = 0.018
BALL_SEGMENTS = 24

Family = Callable[[Array, np.random.Generator], manifold3d.Manifold]


def sample_box(rng: np.random.Generator, held_out: bool = False) -> tuple[str, trimesh.Trimesh]:
    """A random box and the name of its family, from HELD_OUT only where asked for; centred."""
    names = [name for name in FAMILIES if (name in HELD_OUT) == held_out]
    name = names[rng.integers(len(names))]
    return name, to_trimesh(FAMILIES[name](_sample_half_sizes(rng), rng))


def _sample_half_sizes(rng: np.random.Generator) -> Array:
    """(3,) metres, in any order."""
    longest = float(np.exp(rng.uniform(*np.log(LONGEST_M))))
    sizes = longest * np.array([1.0, rng.uniform(0.4, 1.0), rng.uniform(0.16, 0.8)])
    return rng.permutation(np.maximum(sizes, LEAST_M)) / 2


def _carton(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """Edges that are all but sharp."""
    return _cuboid(half, float(rng.uniform(0.0, 0.001)))


def _rounded(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """All edges rounded."""
    return _cuboid(half, float(rng.uniform(0.08, 0.35)) * half.min())


def _bevelled(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """All edges cut off."""
    cut = float(rng.uniform(0.05, 0.25)) * half.min()
    corners = _corners(half - cut)[:, None] + cut * np.vstack([np.eye(3), -np.eye(3)])
    return _hull(corners)


def _tin(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """The upright edges rounded."""
    return _upright_rounded(half, float(rng.uniform(0.15, 0.7)) * min(half[:2]))


def _lidded(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """A box and a lid that stands out over its upper part."""
    rim, share = rng.uniform(0.001, 0.003), rng.uniform(0.12, 0.9)
    lid_half = half * [1, 1, share]
    lid = _cuboid(lid_half, 0.0).translate([0, 0, half[2] - lid_half[2]])
    return lid + _cuboid(half - [rim, rim, 0.0005], 0.0).translate([0, 0, -0.0005])


def _banded(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """A sleeve around the middle."""
    rim, share = rng.uniform(0.0006, 0.002), rng.uniform(0.15, 0.7)
    return _cuboid(half - [rim, rim, 0], 0.0) + _cuboid(half * [1, 1, share], 0.0)


def _pillow(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """Faces that bulge."""
    bulge = rng.uniform(0.05, 0.15) * half.min()
    u, v = (grid.ravel() for grid in np.meshgrid(*[np.linspace(-1, 1, 13)] * 2))
    height = (1 - u**2) * (1 - v**2)
    sides = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            points = np.insert(np.stack([u, v], axis=1), axis, sign, axis=1) * (half - bulge)
            points[:, axis] += sign * bulge * height
            sides.append(points)
    return _hull(np.concatenate(sides))


def _grooved(half: Array, rng: np.random.Generator) -> manifold3d.Manifold:
    """Two halves with a joint between them."""
    depth, width = rng.uniform(0.001, 0.003), rng.uniform(0.001, 0.004)
    radius = float(rng.uniform(0.05, 0.2)) * min(half[:2])
    core = _upright_rounded(half - [depth, depth, 0.0], radius)
    halves = (half[2] - width) / 2
    part = _upright_rounded(np.array([half[0], half[1], halves]), radius)
    return core + part.translate([0, 0, half[2] - halves]) + part.translate([0, 0, halves - half[2]])


FAMILIES: dict[str, Family] = {
    "carton": _carton,
    "rounded": _rounded,
    "bevelled": _bevelled,
    "tin": _tin,
    "lidded": _lidded,
    "banded": _banded,
    "pillow": _pillow,
    "grooved": _grooved,
}
HELD_OUT = ("pillow", "grooved")


def _cuboid(half: Array, radius: float) -> manifold3d.Manifold:
    """Of half sizes (3,), with edges of this radius."""
    if radius < 1e-4:
        return manifold3d.Manifold.cube(2 * np.asarray(half), center=True)
    ball = manifold3d.Manifold.sphere(radius, BALL_SEGMENTS).to_mesh().vert_properties[:, :3]
    return _hull(_corners(half - radius)[:, None] + ball)


def _upright_rounded(half: Array, radius: float) -> manifold3d.Manifold:
    """Of half sizes (3,), with edges along z of this radius."""
    angle = np.linspace(0, 2 * np.pi, 2 * BALL_SEGMENTS, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
    return _hull(_corners(half - [radius, radius, 0.0])[:, None] + radius * ring)


def _corners(half: Array) -> Array:
    """(8, 3) of a box of half sizes (3,)."""
    return half * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


def _hull(points: Array) -> manifold3d.Manifold:
    return manifold3d.Manifold.hull_points(points.reshape(-1, 3))
