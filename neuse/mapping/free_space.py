"""Free space: does the camera see an object's place empty, taken, hidden, or not at all?

Known surface points of the object are looked up in the depth image. Where a detector missed an object, or
merged its mask with another, there still is depth; so presence is judged by depth, never by a lack of masks.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.records import Intrinsics

_NEAREST_M = 0.1  # points closer to the image plane than this are not looked up


@dataclass(frozen=True)
class FreeSpaceParams(CheckedParams):
    """When depth counts as evidence."""

    depth_margin_m: float = param(
        0.02, "depth within this of a point's own is a surface at the point", 0.001, 0.5
    )
    depth_margin_per_m2: float = param(
        0.003, "growth of that margin with the range squared, per metre", 0.0, 0.1
    )
    max_range_m: float = param(3.0, "places further from the camera give no evidence", 0.1, 100.0)
    min_points: int = param(12, "points with a reading that a judgement needs", 1, 10000)
    min_read_share: float = param(0.6, "share of the points that must have a reading", 0.0, 1.0)
    empty_share: float = param(
        0.5, "a place is empty when this share of its points is seen through", 0.05, 1.0
    )
    partly_empty_share: float = param(
        0.2,
        "this share seen through, and less with a surface, is half as good evidence that a place is empty",
        0.05,
        1.0,
    )
    taken_share: float = param(
        0.25, "a place is taken when this share of its points has a surface", 0.05, 1.0
    )


@dataclass(frozen=True)
class Sight:
    """What a camera sees of an object's points: shares that sum to 1.

    free: seen through.    taken: a surface is there.    hidden: something nearer is in the way (also
    the front of the object itself, which hides its back).
    """

    free: float
    taken: float
    hidden: float
    params: FreeSpaceParams

    @property
    def emptiness(self) -> float:
        """Evidence that the object is not there: 1 where most of its place is seen through, 0 without any."""
        if self.free >= self.params.empty_share:
            return 1.0
        partly = self.free >= self.params.partly_empty_share and self.free > self.taken
        return 0.5 if partly else 0.0

    @property
    def is_taken(self) -> bool:
        """The object, or another in its place, is there."""
        return self.taken >= self.params.taken_share and self.free < self.params.empty_share / 2


def look(
    points: Array, coarse_depth_m: np.ndarray, intrinsics: Intrinsics, params: FreeSpaceParams
) -> Sight | None:
    """Compare surface points (n, 3), camera frame, metres, with depth (h', w').

    Of the four samples around a point the nearest counts: a coarse sample beside the object must not pass
    for a view through it.

    Returns:
        None where the depth says nothing: too far, out of view, or too few readings.
    """
    z = points[:, 2]
    if len(z) < params.min_points or not _NEAREST_M < np.median(z) <= params.max_range_m:
        return None
    nearest_m = _nearest_of_four(points, coarse_depth_m, intrinsics)
    read = np.isfinite(nearest_m)
    if read.sum() < max(params.min_points, params.min_read_share * len(z)):
        return None
    behind_m = nearest_m[read] - z[read]
    margin_m = params.depth_margin_m + params.depth_margin_per_m2 * z[read] ** 2
    free, hidden = float((behind_m > margin_m).mean()), float((behind_m < -margin_m).mean())
    return Sight(free, 1.0 - free - hidden, hidden, params)


def free_share(sights: Sequence[Sight]) -> float:
    """Median share of a place that was seen through, 0 without evidence."""
    return float(np.median([sight.free for sight in sights])) if sights else 0.0


def _nearest_of_four(points: Array, coarse_depth_m: np.ndarray, intrinsics: Intrinsics) -> Array:
    """(n,) smallest reading of the four samples around each point, inf where there is none."""
    height, width = coarse_depth_m.shape
    z = np.maximum(points[:, 2], _NEAREST_M)
    u = (intrinsics.fx * points[:, 0] / z + intrinsics.cx) * width / intrinsics.width - 0.5
    v = (intrinsics.fy * points[:, 1] / z + intrinsics.cy) * height / intrinsics.height - 0.5
    inside = (points[:, 2] > _NEAREST_M) & (u >= 0) & (u < width - 1) & (v >= 0) & (v < height - 1)
    columns, rows = np.where(inside, u, 0).astype(int), np.where(inside, v, 0).astype(int)
    samples = np.stack([coarse_depth_m[rows + i, columns + j] for i in (0, 1) for j in (0, 1)])
    nearest_m = np.where(samples > 0, samples, np.inf).min(axis=0)
    return np.where(inside, nearest_m, np.inf)
