"""Upkeep of the map: no object twice, no two objects in one place (NeuSE appendix, map maintenance)."""

from dataclasses import dataclass
from functools import cache

import numpy as np

from neuse.geometry import Array, inverse, transform_points
from neuse.mapping.reconstruction import Box
from neuse.params import CheckedParams, param

_GRID = 10  # samples along each side of a box


@dataclass(frozen=True)
class UpkeepParams(CheckedParams):
    """When boxes are taken to collide."""

    residual_overlap: float = param(
        0.95, "an object of which this share lies inside a larger one is a part of it", 0.0, 1.0
    )
    displacing_overlap: float = param(
        0.2, "a changed object of which this share lies in an older one has taken its place", 0.0, 1.0
    )
    swallowing_overlap: float = param(
        0.5, "a changed object that fills this share of an older one has taken its place", 0.0, 1.0
    )


def overlap(box: Box, other: Box) -> float:
    """Share of the box's volume that lies inside the other box, in [0, 1], to about 1 / 1000."""
    if np.linalg.norm(box.center - other.center) >= box.radius + other.radius:
        return 0.0
    T_other_box = inverse(other.T_map_box) @ box.T_map_box
    samples = transform_points(T_other_box, _unit_grid() * box.size)
    return float((np.abs(samples) <= other.size / 2 + 1e-9).all(axis=1).mean())


def is_residual(box: Box, other: Box, params: UpkeepParams) -> bool:
    """The box is a part of the other, larger one: an object made from a partial view (appendix, rule 1)."""
    return box.volume <= other.volume and overlap(box, other) >= params.residual_overlap


def is_displaced(older: Box, changed: Box, params: UpkeepParams) -> bool:
    """The changed object stands where the older one was, which must therefore be gone (appendix, rule 2)."""
    if overlap(changed, older) >= params.displacing_overlap:
        return True
    return overlap(older, changed) >= params.swallowing_overlap


@cache
def _unit_grid() -> Array:
    """(n, 3) centres of the cells of the unit cube about the origin."""
    side = (np.arange(_GRID) + 0.5) / _GRID - 0.5
    return np.stack(np.meshgrid(side, side, side), axis=-1).reshape(-1, 3)
