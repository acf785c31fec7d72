"""Motion from depth alone: generalised ICP of sub-sampled scans, by small_gicp (Koide; Segal 2009)."""

from dataclasses import dataclass

import numpy as np
import small_gicp

from neuse.embedding.observe import back_project
from neuse.evaluation.external_slam import Match
from neuse.geometry import Array, exp, inverse, log, renormalized
from neuse.params import CheckedParams, param
from neuse.records import RgbdFrame

MIN_POINTS, MIN_OVERLAP = 50, 0.3


@dataclass(frozen=True)
class ScanParams(CheckedParams):
    """How scans are thinned and matched."""

    stride_px: int = param(2, "every so many pixels a point", 1, 64)
    max_range_m: float = param(4.0, "depth beyond this is too noisy", 0.1, 100.0)
    voxel_m: float = param(0.015, "one point a voxel of this side", 0.001, 1.0)
    reach_m: float = param(0.05, "corresponding points lie this near", 0.001, 10.0)
    trust: float = param(1.0, "share of points whose errors are their own", 1e-6, 1.0)
    guess_rad: float = param(0.005, "how good the guess is between two frames, rad", 1e-4, 3.15)
    guess_m: float = param(0.02, "the same, metres", 1e-4, 10.0)
    max_iterations: int = param(20, "steps of the optimiser", 1, 1000)


@dataclass(frozen=True)
class Scan:
    """Points with covariances, and a tree to find them by."""

    cloud: small_gicp.PointCloud
    tree: small_gicp.KdTree


class ScanMatcher:
    """Scans against scans."""

    def __init__(self, params: ScanParams | None = None) -> None:
        self.params = params or ScanParams()

    def view(self, frame: RgbdFrame) -> Scan:
        """The frame's depth as a thinned scan."""
        height, width = frame.depth_m.shape
        stride = self.params.stride_px
        pixels = np.arange(height * width).reshape(height, width)[::stride, ::stride].ravel()
        points = back_project(frame.depth_m, frame.intrinsics, pixels, self.params.max_range_m)
        return Scan(*small_gicp.preprocess_points(points, self.params.voxel_m, num_threads=1))

    def match(self, old: Scan, new: Scan, T_old_new: Array, slack: float) -> Match | None:
        """Generalised ICP from the guess, from coarse to fine; None if too little corresponds.

        In the end the reach must be short: what is new at a frame's border would be drawn to the old border.
        """
        if min(old.cloud.size(), new.cloud.size()) < MIN_POINTS:
            return None
        T_found, overlap = T_old_new, 0.0
        for reach_m in self.params.reach_m * np.geomspace(slack, 1.0, 1 + round(np.log2(slack))):
            result = small_gicp.align(
                old.cloud,
                new.cloud,
                old.tree,
                T_found,
                registration_type="GICP",
                max_correspondence_distance=reach_m,
                num_threads=1,
                max_iterations=self.params.max_iterations,
            )
            T_found, overlap = np.array(result.T_target_source), result.num_inliers / new.cloud.size()
        return self._weighed(T_old_new, T_found, result.H, slack, overlap) if overlap >= MIN_OVERLAP else None

    def _weighed(self, T_guess: Array, T_found: Array, H: Array, slack: float, overlap: float) -> Match:
        """Most probable motion by the information of guess and scans; planes leave H weak."""
        off = log(renormalized(inverse(T_guess) @ T_found))
        guessed = np.diag(np.repeat([self.params.guess_rad, self.params.guess_m], 3) ** -2.0) / slack**2
        covariance = np.asarray(np.linalg.inv(self.params.trust * H + guessed), dtype=np.float64)
        return Match(T_guess @ exp(covariance @ (self.params.trust * H @ off)), covariance, overlap)
