"""Views of an object, each in the frame of its keyframe, and their average in the map frame."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array, transform_points
from neuse.slam.track import shape_noise

_FLIP_SCALE_M = 0.02  # views whose landmarks lie this far from the average count half
_TELLING_NOISE = 0.02  # 1 - cosine to be expected of a view that tells one shape from another
_TRUSTED_SHARE = 0.8  # the farthest points of a view may be of another surface


@dataclass(frozen=True)
class View:
    """One observation of an object, in the frame of a keyframe. points: (m, 3) surface points, metres."""

    code: Code
    points: Array
    weight: float = 1.0

    @cached_property
    def center(self) -> Array:
        """(3,) centre of the object, keyframe's frame."""
        return self.code.center


def make_view(code: Code, cloud: np.ndarray, T_keyframe_camera: Array, is_cut: bool, count: int) -> View:
    """A view from an observation in the camera frame; a cut one (at the image border) weighs a quarter."""
    cloud = cloud if len(cloud) else code.center[None]
    nearest = np.argsort(np.linalg.norm(cloud - code.center, axis=1))[
        : int(np.ceil(_TRUSTED_SHARE * len(cloud)))
    ]
    kept = np.sort(nearest)[:: max(1, len(nearest) // count)][:count]
    points = transform_points(T_keyframe_camera, cloud[kept].reshape(-1, 3))
    weight = weight_of(code) / (4.0 if is_cut else 1.0)
    return View(code.transformed(T_keyframe_camera), points, weight)


def weight_of(code: Code) -> float:
    """Of a view in averages: 1 where the centre is known to a millimetre, then falling with its variance."""
    return 1e-6 / (float(np.mean(code.sigmas[3:] ** 2)) + 1e-6)


def tells_shape(code: Code) -> bool:
    """Whether the view was good enough to tell an object from others of its category."""
    return shape_noise(code) <= _TELLING_NOISE


def average_codes(codes: Sequence[Code], T_map_keyframes: Array, weights: Array) -> Code:
    """Robust average of codes of one object, n views of it: a flipped view among good ones hardly counts.

    T_map_keyframes: (n, 4, 4) from each code's frame.    weights: (n,) positive.
    The errors of views are correlated, so the average claims to be no better than its best view.
    """
    z = np.array([code.z for code in codes])  # (n, k, 3)
    z = z @ T_map_keyframes[:, :3, :3].swapaxes(1, 2) + T_map_keyframes[:, None, :3, 3]
    sigmas = np.array([code.sigmas for code in codes])  # (n, 6)
    if sigmas[:, :3].min(axis=1).max() >= np.pi:
        z = _named_alike(codes, z, int(np.argmax(weights)))
    half = z.shape[1] // 2
    robust = weights
    for _ in range(3):
        mean = _weighted_mean(robust, z)  # (k, 3)
        squared_m2 = ((z[:, :half] - mean[:half]) ** 2).sum(axis=(1, 2)) / half  # (n,)
        robust = weights / (1.0 + squared_m2 / _FLIP_SCALE_M**2)
    descriptor = robust @ np.array([code.descriptor for code in codes])
    descriptor = descriptor / max(float(np.linalg.norm(descriptor)), 1e-12)
    correlation = float(robust @ [code.height_correlation for code in codes] / robust.sum())
    return replace(
        codes[0],
        z=mean,
        descriptor=descriptor,
        sigmas=sigmas.min(axis=0),
        height_correlation=correlation,
    )


def _named_alike(codes: Sequence[Code], z: Array, best: int) -> Array:
    """(n, k, 3) latent points in one frame, axes without names named as those of the best code."""
    placed = [replace(code, z=points) for code, points in zip(codes, z, strict=True)]
    return np.array([code.named_like(placed[best]).z for code in placed])


def _weighted_mean(weights: Array, z: Array) -> Array:
    """(k, 3) of (n, k, 3)."""
    return (weights @ z.reshape(len(z), -1) / weights.sum()).reshape(z.shape[1:])
