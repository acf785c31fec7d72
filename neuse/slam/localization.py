"""Pose of one camera frame against objects whose places are known (NeuSE IV-A)."""

from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array, adjoint, exp, inverse, log, renormalized
from neuse.slam.object_frames import ObjectFrames
from neuse.slam.registration import jacobian

GRADUATION = (
    64.0,
    8.0,
    3.0,
    2.0,
    2.0,
    2.0,
)  # Cauchy scales in sigmas: from all alike down to the robust answer
PLACE_VARIANCES = np.array(
    [[0.002**2], [0.005**2], [0.02**2]]
)  # of known centres (m^2), axes, handles (rad^2)


@dataclass(frozen=True)
class Belief:
    """A camera pose, p_map = T_map_camera @ p_camera, and its covariance (6, 6) as in neuse.geometry."""

    T_map_camera: Array
    covariance: Array

    def moved(self, T_camera_next: Array, covariance: Array) -> "Belief":
        """The belief after a motion p_camera = T_camera_next @ p_next with its own covariance."""
        A = adjoint(inverse(T_camera_next))
        return Belief(renormalized(self.T_map_camera @ T_camera_next), A @ self.covariance @ A.T + covariance)


def localize(seen: ObjectFrames, places: Array, prior: Belief, start: Array | None = None) -> Belief:
    """Most probable camera pose given a prior and objects seen at known places, robust to flipped handles.

    Args:
        seen: n object frames in the camera frame.    places: (3, n, 3) their centres (metres), unit axes and
        unit handles in the map frame.    start: (4, 4) T_map_camera where the search starts; the prior's if
        None.
    """
    T_map_camera = prior.T_map_camera if start is None else start
    off_prior = np.zeros(6) if start is None else log(inverse(prior.T_map_camera) @ start)
    trusted = 1.0 / (seen.variances + PLACE_VARIANCES)
    J = jacobian(seen.vectors).reshape(-1, 6)
    information = np.linalg.inv(prior.covariance)
    for scale in GRADUATION:
        differences = seen.vectors - to_camera(T_map_camera, places)
        square_errors = trusted * (differences**2).sum(axis=-1)
        weighted = np.repeat((trusted / (1 + square_errors / scale**2)).ravel(), 3)[:, None] * J
        H = weighted.T @ J + information
        step = -np.linalg.solve(H, weighted.T @ differences.ravel() + information @ off_prior)
        T_map_camera, off_prior = T_map_camera @ exp(step), off_prior + step
    return Belief(renormalized(T_map_camera), np.linalg.inv(H))


def to_camera(T_map_camera: Array, places: Array) -> Array:
    """(3, n, 3) places of objects, map frame, as the camera would see them."""
    R_map_camera, t_map_camera = T_map_camera[:3, :3], T_map_camera[:3, 3]
    seen = places @ R_map_camera
    seen[0] -= t_map_camera @ R_map_camera
    return seen


def to_map(T_map_camera: Array, vectors: Array) -> Array:
    """(3, n, 3) centres, axes and handles, camera frame, in the map frame."""
    placed = vectors @ T_map_camera[:3, :3].T
    placed[0] += T_map_camera[:3, 3]
    return placed
