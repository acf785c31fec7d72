"""Procedural mugs: a hollow body of revolution and a handle, in real sizes.

A body is a family of profiles, a handle a family of centre lines. The handle is joined to the solid body
before the body is hollowed, so that it never shows inside.
"""

from dataclasses import dataclass

import manifold3d
import numpy as np
import trimesh
from numpy.typing import ArrayLike

from neuse.geometry import Array
from neuse.simulation.handles import HANDLES, HELD_OUT_HANDLES, sample_handle
from neuse.simulation.solids import Control, lathe, rounded_polyline, sample_controls, to_trimesh

SMOOTH = (9.0, 9.0)
SHARP = (0.02, 0.08)

# Corners of the outside from the edge of the foot to the rim: ranges of radius / largest radius, of height /
# whole height, and of rounding / largest radius.
BODIES: dict[str, tuple[Control, ...]] = {
    "straight": (((0.95, 1.0), (0, 0), (0.03, 0.2)), ((0.97, 1.0), (1, 1), SHARP)),
    "tapered": (((0.55, 0.9), (0, 0), (0.03, 0.25)), ((1, 1), (1, 1), SHARP)),
    "conical": (((1, 1), (0, 0), (0.03, 0.15)), ((0.65, 0.92), (1, 1), SHARP)),
    "bellied": (
        ((0.55, 0.8), (0, 0), (0.03, 0.15)), ((1, 1), (0.15, 0.3), SMOOTH),
        ((1, 1), (0.5, 0.7), SMOOTH), ((0.65, 0.92), (1, 1), SHARP),
    ),
    "waisted": (
        ((0.8, 1), (0, 0), (0.03, 0.15)), ((0.55, 0.75), (0.35, 0.6), SMOOTH), ((0.85, 1), (1, 1), SHARP),
    ),
    "round_bottom": (
        ((0.25, 0.5), (0, 0), (0.02, 0.1)), ((0.8, 1), (0.03, 0.12), SMOOTH),
        ((1, 1), (0.35, 0.6), SMOOTH), ((0.95, 1.1), (1, 1), SHARP),
    ),
    "flared": (
        ((0.7, 0.9), (0, 0), (0.03, 0.2)), ((0.7, 0.85), (0.55, 0.85), SMOOTH), ((1, 1), (1, 1), SHARP),
    ),
    "footed": (
        ((0.5, 0.75), (0, 0), SHARP), ((0.45, 0.7), (0.05, 0.1), SHARP),
        ((0.9, 1), (0.12, 0.3), SMOOTH), ((0.9, 1), (1, 1), SHARP),
    ),
    "barrel": (
        ((0.8, 0.9), (0, 0), (0.03, 0.1)), ((1, 1), (0.35, 0.5), SMOOTH), ((0.8, 0.92), (1, 1), SHARP),
    ),
    "tulip": (
        ((0.5, 0.7), (0, 0), (0.03, 0.15)), ((1, 1.1), (0.1, 0.35), SMOOTH),
        ((0.7, 0.85), (0.65, 0.8), SMOOTH), ((0.9, 1.1), (1, 1), SHARP),
    ),
    "stepped": (
        ((0.7, 0.85), (0, 0), (0.03, 0.1)), ((0.7, 0.85), (0.3, 0.6), SHARP),
        ((1, 1), (0.35, 0.68), SHARP), ((0.97, 1), (1, 1), SHARP),
    ),
    "octagonal": (((0.8, 1.0), (0, 0), SHARP), ((0.97, 1.0), (1, 1), SHARP)),
}  # fmt: skip

HELD_OUT_BODIES = ("stepped", "octagonal")


@dataclass(frozen=True)
class _Body:
    """Outside of a mug, z = 0 at the table, and its wall; metres.

    profile: (n, 2) radius and height from the foot to the rim.    rim_m: height of the rim's rounding.
    sides: flat sides, 0 for a round body.
    """

    profile: Array
    wall_m: float
    rim_m: float
    sides: int

    def radius(self, z: ArrayLike) -> Array:
        """Outer radius at heights z, as if the rim were not rounded."""
        return np.interp(np.minimum(z, self.height - self.rim_m), self.profile[:, 1], self.profile[:, 0])

    @property
    def height(self) -> float:
        return float(self.profile[-1, 1])


def sample_mug(rng: np.random.Generator, held_out: bool = False) -> tuple[str, trimesh.Trimesh]:
    """A random mug and the name of its family; z = 0 at its foot, handle on +x.

    Held-out families (HELD_OUT_BODIES, HELD_OUT_HANDLES) come only where asked for, and then in the body, in
    the handle, or in both.
    """
    new_body, new_handle = rng.permutation([True, rng.random() < 0.4]) if held_out else (False, False)
    body_name = _choose(tuple(BODIES), HELD_OUT_BODIES, bool(new_body), rng)
    handle_name = _choose(HANDLES, HELD_OUT_HANDLES, bool(new_handle), rng)
    body = _sample_body(body_name, rng)
    solid = lathe(body.profile, sides=body.sides) + sample_handle(handle_name, body.radius, body.height, rng)
    return f"{body_name}_{handle_name}", to_trimesh(solid - _sample_cavity(body, rng))


def _choose(names: tuple[str, ...], held_out: tuple[str, ...], wanted: bool, rng: np.random.Generator) -> str:
    """One of the held-out names where wanted, else one of the others."""
    candidates = [name for name in names if (name in held_out) == wanted]
    return candidates[rng.integers(len(candidates))]


def _sample_body(name: str, rng: np.random.Generator) -> _Body:
    radius = float(np.exp(rng.uniform(np.log(0.025), np.log(0.065))))
    height = float(np.exp(rng.uniform(np.log(max(0.045, 1.2 * radius)), np.log(min(0.14, 3.2 * radius)))))
    wall = float(rng.uniform(0.002, min(0.007, 0.16 * radius)))
    corners, rounding = sample_controls(BODIES[name], rng)
    corners[:, 1] = np.maximum.accumulate(corners[:, 1])
    corners, cuts = np.vstack([[0, 0], corners, [0, 1]]), np.concatenate([[0], rounding * radius, [0]])
    cuts[-2] = rim = wall * rng.uniform(0.1, 0.6)
    profile = rounded_polyline(corners * [radius, height], cuts)[1:-1]
    profile[:, 0] *= radius / profile[:, 0].max()
    return _Body(profile, wall, rim, sides=8 if name == "octagonal" else 0)


def _sample_cavity(body: _Body, rng: np.random.Generator) -> manifold3d.Manifold:
    """What is taken out of the solid body: the inside, open at the top, and the hollow under the foot."""
    recess = body.wall_m * rng.uniform(0.05, 0.6)
    floor = recess + body.wall_m * rng.uniform(0.8, 1.6)
    corner = min(rng.uniform(0.1, 0.8) * float(_inner_radius(body, floor)), 0.3 * body.height)
    ease = 1 - np.cos(np.linspace(0, np.pi / 2, 8))
    z = np.concatenate([floor + corner * ease, np.linspace(floor + corner, body.height, 20)[1:]])
    short = np.clip(1 - (z - floor) / corner, 0, 1)
    inner = _inner_radius(body, z) - corner * (1 - np.sqrt(1 - short**2))
    profile = np.vstack([np.stack([inner, z], axis=1), [inner[-1], body.height + 0.01]])
    foot_radius = 0.9 * body.profile[0, 0] - body.wall_m
    if foot_radius < 0.004:
        return lathe(profile, sides=body.sides)
    under_foot = manifold3d.Manifold.cylinder(2 * recess, foot_radius, circular_segments=48, center=True)
    return lathe(profile, sides=body.sides) + under_foot


def _inner_radius(body: _Body, z: ArrayLike) -> Array:
    """Largest radius at heights z that stays a wall's thickness away from the outside."""
    reach = np.linspace(-1, 1, 15) * body.wall_m
    near = body.radius(np.asarray(z)[..., None] + reach) - np.sqrt(np.maximum(body.wall_m**2 - reach**2, 0.0))
    return near.min(axis=-1)
