"""Procedural surface colours, evaluated at points of the surface in the object frame."""

import colorsys
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

Color = tuple[int, int, int]
KINDS = ("plain", "stripes", "label", "dots", "checker")


@dataclass(frozen=True)
class Texture:
    """Two colours and how they share the surface.

    kind: one of KINDS.    color_a, color_b: RGB of the ground and of the pattern.    scale_m: its period.
    band_m: lowest and highest z of the pattern.    twist: how far stripes and squares lean, periods a turn.
    """

    kind: str = "plain"
    color_a: Color = (200, 200, 200)
    color_b: Color = (90, 90, 90)
    scale_m: float = 0.02
    band_m: tuple[float, float] = (-1.0, 1.0)
    twist: int = 0


def texture_color(texture: Texture, points_object: ArrayLike) -> np.ndarray:
    """Colours (n, 3) uint8 at surface points (n, 3), metres, object frame."""
    points = np.asarray(points_object, dtype=np.float64)
    patterned = _in_pattern(texture, points)
    return np.array([texture.color_a, texture.color_b], dtype=np.uint8)[patterned.astype(int)]


def sample_texture(rng: np.random.Generator, height_m: float) -> Texture:
    """A random texture for an object of this height."""
    low, high = np.sort(rng.uniform(-0.45, 0.45, size=2)) * height_m
    return Texture(
        kind=KINDS[rng.integers(len(KINDS))],
        color_a=_random_color(rng),
        color_b=_random_color(rng),
        scale_m=float(rng.uniform(0.008, 0.035)),
        band_m=(float(low), float(high)),
        twist=int(rng.integers(-2, 3)),
    )


def _random_color(rng: np.random.Generator) -> Color:
    hue, saturation, value = rng.uniform([0, 0, 0.3], [1, 0.85, 1])
    red, green, blue = colorsys.hsv_to_rgb(hue, saturation, value)
    return int(255 * red), int(255 * green), int(255 * blue)


def _in_pattern(texture: Texture, points: np.ndarray) -> np.ndarray:
    """Which points (n,) show color_b. Around the axis the pattern repeats a whole number of times."""
    turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi)
    row = points[:, 2] / texture.scale_m + texture.twist * turn
    column = 12 * turn
    in_band = (points[:, 2] >= texture.band_m[0]) & (points[:, 2] <= texture.band_m[1])
    if texture.kind == "stripes":
        return in_band & (row % 1 < 0.5)
    if texture.kind == "label":
        return in_band & (np.abs(turn) > 0.2)
    if texture.kind == "dots":
        return in_band & ((row % 1 - 0.5) ** 2 + (column % 1 - 0.5) ** 2 < 0.1)
    if texture.kind == "checker":
        return in_band & ((np.floor(row) + np.floor(column)) % 2 == 0)
    return np.zeros(len(points), dtype=bool)
