"""Refinement: what two near keyframes see of the same objects, registered surface to surface (GICP).

Codes tell where an object is from any side, but err by some millimetres that depend on the view. From frame
to frame the observed surfaces overlap, and registering them tells the motion more finely. One object alone
does not, since it may turn within its own surface.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import small_gicp

from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.records import Edge, EdgeKind
from neuse.slam.checks import is_covariance
from neuse.slam.keyframes import KeyframeRecord

RESOLUTION_M = 0.002  # points nearer to each other than this are one
MAX_ITERATIONS = 20
MIN_INLIER_SHARE = 0.5
MIN_POINTS = 30  # of a scan; the surface at a point is that of its ten neighbours


@dataclass(frozen=True)
class RefinementParams(CheckedParams):
    """Between which keyframes surfaces are registered, and how far the result is trusted."""

    lags: int = param(2, "keyframes back to which object points are registered; 0 for none", 0, 10)
    min_objects: int = param(2, "common objects that a registration needs", 2, 100)
    points_per_object: int = param(128, "points of an object that are registered", 8, 4096)
    max_distance_m: float = param(0.03, "points further apart do not correspond, metres", 0.001, 1.0)
    variance_scale: float = param(
        0.0032,
        "covariance at 1 m over the inverse Hessian of GICP; it grows with the range squared",
        1e-6,
        1e3,
    )


@dataclass(frozen=True)
class _Scan:
    """A keyframe, how many points of each track it sees, how far off (metres), and all points prepared."""

    record: KeyframeRecord
    counts: Mapping[int, int]
    range_m: float
    points: small_gicp.PointCloud
    tree: small_gicp.KdTree


class Refiner:
    """Registers each keyframe with those just before it."""

    def __init__(self, params: RefinementParams | None = None) -> None:
        self.params = params or RefinementParams()
        self._recent: deque[_Scan] = deque(maxlen=self.params.lags)

    def edges(self, new: KeyframeRecord, clouds: Mapping[int, np.ndarray], T_olds_new: Array) -> list[Edge]:
        """Edges from the last few keyframes to the new one.

        Args:
            clouds: (m, 3) points of each track that it sees, camera frame, metres.
            T_olds_new: (n, 4, 4) of the new keyframe relative to each of the last n, as tracked.
        """
        if not self.params.lags or len(clouds) < self.params.min_objects:
            return []
        count = self.params.points_per_object
        scan = _scan(new, {key: _thinned(cloud, count) for key, cloud in clouds.items()})
        if scan is None:
            return []
        edges = [
            self._edge(old, scan, T_olds_new[old.record.keyframe_id - new.keyframe_id])
            for old in self._recent
            if new.keyframe_id - old.record.keyframe_id <= self.params.lags
        ]
        self._recent.append(scan)
        return [edge for edge in edges if edge is not None]

    def _edge(self, old: _Scan, new: _Scan, T_old_new: Array) -> Edge | None:
        """The registration, None where it is not determined."""
        common = old.counts.keys() & new.counts.keys()
        if len(common) < self.params.min_objects:
            return None
        result = small_gicp.align(
            old.points,
            new.points,
            old.tree,
            T_old_new,
            registration_type="GICP",
            max_correspondence_distance=self.params.max_distance_m,
            max_iterations=MAX_ITERATIONS,
        )
        covariance = self._covariance(result.H, new.range_m)
        least_inliers = MIN_INLIER_SHARE * sum(new.counts[key] for key in common)
        if result.num_inliers < least_inliers or covariance is None:
            return None
        before, after = old.record, new.record
        return Edge(
            before.keyframe_id,
            after.keyframe_id,
            before.stamp_ns,
            after.stamp_ns,
            EdgeKind.EXTERNAL,
            result.T_target_source,
            covariance,
        )

    def _covariance(self, hessian: Array, range_m: float) -> Array | None:
        """(6, 6), None where the surfaces leave a motion free."""
        if np.linalg.eigvalsh(hessian)[0] <= 0.0:
            return None
        covariance = np.linalg.inv(hessian) * self.params.variance_scale * range_m**2
        covariance = (covariance + covariance.T) / 2
        return covariance if is_covariance(covariance) else None


def _thinned(cloud: np.ndarray, count: int) -> np.ndarray:
    """(m, 3) every so many-th point, `count` at most."""
    return cloud[:: -(-len(cloud) // count)] if len(cloud) else cloud


def _scan(record: KeyframeRecord, clouds: Mapping[int, np.ndarray]) -> _Scan | None:
    """None where the points are too few for a surface."""
    points = np.concatenate(list(clouds.values())).astype(np.float64)
    if len(points) < MIN_POINTS:
        return None
    prepared, tree = small_gicp.preprocess_points(points, RESOLUTION_M)
    if prepared.size() < MIN_POINTS:
        return None
    range_m = float(np.median(np.linalg.norm(points, axis=1)))
    return _Scan(record, {key: len(cloud) for key, cloud in clouds.items()}, range_m, prepared, tree)
