"""Motion from colour and depth: ORB features of two pictures, and PnP with RANSAC, by OpenCV."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from neuse.errors import InputError
from neuse.evaluation.external_slam import Match
from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.params import CheckedParams, param
from neuse.records import Intrinsics, RgbdFrame

LEVELS = 4  # of the picture pyramid: features of coarser ones are not precise
EDGE_PX, EDGE_SHARE = 2, 0.06  # a depth that changes by this share so near by is that of an edge


SIGMAS = np.repeat([0.005, 0.008], 3)  # of a match, rad and metres: twice what loop closures showed


@dataclass(frozen=True)
class FeatureParams(CheckedParams):
    """How features are found and matched."""

    count: int = param(1500, "features of a picture, at most", 10, 100_000)
    contrast: int = param(4, "threshold of the corner detector, grey levels", 1, 255)
    max_range_m: float = param(6.0, "depth beyond this is too noisy", 0.1, 100.0)
    reach_px: float = param(60.0, "a feature is looked for this near to where it should be", 1.0, 1000.0)
    max_hamming: int = param(64, "descriptors of one point differ in no more bits", 1, 256)
    ratio: float = param(0.85, "and the second best match by that much more", 0.1, 1.0)
    tolerance_px: float = param(2.0, "error of an inlier in the picture", 0.1, 100.0)
    min_inliers: int = param(10, "fewer say nothing", 4, 10_000)


@dataclass(frozen=True)
class Features:
    """n features: pixels (n, 2), points (n, 3) in the camera frame, descriptors (n, 32) uint8."""

    pixels: NDArray[np.float32]
    points: Array
    descriptors: NDArray[np.uint8]
    intrinsics: Intrinsics


class FeatureMatcher:
    """Pictures against pictures."""

    def __init__(self, params: FeatureParams | None = None) -> None:
        self.params = params or FeatureParams()
        self._detector = cv2.ORB.create(
            nfeatures=self.params.count, nlevels=LEVELS, fastThreshold=self.params.contrast
        )

    def view(self, frame: RgbdFrame) -> Features:
        """The frame's features that have a depth.

        Raises:
            InputError: `no_color`, the frame has no picture.
        """
        if frame.color is None:
            raise InputError("no_color", f"frame {frame.stamp_ns} ns has no colour image to find features in")
        gray = cv2.cvtColor(frame.color, cv2.COLOR_RGB2GRAY)
        keypoints, descriptors = self._detector.detectAndCompute(gray, None)
        pixels = np.array([keypoint.pt for keypoint in keypoints], dtype=np.float32).reshape(-1, 2)
        column, row = np.rint(pixels).astype(int).T
        depth_m = frame.depth_m[row, column].astype(np.float64)
        usable = (depth_m > 0) & (depth_m <= self.params.max_range_m) & _is_smooth(frame.depth_m, row, column)
        camera = frame.intrinsics
        x, y = ((pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]).T
        rays = np.column_stack([x, y, np.ones(len(pixels))])
        kept = descriptors[usable] if len(pixels) else np.zeros((0, 32), dtype=np.uint8)
        return Features(pixels[usable], (rays * depth_m[:, None])[usable], kept, camera)

    def match(self, old: Features, new: Features, T_old_new: Array, slack: float) -> Match | None:
        """PnP of the old points in the new picture; None with too few inliers."""
        pairs = self._pairs(old, new, T_old_new, slack * self.params.reach_px)
        if len(pairs) < self.params.min_inliers:
            return None
        points, pixels = old.points[pairs[:, 0]], new.pixels[pairs[:, 1]].astype(np.float64)
        camera = camera_matrix(new.intrinsics)
        found, turn, shift, inliers = cv2.solvePnPRansac(
            points,
            pixels,
            camera,
            None,
            iterationsCount=200,
            reprojectionError=self.params.tolerance_px,
            confidence=0.999,
            flags=cv2.SOLVEPNP_EPNP,
        )
        if not found or inliers is None or len(inliers) < self.params.min_inliers:
            return None
        chosen = inliers.ravel()
        turn, shift = cv2.solvePnPRefineLM(points[chosen], pixels[chosen], camera, None, turn, shift)
        T_new_old = make_transform(cv2.Rodrigues(turn)[0], shift.ravel())
        return Match(inverse(T_new_old), np.diag(SIGMAS**2), len(inliers) / len(pairs))

    def _pairs(self, old: Features, new: Features, T_old_new: Array, reach_px: float) -> NDArray[np.intp]:
        """(p, 2) indices of features that look alike, near to where the guess expects them."""
        if not len(old.points) or not len(new.points):
            return np.zeros((0, 2), dtype=np.intp)
        expected = project(transform_points(inverse(T_old_new), old.points), new.intrinsics)
        near = np.linalg.norm(expected[:, None] - new.pixels[None], axis=-1) <= reach_px
        found = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(
            old.descriptors, new.descriptors, 2, mask=near.astype(np.uint8)
        )
        good = [
            (best[0].queryIdx, best[0].trainIdx)
            for best in found
            if best
            and best[0].distance <= self.params.max_hamming
            and (len(best) < 2 or best[0].distance <= self.params.ratio * best[1].distance)
        ]
        return np.array(good, dtype=np.intp).reshape(-1, 2)


def _is_smooth(
    depth_m: NDArray[np.float32], row: NDArray[np.intp], column: NDArray[np.intp]
) -> NDArray[np.bool_]:
    """Whether the depths around pixels are those of one surface; edges have any depth."""
    height, width = depth_m.shape
    around = [
        depth_m[np.clip(row + dv, 0, height - 1), np.clip(column + du, 0, width - 1)]
        for dv in (-EDGE_PX, EDGE_PX)
        for du in (-EDGE_PX, EDGE_PX)
    ]
    least, most = np.min(around, axis=0), np.max(around, axis=0)
    return np.asarray(most - least <= EDGE_SHARE * most, dtype=np.bool_)


def camera_matrix(camera: Intrinsics) -> Array:
    """(3, 3) pinhole matrix."""
    return np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])


def project(points: Array, camera: Intrinsics) -> Array:
    """(n, 2) pixels of (n, 3) points in the camera frame; far outside the picture for those behind it."""
    z = points[:, 2:]
    seen = points[:, :2] / np.maximum(z, 1e-6) * [camera.fx, camera.fy] + [camera.cx, camera.cy]
    return np.where(z > 0.05, seen, -1e6)
