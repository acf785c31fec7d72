"""Records as the messages that bags publish: camera, segmentation, odometry and ground truth."""

from array import array
from collections.abc import Iterable

import numpy as np
from geometry_msgs.msg import Point, Vector3
from nav_msgs.msg import Odometry
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from neuse.evaluation.truth import TrueObject
from neuse.geometry import Array
from neuse.records import Intrinsics
from neuse_encoder_node.conversions import header_to_msg
from neuse_mapper_node.conversions import box_from_msg
from neuse_msgs.msg import Code, MapObject, ObjectMap
from neuse_slam_node.poses import pose_to_msg, transform_from_msg

CAMERA_FRAME = "camera_optical_frame"
WORLD_FRAME = "world"
_ENCODINGS = {"mono8": np.uint8, "16UC1": np.uint16, "rgb8": np.uint8}
# bytes of a pixel, and where its red, green and blue are
_CHANNELS = {
    **{"rgb8": (3, (0, 1, 2)), "bgr8": (3, (2, 1, 0)), "mono8": (1, (0, 0, 0))},
    **{"rgba8": (4, (0, 1, 2)), "bgra8": (4, (2, 1, 0))},
}


def image_to_msg(pixels: np.ndarray, encoding: str, header: Header) -> Image:
    """(h, w) or (h, w, 3) pixels as an image of encoding mono8, 16UC1 or rgb8."""
    contiguous = np.ascontiguousarray(pixels, dtype=_ENCODINGS[encoding])
    height, width = contiguous.shape[:2]
    data = array("B", contiguous.tobytes())
    step = contiguous.strides[0]
    return Image(header=header, height=height, width=width, encoding=encoding, step=step, data=data)


def color_from_msg(image: Image) -> np.ndarray | None:
    """(h, w, 3) uint8 RGB; None for an encoding that only viewers know, or data that is cut."""
    size, order = _CHANNELS.get(image.encoding, (0, ()))
    row_bytes, n_bytes = image.width * size, image.step * image.height
    if not 0 < row_bytes <= image.step or not 0 < n_bytes <= len(image.data):
        return None
    rows = np.frombuffer(image.data, dtype=np.uint8)[:n_bytes].reshape(image.height, image.step)
    return rows[:, :row_bytes].reshape(image.height, image.width, size)[..., order]


def depth_to_msg(depth_m: np.ndarray, header: Header) -> Image:
    """(h, w) metres as 16UC1 millimetres; what is no reading, or beyond 65 m, becomes 0."""
    depth_mm = np.nan_to_num(depth_m * 1e3, nan=0.0, posinf=0.0, neginf=0.0)
    depth_mm[(depth_mm < 0) | (depth_mm > 65535)] = 0.0
    return image_to_msg(np.rint(depth_mm), "16UC1", header)


def mask_to_msg(mask: np.ndarray, header: Header) -> Image:
    """(h, w) labels as mono8, or as 16UC1 where a label exceeds 255."""
    return image_to_msg(mask, "mono8" if mask.max(initial=0) <= 255 else "16UC1", header)


def camera_info_to_msg(intrinsics: Intrinsics, header: Header) -> CameraInfo:
    """Pinhole camera without distortion."""
    fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
    return CameraInfo(
        header=header,
        height=intrinsics.height,
        width=intrinsics.width,
        distortion_model="plumb_bob",
        d=[0.0] * 5,
        k=[fx, 0.0, cx, 0.0, fy, cy, 0.0, 0.0, 1.0],
        r=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
        p=[fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
    )


def odometry_to_msg(stamp_ns: int, T_frame_camera: Array, frame_id: str) -> Odometry:
    """Pose of the camera in `frame_id`, without covariance."""
    message = Odometry(header=header_to_msg(stamp_ns, frame_id), child_frame_id=CAMERA_FRAME)
    message.pose.pose = pose_to_msg(T_frame_camera)
    return message


def true_map_to_msg(stamp_ns: int, objects: Iterable[TrueObject]) -> ObjectMap:
    """The true objects as a map without codes; n_observations: frames that saw it at its place."""
    return ObjectMap(
        header=header_to_msg(stamp_ns, WORLD_FRAME), objects=[_true_object_to_msg(item) for item in objects]
    )


def true_objects_from_msg(message: ObjectMap) -> tuple[TrueObject, ...]:
    """The objects of a ground-truth map."""
    return tuple(_true_object_from_msg(item) for item in message.objects)


def _true_object_to_msg(item: TrueObject) -> MapObject:
    cx, cy, cz = map(float, item.T_world_object[:3, 3])
    width, depth, height = map(float, item.box_size)
    return MapObject(
        object_id=item.object_id,
        category=item.category,
        status=MapObject.UNCHANGED,
        pose=pose_to_msg(item.T_world_object),
        box_center=Point(x=cx, y=cy, z=cz),
        box_size=Vector3(x=width, y=depth, z=height),
        code=Code(category=item.category),
        n_observations=item.n_seen,
    )


def _true_object_from_msg(message: MapObject) -> TrueObject:
    _, box_size = box_from_msg(message)
    return TrueObject(
        object_id=message.object_id,
        category=message.category,
        T_world_object=transform_from_msg(message.pose),
        box_size=box_size,
        n_seen=message.n_observations,
    )
