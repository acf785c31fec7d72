"""Compressed images of a bag, unpacked: PNG, JPEG, and depth as image_transport's `compressedDepth`."""

import struct

import cv2
import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import CompressedImage, Image

from neuse.errors import InputError
from neuse_bags import topics
from neuse_bags.conversions import image_to_msg
from neuse_bags.mcap_file import RawMessage
from neuse_bags.pictures import MOST_PIXELS, check_png
from neuse_encoder_node.images import depth_to_msg

PACKED_TYPE, TYPE = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
_DEPTH_HEADER = struct.Struct("<iff")  # what it is, and a, b of `value = a / depth_m + b`
_JPEG, _PNG = b"\xff\xd8", b"\x89PNG"
_ENCODINGS = {np.dtype(np.uint8): "mono8", np.dtype(np.uint16): "16UC1"}


def unpacked(message: RawMessage) -> RawMessage:
    """The same image as a sensor_msgs/Image, with its header, under the topic of the graph that it is for.

    Raises:
        InputError: it is damaged, of a format that is not read here, or labels or depths as JPEG, which
            changes them.
    """
    packed: CompressedImage = message.decode()
    try:
        image = _unpack(packed, is_color=message.topic == topics.COLOR.name)
    except InputError as error:
        told = f"{message.topic} at {message.stamp_ns} ns, format {packed.format!r}: {error}"
        raise InputError(error.reason, told) from error
    return RawMessage(message.topic, TYPE, message.stamp_ns, serialize_message(image))


def _unpack(packed: CompressedImage, is_color: bool) -> Image:
    data = bytes(packed.data)
    if is_color:
        return image_to_msg(_picture(data, cv2.IMREAD_COLOR)[..., ::-1], "rgb8", packed.header)
    of_depth = "compressedDepth" in packed.format
    pixels = _picture(data[_DEPTH_HEADER.size if of_depth else 0 :], cv2.IMREAD_UNCHANGED)
    if pixels.ndim != 2 or pixels.dtype not in _ENCODINGS:
        told = f"{pixels.shape[-1]} channels" if pixels.ndim == 3 else f"{pixels.dtype}"
        raise InputError("encoding", f"it holds {told}; record one channel of 8 or 16 bit")
    if of_depth and packed.format.startswith("32FC1"):
        _, a, b = _DEPTH_HEADER.unpack_from(data)
        return depth_to_msg(_depth_m(pixels, a, b), packed.header)
    return image_to_msg(pixels, _ENCODINGS[pixels.dtype], packed.header)


def _picture(data: bytes, mode: int) -> np.ndarray:
    """Pixels of a PNG, or of a JPEG where colours are asked for."""
    is_color = mode == cv2.IMREAD_COLOR
    if data.startswith(_JPEG) and not is_color:
        raise InputError("encoding", "JPEG changes labels and depths; record PNG, or the image as it is")
    if not data.startswith((_JPEG, _PNG)):
        raise InputError("encoding", "it is no PNG or JPEG; record PNG, or the image as it is")
    check_png(data, MOST_PIXELS, "it")
    pixels = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), mode)
    if pixels is None:
        raise InputError("unreadable_picture", "it is damaged; leave it out of the bag")
    return pixels


def _depth_m(values: np.ndarray, a: float, b: float) -> np.ndarray:
    """(h, w) float32 metres of values that grow with 1 / depth; 0 where there is no reading."""
    inverse = values.astype(np.float32) - np.float32(b)
    usable = (values > 0) & (inverse > 0)
    return np.where(usable, np.float32(a) / np.where(usable, inverse, 1), 0).astype(np.float32)
