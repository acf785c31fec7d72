"""Rigid transforms as (4, 4) float64 arrays: p_target = T_target_source @ p_source.

Tangent vectors are (6,) rotation first, [omega rad, v m], and perturb on the right (in the source frame):
T_true = T @ exp(xi). Covariances inside the library are of that xi, as in GTSAM. ROS orders translation
first, on the axes of the target frame; only this module converts.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]


def make_transform(R: ArrayLike, t: ArrayLike) -> Array:
    """(..., 4, 4) transforms from (..., 3, 3) rotations and (..., 3) translations."""
    T = np.zeros((*np.shape(t)[:-1], 4, 4))
    T[..., :3, :3], T[..., :3, 3], T[..., 3, 3] = R, t, 1.0
    return T


def inverse(T: Array) -> Array:
    """Inverse of rigid transforms, (..., 4, 4)."""
    R_transposed = np.swapaxes(T[..., :3, :3], -1, -2)
    inverted = np.zeros_like(T)
    inverted[..., :3, :3] = R_transposed
    inverted[..., :3, 3] = -(R_transposed @ T[..., :3, 3:])[..., 0]
    inverted[..., 3, 3] = 1.0
    return inverted


def renormalized(T: Array) -> Array:
    """T with its rotation orthonormal again; rounding grows exponentially in long products with inverses."""
    renormal = T.copy()
    R = T[:3, :3]
    renormal[:3, :3] = R @ (1.5 * np.eye(3) - 0.5 * R.T @ R)  # Newton's step towards the nearest rotation
    return renormal


def transform_points(T: Array, points: ArrayLike) -> Array:
    """p_target = T_target_source @ p_source for points of shape (n, 3) or (3,)."""
    return np.asarray(points, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]


def rotation_angle(R: Array) -> float:
    """Angle of a (3, 3) rotation, radians in [0, pi]."""
    return float(Rotation.from_matrix(R).magnitude())


def skew(v: ArrayLike) -> Array:
    """(3, 3) matrix with skew(v) @ w = v x w."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _left_jacobian(omega: Array) -> Array:
    angle = float(np.linalg.norm(omega))
    K = skew(omega)
    if angle < 1e-6:
        return np.eye(3) + K / 2 + K @ K / 6
    return np.eye(3) + (1 - np.cos(angle)) / angle**2 * K + (angle - np.sin(angle)) / angle**3 * K @ K


def exp(xi: ArrayLike) -> Array:
    """SE(3) exponential of a (6,) tangent vector [omega, v]."""
    xi = np.asarray(xi, dtype=np.float64)
    J = _left_jacobian(xi[:3])
    return make_transform(np.eye(3) + skew(xi[:3]) @ J, J @ xi[3:])  # Rodrigues: R = I + [omega] J


def log(T: Array) -> Array:
    """SE(3) logarithm, (6,) tangent vector [omega, v]; inverse of `exp`."""
    omega = Rotation.from_matrix(T[:3, :3]).as_rotvec()
    return np.concatenate([omega, np.linalg.solve(_left_jacobian(omega), T[:3, 3])])


def adjoint(T: Array) -> Array:
    """(6, 6) adjoint: T @ exp(xi) = exp(adjoint(T) @ xi) @ T."""
    R, t = T[:3, :3], T[:3, 3]
    return np.block([[R, np.zeros((3, 3))], [skew(t) @ R, R]])


def transform_from_quaternion(q_xyzw: ArrayLike, t: ArrayLike) -> Array:
    """(..., 4, 4) transforms from (..., 4) quaternions in x, y, z, w order and (..., 3) translations."""
    return make_transform(Rotation.from_quat(np.asarray(q_xyzw, dtype=np.float64)).as_matrix(), t)


def quaternion_xyzw(T: Array) -> Array:
    """(..., 4) unit quaternions of the transforms' rotations, x, y, z, w order, w >= 0."""
    return Rotation.from_matrix(T[..., :3, :3]).as_quat(canonical=True)


def covariance_to_ros(covariance: Array, T_target_source: Array) -> Array:
    """Library covariances (..., 6, 6), rotation first and on source axes, as ROS has them: translation first,
    on target axes."""
    return _permute_and_rotate(covariance, T_target_source[..., :3, :3])


def covariance_from_ros(covariance_ros: Array, T_target_source: Array) -> Array:
    """ROS covariances (..., 6, 6), translation first and on target axes, as the library has them: rotation
    first, on source axes."""
    return _permute_and_rotate(covariance_ros, np.swapaxes(T_target_source[..., :3, :3], -1, -2))


def _permute_and_rotate(covariance: Array, R: Array) -> Array:
    blocks = covariance.reshape(*covariance.shape[:-2], 2, 3, 2, 3)[..., ::-1, :, ::-1, :]
    blocks = np.swapaxes(blocks, -3, -2)  # (..., 2, 2, 3, 3)
    R = R[..., None, None, :, :]
    return np.swapaxes(R @ blocks @ np.swapaxes(R, -1, -2), -3, -2).reshape(covariance.shape)
