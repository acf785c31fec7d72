"""Procedural mug handles: a section swept along a centre line in the x-z plane, out to +x and back."""

from collections.abc import Callable
from dataclasses import dataclass

import manifold3d
import numpy as np
from numpy.typing import ArrayLike

from neuse.geometry import Array
from neuse.simulation.solids import Control, rounded_polyline, sample_controls, sweep

SMOOTH = (9.0, 9.0)

# Corners of the centre line from top to bottom: ranges of reach (0 = body, 1 = farthest), of height (0 and 1:
# its ends), and of rounding / reach.
CENTER_LINES: dict[str, tuple[Control, ...]] = {
    "ear": (
        ((0.6, 1.0), (1.0, 1.1), SMOOTH), ((1, 1), (0.75, 1.0), SMOOTH),
        ((0.6, 0.95), (0.1, 0.4), SMOOTH), ((0.1, 0.5), (-0.05, 0.1), SMOOTH),
    ),
    "square": (((0.95, 1.0), (0.95, 1.05), (0.15, 0.4)), ((0.9, 1.0), (-0.05, 0.05), (0.15, 0.4))),
    "c": (((1, 1), (0.95, 1.1), SMOOTH), ((1, 1), (0.4, 0.6), SMOOTH), ((1, 1), (-0.1, 0.05), SMOOTH)),
    "d": (((0.9, 1), (0.65, 0.9), (0.3, 1)), ((0.9, 1), (0.1, 0.35), (0.3, 1))),
    "triangle": (((0.9, 1.0), (0.95, 1.05), (0.25, 0.6)),),
    "hook": (
        ((1, 1), (0.95, 1.05), SMOOTH), ((1, 1), (0.2, 0.4), SMOOTH), ((0.5, 0.7), (-0.05, 0.1), SMOOTH),
    ),
}  # fmt: skip

HANDLES = (*CENTER_LINES, "ring", "double_post")
HELD_OUT_HANDLES = ("hook", "triangle")

Radius = Callable[[ArrayLike], Array]


@dataclass(frozen=True)
class _Frame:
    """Where a handle goes: heights of its two ends, how far it reaches out, and its body; metres."""

    radius: Radius
    low: float
    high: float
    reach: float

    def x(self, outwards: ArrayLike, upwards: ArrayLike) -> Array:
        """x of points given by their share of the reach and of the height; follows the slant of the body."""
        at_low, at_high = self.radius(self.low), self.radius(self.high)
        return at_low + (at_high - at_low) * np.clip(upwards, 0, 1) + self.reach * np.asarray(outwards)

    def z(self, upwards: ArrayLike) -> Array:
        """Heights of points given by their share of the handle's height."""
        return self.low + (self.high - self.low) * np.asarray(upwards)

    def anchor(self, z: float) -> list[float]:
        """A point (x, z) deep inside the body."""
        return [0.4 * float(self.radius(z + np.linspace(-0.006, 0.006, 5)).min()), z]


def sample_handle(name: str, radius: Radius, height: float, rng: np.random.Generator) -> manifold3d.Manifold:
    """A random handle of the family `name` for a body with this outer radius at z in [0, height], metres."""
    widest = float(radius(np.linspace(0, height, 20)).max())
    span, reach = height * rng.uniform(0.38, 0.8), max(0.012, widest * rng.uniform(0.35, 0.95))
    half_sizes = np.minimum(
        rng.uniform([0.0018, 0.0025], [0.007, 0.011]), [0.12 * min(span, 1.6 * reach), 0.28 * widest]
    )
    margin = half_sizes[0] + 0.04 * height
    span = min(span, height - 2 * margin)
    low = margin + rng.uniform() * max(height - 2 * margin - span, 0.0)
    bulge = _bulge(radius, low, low + span)
    frame = _Frame(radius, low, low + span, reach + bulge)
    squareness = float(rng.choice([2.0, 2.0, 3.0, 7.0]))
    if name == "double_post":
        return _double_post(frame, half_sizes, squareness, rng)
    path = _ring_path(frame, rng) if name == "ring" else _path(name, frame, half_sizes[0], rng)
    along = np.linspace(-1, 1, len(path))[:, None]
    return sweep(path, half_sizes * (1 + rng.uniform(-0.15, 0.5) * along**4), squareness)


def _bulge(radius: Radius, low: float, high: float) -> float:
    """How far the body stands out beyond the straight line between two heights of its outline."""
    share = np.linspace(0, 1, 12)
    line = radius(low) + (radius(high) - radius(low)) * share
    return float((radius(low + (high - low) * share) - line).max())


def _path(name: str, frame: _Frame, half_thickness: float, rng: np.random.Generator) -> Array:
    """Centre line (n, 2) through a draw of the family's corners."""
    corners, rounding = sample_controls(CENTER_LINES[name], rng)
    upwards = np.clip(corners[:, 1], 0, 1) if name != "hook" else corners[:, 1]
    points = np.stack([frame.x(corners[:, 0], upwards), frame.z(upwards)], axis=1)
    ends = [frame.anchor(frame.high), frame.anchor(frame.low)]
    points = np.vstack([ends[:1], points] if name == "hook" else [ends[:1], points, ends[1:]])
    cuts = np.maximum(rounding * frame.reach, 1.6 * half_thickness)  # or the inside of the bend folds over
    cuts = np.concatenate([[0], cuts, [0]])[: len(points)]
    return rounded_polyline(points, cuts)


def _ring_path(frame: _Frame, rng: np.random.Generator) -> Array:
    """Three quarters of a circle and straight ends."""
    middle, ring = (frame.low + frame.high) / 2, (frame.high - frame.low) / 2
    angle = np.linspace(0.72, -0.72, 30) * np.pi
    x = frame.x(0, 0.5) + _bulge(frame.radius, frame.low, frame.high) + ring * rng.uniform(0.35, 0.6)
    arc = np.stack([x + ring * np.cos(angle), middle + ring * np.sin(angle)], axis=1)
    return np.vstack([frame.anchor(arc[0, 1]), arc, frame.anchor(arc[-1, 1])])


def _double_post(
    frame: _Frame, half_sizes: Array, squareness: float, rng: np.random.Generator
) -> manifold3d.Manifold:
    """Two posts and a straight grip that stands out beyond them."""
    over = rng.uniform(0, 0.12)
    low, high = 0.1 + over, 0.9 - over
    grip_up = np.array([high + over + 0.1, low - over - 0.1])
    grip = sweep(
        np.stack([frame.x(1, grip_up), frame.z(grip_up)], axis=1),
        half_sizes * rng.uniform(1, 1.4),
        squareness,
    )
    for upwards in (low, high):
        z = float(frame.z(upwards))
        grip += sweep(np.array([frame.anchor(z), [float(frame.x(1, upwards)), z]]), half_sizes, squareness)
    return grip
