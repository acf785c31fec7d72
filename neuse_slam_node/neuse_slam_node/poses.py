"""Poses and their covariances in messages as the library's transforms, and back."""

from collections.abc import Sequence

import numpy as np
from geometry_msgs.msg import Point, Pose, PoseWithCovariance, Quaternion

from neuse.errors import InputError
from neuse.geometry import (
    Array,
    covariance_from_ros,
    covariance_to_ros,
    quaternion_xyzw,
    transform_from_quaternion,
)

FARTHEST_M = 1e7  # from the origin of any map: earth-fixed coordinates come that far


def pose_to_msg(T_target_source: Array) -> Pose:
    """A rigid transform as the pose of `source` in `target`."""
    return poses_to_msg(T_target_source[None])[0]


def poses_to_msg(T_target_source: Array) -> list[Pose]:
    """Rigid transforms (n, 4, 4) as poses."""
    positions, quaternions = T_target_source[:, :3, 3].tolist(), quaternion_xyzw(T_target_source).tolist()
    return [
        Pose(position=Point(x=x, y=y, z=z), orientation=Quaternion(x=qx, y=qy, z=qz, w=qw))
        for (x, y, z), (qx, qy, qz, qw) in zip(positions, quaternions, strict=True)
    ]


def transform_from_msg(pose: Pose) -> Array:
    """T_target_source of the pose of `source` in `target`.

    Raises:
        InputError: `pose`, numbers that are not finite or a quaternion that is far from unit length.
    """
    return transforms_from_msg([pose])[0]


def transforms_from_msg(poses: Sequence[Pose]) -> Array:
    """Rigid transforms (n, 4, 4) of poses; raises like `transform_from_msg`."""
    parts = [(pose.position, pose.orientation) for pose in poses]
    numbers = np.array([[p.x, p.y, p.z, q.x, q.y, q.z, q.w] for p, q in parts]).reshape(-1, 7)
    return transforms_from_numbers(numbers[:, :3], numbers[:, 3:])


def transforms_from_numbers(positions: Array, q_xyzw: Array) -> Array:
    """Rigid transforms (n, 4, 4) of positions (n, 3) and quaternions (n, 4); raises like
    `transform_from_msg`."""
    lengths = np.linalg.norm(q_xyzw, axis=1)
    near = (np.abs(positions) < FARTHEST_M).all(axis=1)  # NaN compares false
    for i in np.flatnonzero(~(near & (np.abs(lengths - 1.0) < 0.01))):
        row = [*positions[i].tolist(), *q_xyzw[i].tolist()]
        raise InputError("pose", f"{row} is no pose; send metres and a unit quaternion")
    return transform_from_quaternion(q_xyzw, positions)


def pose_with_covariance_to_msg(T_target_source: Array, covariance: Array) -> PoseWithCovariance:
    """A pose with the library's covariance, which ROS has in another order and on other axes."""
    return poses_with_covariance_to_msg(T_target_source[None], covariance[None])[0]


def poses_with_covariance_to_msg(T_target_source: Array, covariances: Array) -> list[PoseWithCovariance]:
    """Rigid transforms (n, 4, 4) with their covariances (n, 6, 6)."""
    covariances_ros = covariance_to_ros(covariances, T_target_source).reshape(-1, 36)
    pairs = zip(poses_to_msg(T_target_source), covariances_ros, strict=True)
    return [PoseWithCovariance(pose=pose, covariance=covariance) for pose, covariance in pairs]


def pose_with_covariance_from_msg(message: PoseWithCovariance) -> tuple[Array, Array]:
    """T_target_source, and its covariance as the library has it."""
    T_target_source, covariances = poses_with_covariance_from_msg([message])
    return T_target_source[0], covariances[0]


def poses_with_covariance_from_msg(messages: Sequence[PoseWithCovariance]) -> tuple[Array, Array]:
    """Rigid transforms (n, 4, 4) and their covariances (n, 6, 6); raises like `transform_from_msg`."""
    T_target_source = transforms_from_msg([message.pose for message in messages])
    covariances_ros = np.array([message.covariance for message in messages], dtype=np.float64)
    return T_target_source, covariance_from_ros(covariances_ros.reshape(-1, 6, 6), T_target_source)
