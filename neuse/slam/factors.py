"""What is known of vertices, as factors of gtsam: edges, sightings of landmark points, smooth motions.

Vertices are keyframe poses T_map_camera and, where objects are landmarks, points on the objects. Covariances
are rotation first in the body frame, as everywhere in the library.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TypeAlias

import gtsam
import numpy as np

from neuse.errors import SolverError
from neuse.geometry import Array, renormalized
from neuse.records import Edge

Kernel: TypeAlias = gtsam.noiseModel.mEstimator.Base
POSE, POINT, LOOSE_POINT, VELOCITY, BIAS = "x", "p", "q", "v", "b"  # letters of gtsam's symbols
ORIGIN_SIGMA = 1e-4  # rad, m: the first camera pose is the map's origin
UNKNOWN_TURN = 10.0  # rad/sqrt(s): a smooth motion says nothing of rotations
BIAS_SIGMA = 0.01  # m/s^2: of biases that gtsam asks for and nobody has
INTEGRATION_SIGMA = 0.001  # m/sqrt(s): so that the covariance of a smooth motion is regular


def pose_key(keyframe_id: int) -> int:
    """The vertex of a keyframe."""
    return gtsam.symbol(POSE, keyframe_id)


def velocity_key(keyframe_id: int) -> int:
    """The vertex of a keyframe's velocity, m/s on the axes of the map."""
    return gtsam.symbol(VELOCITY, keyframe_id)


def bias_key(keyframe_id: int) -> int:
    """The vertex that gtsam asks for beside the velocity that a keyframe is reached with."""
    return gtsam.symbol(BIAS, keyframe_id)


def origin_factor(keyframe_id: int, T_map_camera: Array) -> gtsam.PriorFactorPose3:
    """The pose that defines the map frame."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, ORIGIN_SIGMA)
    return gtsam.PriorFactorPose3(pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)), noise)


def hold_factor(keyframe_id: int, T_map_camera: Array, covariance: Array) -> gtsam.PriorFactorPose3:
    """A pose that is known from elsewhere, covariance (6, 6)."""
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return gtsam.PriorFactorPose3(pose_key(keyframe_id), gtsam.Pose3(renormalized(T_map_camera)), noise)


def known_point_factor(key: int, p_map: Array, covariance: Array, kernel: Kernel) -> gtsam.PriorFactorPoint3:
    """A point whose place is known from elsewhere, metres, covariance (3, 3)."""
    return gtsam.PriorFactorPoint3(key, p_map, _noise(covariance, kernel))


def edge_factor(edge: Edge, kernel: Kernel | None) -> gtsam.BetweenFactorPose3:
    """p_from = T_from_to @ p_to as a factor on both poses."""
    noise = _noise(edge.covariance, kernel)
    return gtsam.BetweenFactorPose3(
        pose_key(edge.from_id), pose_key(edge.to_id), gtsam.Pose3(edge.T_from_to), noise
    )


def bias_factor(keyframe_id: int) -> gtsam.PriorFactorConstantBias:
    """There is no bias."""
    noise = gtsam.noiseModel.Isotropic.Sigma(6, BIAS_SIGMA)
    return gtsam.PriorFactorConstantBias(bias_key(keyframe_id), gtsam.imuBias.ConstantBias(), noise)


def smooth_motion_factor(before: int, after: int, duration_s: float, acceleration: float) -> gtsam.ImuFactor:
    """Constant velocity up to white noise of the acceleration (m/s^2/sqrt(Hz)), constant over a step.

    Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, 6.3.2. That is
    what an IMU tells without gravity whose accelerometer reads nothing and whose gyroscope is poor.
    """
    params = gtsam.PreintegrationParams(np.zeros(3))
    params.setAccelerometerCovariance(acceleration**2 * np.eye(3))
    params.setGyroscopeCovariance(UNKNOWN_TURN**2 * np.eye(3))
    params.setIntegrationCovariance(INTEGRATION_SIGMA**2 * np.eye(3))
    nothing = gtsam.PreintegratedImuMeasurements(params, gtsam.imuBias.ConstantBias())
    nothing.integrateMeasurement(np.zeros(3), np.zeros(3), duration_s)
    ends = pose_key(before), velocity_key(before), pose_key(after), velocity_key(after)
    return gtsam.ImuFactor(*ends, bias_key(after), nothing)


def sighting_factor(
    camera: int, point: int, p_camera: Array, covariance: Array, kernel: Kernel
) -> gtsam.BearingRangeFactor3D:
    """A point seen at p_camera, as bearing and range with the covariance (3, 3) to first order.

    camera, point: gtsam's keys of their vertices.
    """
    bearing, range_m = gtsam.Unit3(p_camera), float(np.linalg.norm(p_camera))
    J = np.vstack([bearing.basis().T / range_m, bearing.point3()])  # d (bearing, range) / d p_camera
    noise = _noise(J @ covariance @ J.T, kernel)
    return gtsam.BearingRangeFactor3D(camera, point, bearing, range_m, noise)


def huber(sigmas: float) -> Kernel:
    """Errors beyond so many sigmas count linearly."""
    return gtsam.noiseModel.mEstimator.Huber.Create(sigmas)


def cauchy(sigmas: float) -> Kernel:
    """The further errors go beyond so many sigmas, the less they pull."""
    return gtsam.noiseModel.mEstimator.Cauchy.Create(sigmas)


def _noise(covariance: Array, kernel: Kernel | None) -> gtsam.noiseModel.Base:
    noise = gtsam.noiseModel.Gaussian.Covariance(covariance)
    return noise if kernel is None else gtsam.noiseModel.Robust.Create(kernel, noise)


@contextmanager
def solver_errors() -> Iterator[None]:
    """What gtsam raises, as one of the library's errors."""
    try:
        yield
    except (RuntimeError, IndexError) as error:
        reason = " ".join(str(error).split())[:120]
        raise SolverError(f"the pose graph cannot be solved ({reason}); reset to begin a new map") from error
