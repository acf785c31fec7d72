"""The latent code: k points that move with the object, and the rigid frame that they span.

The first half of the points are landmarks, z_j = c + E a_j: c is the object's centre, a_j the fixed template
below and E = R_camera_object diag(extents) the object's scaled axes. E[:, 2] points along the axis to the
top, E[:, 0] to the handle. For ambiguous (axially symmetric) objects only the component along the axis is
there: z_j = c + E[:, 2] a_j[2]. The axes of a box are its edges, named and signed as the encoder likes. The
second half is free for the decoder.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from neuse.geometry import Array, make_transform, transform_points
from neuse.symmetry import BOX


@cache
def landmark_template(k: int) -> Array:
    """(k // 2, 3) fixed landmark directions a_j: zero mean, A.T @ A = (k // 2) / 3 * I."""
    raw = np.random.default_rng(1987).normal(size=(k // 2, 3))
    orthonormal, _ = np.linalg.qr(raw - raw.mean(axis=0))
    template = orthonormal * np.sqrt(k // 2 / 3)
    template.setflags(write=False)
    return template


@dataclass(frozen=True)
class Code:
    """What the encoder knows of one object in one view (NeuSE section III).

    z: (k, 3) float64 latent points, metres, in the frame of the encoded cloud.
    descriptor: (k,) float64, unit length, invariant to pose; compare by the dot product.
    sigmas: (6,) float64, standard deviations of the object's rigid frame, rotation first (rad), then
        translation (m), along the object frame's axes; the third (about the axis) is pi if ambiguous, all
        three are where the axes have no names.
    height_correlation: of the errors of the centre's place along the axis and of half the height, which have
        the same standard deviation: 1 where the bottom is in its place and the top is not known, -1 the other
        way round, 0 where both ends are known alike.
    """

    category: str
    ambiguous: bool
    z: Array
    descriptor: Array
    sigmas: Array
    height_correlation: float = 0.0

    @property
    def landmarks(self) -> Array:
        """(k // 2, 3) points that the registration uses."""
        return self.z[: len(self.z) // 2]

    @property
    def center(self) -> Array:
        """(3,) centre of the object (not of the observed points)."""
        return self.landmarks.mean(axis=0)

    @property
    def axes(self) -> Array:
        """(3, 3) scaled axes E, least squares over the landmarks; metres."""
        template = landmark_template(len(self.z))
        return (self.landmarks - self.center).T @ template * (3.0 / len(template))

    @property
    def half_height(self) -> float:
        """From the centre to the top, metres."""
        return float(np.linalg.norm(self.axes[:, 2]))

    @property
    def T_frame_object(self) -> Array:
        """(4, 4) pose of the object frame, p_frame = T_frame_object @ p_object; any x if ambiguous."""
        return make_transform(_orthonormal(self.axes, self.ambiguous), self.center)

    def named_like(self, other: "Code") -> "Code":
        """The same code, its axes named as those of another that it may be.

        That changes codes that tell no rotation, as those of boxes: each view names the edges as it likes.
        """
        if self.sigmas[:3].min() < np.pi:
            return self
        equivalent = self.axes @ BOX.turns  # (24, 3, 3)
        nearest = equivalent[np.square(equivalent - other.axes).sum(axis=(1, 2)).argmin()]
        landmarks = self.center + landmark_template(len(self.z)) @ nearest.T
        return replace(self, z=np.concatenate([landmarks, self.z[len(landmarks) :]]))

    def transformed(self, T_target_source: Array) -> "Code":
        """The same code seen from another frame: z_target = T_target_source @ z."""
        return replace(self, z=transform_points(T_target_source, self.z))


def _orthonormal(axes: Array, ambiguous: bool) -> Array:
    """Right-handed rotation with z along axes[:, 2] and x in the half plane of axes[:, 0]."""
    z = axes[:, 2] / max(float(np.linalg.norm(axes[:, 2])), 1e-12)
    x = np.eye(3)[np.argmin(np.abs(z))] if ambiguous else axes[:, 0]
    x = x - z * (z @ x)
    if np.linalg.norm(x) < 1e-9:
        x = np.eye(3)[np.argmin(np.abs(z))] - z * z[np.argmin(np.abs(z))]
    x = x / np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)
