"""Edges as rtabmap_msgs/Link.

Its ends are RTAB-Map's own node ids, so that a table between these and stamps is needed, which the nodes in
rtabmap_msgs/MapData give; its transform is T_from_to between base frames (see `bodies`). Its information is
translation first, of a perturbation on the right: RTAB-Map's optimisers put it on the axes of `to`. A link
whose rotation is unknown has a rotation variance of 9999 and more.
"""

from collections.abc import Mapping

import numpy as np
from geometry_msgs.msg import Point, Pose, Transform
from rtabmap_msgs.msg import Link

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.records import NO_ID, Edge, EdgeKind
from neuse_slam_node.map_frame import transform_to_msg
from neuse_slam_node.poses import transform_from_msg

NEIGHBOR, USER_CLOSURE = 0, 4  # of rtabmap::Link::Type


def edge_to_link(edge: Edge, node_ids: Mapping[int, int]) -> Link | None:
    """node_ids: RTAB-Map's node by stamp_ns. None where an end is no node of RTAB-Map."""
    if edge.from_stamp_ns not in node_ids or edge.to_stamp_ns not in node_ids:
        return None
    message = Link()
    message.from_id, message.to_id = node_ids[edge.from_stamp_ns], node_ids[edge.to_stamp_ns]
    message.type = NEIGHBOR if edge.kind == EdgeKind.ODOMETRY else USER_CLOSURE
    message.transform = transform_to_msg(edge.T_from_to)
    message.information = _other_order(np.linalg.inv(edge.covariance)).reshape(36)
    return message


def edge_from_link(message: Link, stamps_ns: Mapping[int, int]) -> Edge | None:
    """stamps_ns: stamp by RTAB-Map's node. None where a node's stamp is unknown.

    Raises:
        InputError: `pose`, or `information` that cannot be inverted.
    """
    if message.from_id not in stamps_ns or message.to_id not in stamps_ns:
        return None
    information = np.array(message.information, dtype=np.float64).reshape(6, 6)
    from_ns, to_ns = stamps_ns[message.from_id], stamps_ns[message.to_id]
    T_from_to, covariance = _transform(message.transform), _inverted(_other_order(information))
    return Edge(NO_ID, NO_ID, from_ns, to_ns, EdgeKind.EXTERNAL, T_from_to, covariance)


def _transform(message: Transform) -> Array:
    translation = message.translation
    position = Point(x=translation.x, y=translation.y, z=translation.z)
    return transform_from_msg(Pose(position=position, orientation=message.rotation))


def _other_order(matrix: Array) -> Array:
    """Rotation first as translation first, and back."""
    return np.roll(matrix, (3, 3), axis=(0, 1))


def _inverted(information: Array) -> Array:
    try:
        np.linalg.cholesky(information)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "information", "a link's information is not positive definite; send the inverse of a covariance"
        ) from error
    return np.linalg.inv(information)
