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
    lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    near = (np.abs(numbers) < FARTHEST_M).all(axis=1)  # NaN compares false
    for row in numbers[~(near & (np.abs(lengths - 1.0) < 0.01))]:
        raise InputError("pose", f"{row.tolist()} is no pose; send metres and a unit quaternion")
    return transform_from_quaternion(numbers[:, 3:], numbers[:, :3])


def pose_with_covariance_to_msg(T_target_source: Array, covariance: Array) -> PoseWithCovariance:
    """A pose with the library's covariance, which ROS has in another order and on other axes."""
    covariance_ros = covariance_to_ros(covariance, T_target_source)
    return PoseWithCovariance(pose=pose_to_msg(T_target_source), covariance=covariance_ros.reshape(36))


def pose_with_covariance_from_msg(message: PoseWithCovariance) -> tuple[Array, Array]:
    """T_target_source, and its covariance as the library has it."""
    T_target_source = transform_from_msg(message.pose)
    covariance_ros = np.array(message.covariance, dtype=np.float64).reshape(6, 6)
    return T_target_source, covariance_from_ros(covariance_ros, T_target_source)
