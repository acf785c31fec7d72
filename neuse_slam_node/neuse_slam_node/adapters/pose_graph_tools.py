"""Edges as pose_graph_tools_msgs/PoseGraphEdge, as Hydra reads it, and as Kimera-PGMO does.

Hydra's external loop closures: keys are stamps in nanoseconds, the pose is T_to_from, the covariance is not
read. Kimera-PGMO: keys are indices of keyframes, the pose is T_from_to. The covariance is rotation first, of
a perturbation on the right, in both: the library's own.
"""

from collections.abc import Mapping

import numpy as np
from pose_graph_tools_msgs.msg import PoseGraphEdge

from neuse.geometry import Array
from neuse.records import NO_ID, Edge, EdgeKind
from neuse_encoder_node.conversions import header_to_msg
from neuse_slam_node.adapters.bodies import reversed_pose
from neuse_slam_node.poses import pose_to_msg, transform_from_msg


def edge_to_hydra(edge: Edge, frame_id: str, robot: int = 0) -> PoseGraphEdge:
    """An edge for Hydra's external loop closures."""
    T_to_from, covariance = reversed_pose(edge.T_from_to, edge.covariance)
    message = _message(edge, T_to_from, covariance, frame_id, robot)
    message.key_from, message.key_to = edge.from_stamp_ns, edge.to_stamp_ns
    return message


def edge_from_hydra(message: PoseGraphEdge) -> Edge:
    """An edge whose ends are named by stamps; raises InputError for a pose that is none."""
    T_from_to, covariance = reversed_pose(transform_from_msg(message.pose), _covariance(message))
    return _edge(message.key_from, message.key_to, T_from_to, covariance)


def edge_to_kimera(edge: Edge, frame_id: str, robot: int = 0) -> PoseGraphEdge:
    """An edge between keyframes."""
    message = _message(edge, edge.T_from_to, edge.covariance, frame_id, robot)
    message.key_from, message.key_to = edge.from_id, edge.to_id
    return message


def edge_from_kimera(message: PoseGraphEdge, stamps_ns: Mapping[int, int]) -> Edge | None:
    """An edge between nodes of the other graph, whose stamps its PoseGraph tells; None where one is unknown.

    Raises:
        InputError: the pose is none.
    """
    if message.key_from not in stamps_ns or message.key_to not in stamps_ns:
        return None
    T_from_to = transform_from_msg(message.pose)
    return _edge(stamps_ns[message.key_from], stamps_ns[message.key_to], T_from_to, _covariance(message))


def _message(edge: Edge, T: Array, covariance: Array, frame_id: str, robot: int) -> PoseGraphEdge:
    odometry = edge.kind == EdgeKind.ODOMETRY
    message = PoseGraphEdge(header=header_to_msg(max(edge.from_stamp_ns, edge.to_stamp_ns), frame_id))
    message.robot_from = message.robot_to = robot
    message.type = PoseGraphEdge.ODOM if odometry else PoseGraphEdge.LOOPCLOSE
    message.pose, message.covariance = pose_to_msg(T), covariance.reshape(36)
    return message


def _covariance(message: PoseGraphEdge) -> Array:
    return np.array(message.covariance, dtype=np.float64).reshape(6, 6)


def _edge(from_stamp_ns: int, to_stamp_ns: int, T_from_to: Array, covariance: Array) -> Edge:
    return Edge(NO_ID, NO_ID, from_stamp_ns, to_stamp_ns, EdgeKind.EXTERNAL, T_from_to, covariance)
