"""Hollow bodies that are open at the top: an outside, a wall, and the cavity that leaves it standing."""

from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from neuse.geometry import Array
from neuse.simulation.solids import Control, lathe, rounded_polyline, sample_controls


@dataclass(frozen=True)
class Body:
    """Outside of a vessel, z = 0 at the table, and its wall; metres.

    profile: (n, 2) radius and height from the foot to the rim.    rim_m: height of the rim's rounding.
    sides: flat sides, 0 for a round body.
    """

    profile: Array
    wall_m: float
    rim_m: float
    sides: int = 0

    def radius(self, z: ArrayLike) -> Array:
        """Outer radius at heights z, as if the rim were not rounded."""
        return np.interp(np.minimum(z, self.height - self.rim_m), self.profile[:, 1], self.profile[:, 0])

    @property
    def height(self) -> float:
        """From the table to the rim."""
        return float(self.profile[-1, 1])

    def solid(self) -> manifold3d.Manifold:
        """The body before it is hollowed."""
        return lathe(self.profile, sides=self.sides)


def sample_body(
    corners: tuple[Control, ...],
    radius: float,
    height: float,
    wall_m: float,
    rng: np.random.Generator,
    sides: int = 0,
) -> Body:
    """A body of these corners: from the edge of the foot to the rim, ranges of radius / largest radius, of
    height / whole height, and of rounding / largest radius."""
    points, rounding = sample_controls(corners, rng)
    points[:, 1] = np.maximum.accumulate(points[:, 1])
    points, cuts = np.vstack([[0, 0], points, [0, 1]]), np.concatenate([[0], rounding * radius, [0]])
    cuts[-2] = rim = wall_m * rng.uniform(0.1, 0.6)
    profile = rounded_polyline(points * [radius, height], cuts)[1:-1]
    profile[:, 0] *= radius / profile[:, 0].max()
    return Body(profile, wall_m, rim, sides)


def sample_cavity(body: Body, rng: np.random.Generator) -> manifold3d.Manifold:
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


def _inner_radius(body: Body, z: ArrayLike) -> Array:
    """Largest radius at heights z that stays a wall's thickness away from the outside."""
    reach = np.linspace(-1, 1, 15) * body.wall_m
    near = body.radius(np.asarray(z)[..., None] + reach) - np.sqrt(np.maximum(body.wall_m**2 - reach**2, 0.0))
    return near.min(axis=-1)
