"""Records and drawings of the mapper node as messages, and back: object map, markers, point cloud."""

from array import array

import numpy as np
from geometry_msgs.msg import Point, Vector3
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker as MarkerMsg
from visualization_msgs.msg import MarkerArray

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.mapping.markers import Marker, MarkerKind
from neuse.records import MapObject, ObjectMap, ObjectStatus
from neuse_encoder_node.conversions import (
    code_from_msg,
    code_to_msg,
    header_to_msg,
    stamp_from_msg,
    stamp_to_msg,
)
from neuse_msgs.msg import MapObject as MapObjectMsg
from neuse_msgs.msg import ObjectMap as ObjectMapMsg
from neuse_slam_node.conversions import check_code
from neuse_slam_node.poses import FARTHEST_M, pose_to_msg, transform_from_msg

KINDS = {
    MarkerKind.MESH: MarkerMsg.TRIANGLE_LIST,
    MarkerKind.TEXT: MarkerMsg.TEXT_VIEW_FACING,
    MarkerKind.ARROW: MarkerMsg.ARROW,
}
POINT = np.dtype([("xyz", "<f4", 3), ("rgb", "<u4")])


def object_map_to_msg(object_map: ObjectMap, map_frame: str) -> ObjectMapMsg:
    """The map at one instant."""
    header = header_to_msg(object_map.stamp_ns, map_frame)
    return ObjectMapMsg(header=header, objects=[_object_to_msg(known) for known in object_map.objects])


def object_map_from_msg(message: ObjectMapMsg) -> ObjectMap:
    """The map at one instant.

    Raises:
        InputError: `array_length`, `pose`, `enum_value`, `box` or `code`.
    """
    stamp_ns = stamp_from_msg(message.header.stamp)
    return ObjectMap(stamp_ns, tuple(_object_from_msg(item) for item in message.objects))


def markers_to_msg(markers: list[Marker], stamp_ns: int, map_frame: str) -> MarkerArray:
    """Drawings of the map."""
    header = header_to_msg(stamp_ns, map_frame)
    return MarkerArray(markers=[_marker_to_msg(marker, header) for marker in markers])


def points_to_msg(points: Array, colors: Array, stamp_ns: int, map_frame: str) -> PointCloud2:
    """(n, 3) metres and (n, 3) RGB in [0, 1] as a cloud with fields x, y, z and rgb."""
    packed = np.zeros(len(points), dtype=POINT)
    red, green, blue = (np.asarray(colors) * 255).astype(np.uint32).T
    packed["xyz"], packed["rgb"] = points, red << 16 | green << 8 | blue
    offsets = {"x": 0, "y": 4, "z": 8, "rgb": 12}
    return PointCloud2(
        header=header_to_msg(stamp_ns, map_frame),
        height=1,
        width=len(points),
        fields=[
            PointField(name=name, offset=offset, datatype=PointField.FLOAT32, count=1)
            for name, offset in offsets.items()
        ],
        point_step=POINT.itemsize,
        row_step=POINT.itemsize * len(points),
        data=array("B", packed.tobytes()),
        is_dense=True,
    )


def _object_to_msg(known: MapObject) -> MapObjectMsg:
    x, y, z = np.asarray(known.box_center).tolist()
    width, depth, height = np.asarray(known.box_size).tolist()
    return MapObjectMsg(
        object_id=known.object_id,
        category=known.category,
        status=int(known.status),
        pose=pose_to_msg(known.T_map_object),
        box_center=Point(x=x, y=y, z=z),
        box_size=Vector3(x=width, y=depth, z=height),
        code=code_to_msg(known.code),
        first_seen=stamp_to_msg(known.first_seen_ns),
        last_seen=stamp_to_msg(known.last_seen_ns),
        n_observations=known.n_observations,
    )


def box_from_msg(message: MapObjectMsg) -> tuple[Array, Array]:
    """(3,) centre and (3,) sides of an object's box, metres.

    Raises:
        InputError: `box`, it has none.
    """
    center, size = message.box_center, message.box_size
    box = np.array([[center.x, center.y, center.z], [size.x, size.y, size.z]])
    if not ((np.abs(box) < FARTHEST_M).all() and (box[1] >= 0).all()):  # NaN compares false
        raise InputError("box", f"object {message.object_id} has no box; send finite, positive sides")
    return box[0], box[1]


def _object_from_msg(message: MapObjectMsg) -> MapObject:
    if message.status not in list(ObjectStatus):
        raise InputError("enum_value", f"object {message.object_id} has status {message.status}; send 0 to 3")
    box_center, box_size = box_from_msg(message)
    code = code_from_msg(message.code)
    check_code(code)
    return MapObject(
        object_id=message.object_id,
        category=message.category,
        status=ObjectStatus(message.status),
        T_map_object=transform_from_msg(message.pose),
        box_center=box_center,
        box_size=box_size,
        code=code,
        first_seen_ns=stamp_from_msg(message.first_seen),
        last_seen_ns=stamp_from_msg(message.last_seen),
        n_observations=message.n_observations,
    )


def _marker_to_msg(marker: Marker, header: Header) -> MarkerMsg:
    message = MarkerMsg(header=header, ns=marker.namespace, id=marker.marker_id)
    if marker.kind == MarkerKind.DELETE_ALL:
        message.action = MarkerMsg.DELETEALL
        return message
    message.type = KINDS[marker.kind]
    red, green, blue, alpha = map(float, marker.color)
    message.color = ColorRGBA(r=red, g=green, b=blue, a=alpha)
    message.scale = _scale(marker)
    points = [Point(x=x, y=y, z=z) for x, y, z in np.asarray(marker.points, dtype=np.float64).tolist()]
    if marker.kind == MarkerKind.TEXT:
        message.text, message.pose.position = marker.text, points[0]
    else:
        message.points = points
    return message


def _scale(marker: Marker) -> Vector3:
    """As viewers expect it: height of a text in z; shaft, head width and head length of an arrow."""
    size = float(marker.scale_m)
    if marker.kind == MarkerKind.ARROW:
        return Vector3(x=size, y=2 * size, z=3 * size)
    return Vector3(x=1.0, y=1.0, z=1.0) if marker.kind == MarkerKind.MESH else Vector3(z=size)
