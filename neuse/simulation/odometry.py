"""Odometry that drifts: true increments with noise, integrated."""

from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array, exp, inverse
from neuse.params import CheckedParams, param


@dataclass(frozen=True)
class OdometryNoise(CheckedParams):
    """Standard deviations of one increment, per axis of the camera; white, so the pose walks at random."""

    rotation_rad: float = param(0.003, "rotation noise of a frame", 0.0, 1.0)
    translation_m: float = param(0.05, "translation noise of a frame", 0.0, 1.0)
    translation_share: float = param(0.0, "translation noise as a share of the distance moved", 0.0, 1.0)


def paper_noise() -> OdometryNoise:
    """Noise of the paper's synthetic sequences: 0.003 rad and 0.05 m a frame (NeuSE V)."""
    return OdometryNoise()


def visual_odometry_noise() -> OdometryNoise:
    """Drift like that of visual odometry: 0.05 degrees a frame and 0.5 % of the distance."""
    return OdometryNoise(rotation_rad=np.deg2rad(0.05), translation_m=0.0, translation_share=0.005)


def drifting_odometry(T_world_camera: Array, noise: OdometryNoise, rng: np.random.Generator) -> Array:
    """What odometry says of a trajectory.

    Args:
        T_world_camera: (n, 4, 4) true poses.
    Returns:
        T_odom_camera (n, 4, 4); the first is the identity.
    """
    increments = inverse(T_world_camera[:-1]) @ T_world_camera[1:]
    distance_m = np.linalg.norm(increments[:, :3, 3], axis=1)
    xi = rng.standard_normal((len(increments), 6))
    xi[:, :3] *= noise.rotation_rad
    xi[:, 3:] *= (noise.translation_m + noise.translation_share * distance_m)[:, None]
    T_odom_camera = [np.eye(4)]
    for increment, error in zip(increments, xi, strict=True):
        T_odom_camera.append(T_odom_camera[-1] @ increment @ exp(error))
    return np.stack(T_odom_camera)
