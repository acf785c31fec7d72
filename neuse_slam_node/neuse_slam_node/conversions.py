"""Messages of the slam node as records, and back: poses, odometry, edges, keyframes, tracked frames.

The pair for ObjectChange, which mapper_node publishes, is here as well, since mapper_node builds upon this
package. Every fault of a message is an InputError whose `reason` is a key for counters.
"""

from array import array
from collections.abc import Sequence
from enum import IntEnum
from typing import TypeVar

import numpy as np
from geometry_msgs.msg import PoseStamped, PoseWithCovariance
from nav_msgs.msg import Odometry, Path

from neuse.embedding.code import Code
from neuse.errors import InputError
from neuse.geometry import Array
from neuse.records import (
    ChangeKind,
    Edge,
    EdgeKind,
    Keyframe,
    MatchStatus,
    ObjectChange,
    ObjectStatus,
    OdometrySample,
    TrackedFrame,
    TrackedObservation,
)
from neuse.slam.checks import is_covariance
from neuse.slam.object_frames import is_usable
from neuse.slam.prior_map import PriorMap
from neuse_encoder_node.conversions import (
    code_from_msg,
    header_to_msg,
    intrinsics_to_msg,
    observation_from_msg,
    observation_to_msg,
    pinhole_from_msg,
    stamp_from_msg,
    stamp_to_msg,
)
from neuse_encoder_node.images import depth_from_msg, depth_to_msg
from neuse_msgs.msg import Keyframe as KeyframeMsg
from neuse_msgs.msg import KeyframeArray, ObjectMap, PoseGraphEdge, PoseGraphEdgeArray
from neuse_msgs.msg import ObjectChange as ObjectChangeMsg
from neuse_msgs.msg import TrackedFrame as TrackedFrameMsg
from neuse_msgs.msg import TrackedObservation as TrackedObservationMsg
from neuse_slam_node.poses import (
    pose_to_msg,
    pose_with_covariance_from_msg,
    pose_with_covariance_to_msg,
    poses_to_msg,
    poses_with_covariance_from_msg,
    poses_with_covariance_to_msg,
    transform_from_msg,
    transforms_from_msg,
)

Kind = TypeVar("Kind", bound=IntEnum)
LARGEST_ID = 2**62


def odometry_from_msg(message: Odometry, T_child_camera: Array) -> OdometrySample:
    """Pose of the camera in the odometry's frame, whose child frame may be another part of the robot."""
    T_odom_child = transform_from_msg(message.pose.pose)
    return OdometrySample(stamp_from_msg(message.header.stamp), T_odom_child @ T_child_camera)


def odometry_to_msg(frame: TrackedFrame, map_frame: str, camera_frame: str) -> Odometry:
    """The estimated pose of the camera in the map; twist is not estimated."""
    message = Odometry(header=header_to_msg(frame.stamp_ns, map_frame), child_frame_id=camera_frame)
    message.pose = pose_with_covariance_to_msg(frame.T_map_camera, frame.covariance)
    return message


def path_to_msg(keyframes: Sequence[Keyframe], map_frame: str) -> Path:
    """The keyframes as a path."""
    headers = [header_to_msg(keyframe.stamp_ns, map_frame) for keyframe in keyframes]
    poses = poses_to_msg(_stack(keyframes))
    stamped = [PoseStamped(header=h, pose=pose) for h, pose in zip(headers, poses, strict=True)]
    return Path(header=header_to_msg(keyframes[-1].stamp_ns if keyframes else 0, map_frame), poses=stamped)


def edges_to_msgs(edges: Sequence[Edge]) -> list[PoseGraphEdge]:
    """Relative poses between keyframes."""
    T_from_to = np.array([edge.T_from_to for edge in edges]).reshape(-1, 4, 4)
    covariances = np.array([edge.covariance for edge in edges]).reshape(-1, 6, 6)
    poses = poses_with_covariance_to_msg(T_from_to, covariances)
    return [_edge_to_msg(edge, pose) for edge, pose in zip(edges, poses, strict=True)]


def edges_from_msgs(messages: Sequence[PoseGraphEdge]) -> list[Edge]:
    """Relative poses between keyframes.

    Raises:
        InputError: `pose` or `enum_value`.
    """
    T_from_to, covariances = poses_with_covariance_from_msg([message.pose for message in messages])
    return [_edge_from_msg(*each) for each in zip(messages, T_from_to, covariances, strict=True)]


def edges_to_msg(edges: Sequence[Edge], stamp_ns: int, camera_frame: str) -> PoseGraphEdgeArray:
    """The edges that one frame added."""
    return PoseGraphEdgeArray(header=header_to_msg(stamp_ns, camera_frame), edges=edges_to_msgs(edges))


def keyframes_to_msg(keyframes: Sequence[Keyframe], stamp_ns: int, map_frame: str) -> KeyframeArray:
    """All keyframes; the stamp is that of the newest frame."""
    messages = [
        KeyframeMsg(keyframe_id=keyframe.keyframe_id, stamp=stamp_to_msg(keyframe.stamp_ns), pose=pose)
        for keyframe, pose in zip(keyframes, poses_to_msg(_stack(keyframes)), strict=True)
    ]
    return KeyframeArray(header=header_to_msg(stamp_ns, map_frame), keyframes=messages)


def keyframes_from_msg(message: KeyframeArray) -> tuple[Keyframe, ...]:
    """All keyframes.

    Raises:
        InputError: `pose`.
    """
    T_map_camera = transforms_from_msg([item.pose for item in message.keyframes])
    return tuple(
        Keyframe(item.keyframe_id, stamp_from_msg(item.stamp), T)
        for item, T in zip(message.keyframes, T_map_camera, strict=True)
    )


def tracked_frame_to_msg(frame: TrackedFrame, map_frame: str, camera_frame: str) -> TrackedFrameMsg:
    """A frame with its pose and objects."""
    return TrackedFrameMsg(
        header=header_to_msg(frame.stamp_ns, map_frame),
        child_frame_id=camera_frame,
        pose=pose_with_covariance_to_msg(frame.T_map_camera, frame.covariance),
        observations=[_tracked_to_msg(tracked) for tracked in frame.observations],
        intrinsics=intrinsics_to_msg(frame.intrinsics),
        coarse_depth=depth_to_msg(frame.coarse_depth_m, header_to_msg(frame.stamp_ns, camera_frame)),
        keyframe_id=frame.keyframe_id,
        loop_closed=frame.loop_closed,
        odometry_only=frame.odometry_only,
        edges=edges_to_msgs(frame.edges),
        rejected_edges=frame.rejected_edges,
    )


def tracked_frame_from_msg(message: TrackedFrameMsg) -> TrackedFrame:
    """A frame with its pose and objects.

    Raises:
        InputError: `array_length`, `pose`, `covariance`, `enum_value`, `intrinsics`, or `code` of an object.
    """
    T_map_camera, covariance = pose_with_covariance_from_msg(message.pose)
    if not is_covariance(covariance):
        raise InputError("covariance", "the pose's covariance is none; send a positive definite matrix")
    return TrackedFrame(
        stamp_ns=stamp_from_msg(message.header.stamp),
        T_map_camera=T_map_camera,
        covariance=covariance,
        observations=tuple(_tracked_from_msg(item) for item in message.observations),
        intrinsics=pinhole_from_msg(message.intrinsics),
        coarse_depth_m=depth_from_msg(message.coarse_depth),
        keyframe_id=message.keyframe_id,
        loop_closed=bool(message.loop_closed),
        odometry_only=bool(message.odometry_only),
        edges=tuple(edges_from_msgs(message.edges)),
        rejected_edges=message.rejected_edges,
    )


def change_to_msg(change: ObjectChange, map_frame: str) -> ObjectChangeMsg:
    """A change of the scene."""
    return ObjectChangeMsg(
        header=header_to_msg(change.stamp_ns, map_frame),
        kind=int(change.kind),
        object_id=change.object_id,
        category=change.category,
        before=[] if change.T_map_before is None else [pose_to_msg(change.T_map_before)],
        after=[] if change.T_map_after is None else [pose_to_msg(change.T_map_after)],
        merged_id=change.merged_id,
    )


def change_from_msg(message: ObjectChangeMsg) -> ObjectChange:
    """A change of the scene.

    Raises:
        InputError: `pose`, or `enum_value`.
    """
    return ObjectChange(
        stamp_ns=stamp_from_msg(message.header.stamp),
        kind=_enum(ChangeKind, message.kind),
        object_id=message.object_id,
        category=message.category,
        T_map_before=transform_from_msg(message.before[0]) if message.before else None,
        T_map_after=transform_from_msg(message.after[0]) if message.after else None,
        merged_id=message.merged_id,
    )


def prior_map_from_msg(message: ObjectMap) -> PriorMap:
    """What a map tells a session that did not make it.

    Raises:
        InputError: `array_length`, `enum_value`, `object_id`.
    """
    return PriorMap.told(
        (_name(item.object_id), _enum(ObjectStatus, item.status), code_from_msg(item.code))
        for item in message.objects
    )


def _edge_to_msg(edge: Edge, pose: PoseWithCovariance) -> PoseGraphEdge:
    return PoseGraphEdge(
        from_id=edge.from_id,
        to_id=edge.to_id,
        from_stamp=stamp_to_msg(edge.from_stamp_ns),
        to_stamp=stamp_to_msg(edge.to_stamp_ns),
        kind=int(edge.kind),
        pose=pose,
        object_ids=array("q", edge.object_ids),
        residual_m=float(edge.residual_m),
    )


def _edge_from_msg(message: PoseGraphEdge, T_from_to: Array, covariance: Array) -> Edge:
    return Edge(
        from_id=message.from_id,
        to_id=message.to_id,
        from_stamp_ns=stamp_from_msg(message.from_stamp),
        to_stamp_ns=stamp_from_msg(message.to_stamp),
        kind=_enum(EdgeKind, message.kind),
        T_from_to=T_from_to,
        covariance=covariance,
        object_ids=tuple(message.object_ids),
        residual_m=message.residual_m,
    )


def _tracked_to_msg(tracked: TrackedObservation) -> TrackedObservationMsg:
    return TrackedObservationMsg(
        observation=observation_to_msg(tracked.observation),
        status=int(tracked.status),
        object_id=tracked.object_id,
        similar_ids=array("q", tracked.similar_ids),
    )


def _tracked_from_msg(message: TrackedObservationMsg) -> TrackedObservation:
    observation, status = observation_from_msg(message.observation), _enum(MatchStatus, message.status)
    if status != MatchStatus.TENTATIVE:
        check_code(observation.code)
    return TrackedObservation(
        observation=observation,
        status=status,
        object_id=message.object_id,
        similar_ids=tuple(message.similar_ids),
    )


def check_code(code: Code) -> None:
    """Raises InputError `code` unless this can be the code of an object."""
    if not is_usable(code) or not code.category:
        raise InputError("code", f"code of {code.category!r} is none; send finite numbers, positive sigmas")


def _name(object_id: int) -> int:
    """The id, which must leave room for those that come after it."""
    if not 0 <= object_id < LARGEST_ID:
        raise InputError("object_id", f"no object is called {object_id}; count from 0")
    return object_id


def _stack(keyframes: Sequence[Keyframe]) -> Array:
    """(n, 4, 4) T_map_camera."""
    return np.array([keyframe.T_map_camera for keyframe in keyframes]).reshape(-1, 4, 4)


def _enum(kind: type[Kind], value: int) -> Kind:
    try:
        return kind(value)
    except ValueError:
        known = list(map(int, kind))
        raise InputError("enum_value", f"{kind.__name__} has no value {value}; send one of {known}") from None
