"""Image messages as arrays, and back; every fault is an InputError whose `reason` is a key for counters."""

from array import array
from collections.abc import Mapping

import numpy as np
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from neuse.errors import InputError

DEPTH_ENCODINGS = {"16UC1": np.uint16, "mono16": np.uint16, "32FC1": np.float32}
MASK_ENCODINGS = {
    "mono8": np.uint8, "8UC1": np.uint8, "mono16": np.uint16, "16UC1": np.uint16, "32SC1": np.int32
}  # fmt: skip
MILLIMETRE = np.float32(1e-3)


def depth_from_msg(image: Image) -> np.ndarray:
    """(h, w) float32 metres, 0 where there is no finite positive reading."""
    pixels = pixels_from_msg(image, DEPTH_ENCODINGS, "depth image")
    if pixels.dtype.kind == "u":
        return pixels * MILLIMETRE  # float32
    usable = (pixels > 0) & (pixels < np.inf)  # NaN is neither
    return np.where(usable, pixels, np.float32(0)).astype(np.float32, copy=False)


def mask_from_msg(image: Image) -> np.ndarray:
    """(h, w) int32 instance labels, 0 = background."""
    return pixels_from_msg(image, MASK_ENCODINGS, "mask").astype(np.int32)


def pixels_from_msg(image: Image, encodings: Mapping[str, type], name: str) -> np.ndarray:
    """(h, w) view of a single-channel image's data, in the image's own type.

    Raises:
        InputError: `encoding`, not one of `encodings`; `array_length`, the data does not fit the size.
    """
    if image.encoding not in encodings:
        known = ", ".join(encodings)
        raise InputError("encoding", f"{name} has encoding {image.encoding!r}; send one of {known}")
    dtype = np.dtype(encodings[image.encoding]).newbyteorder(">" if image.is_bigendian else "<")
    row_bytes = image.width * dtype.itemsize
    step = image.step or row_bytes
    data = np.frombuffer(image.data, dtype=np.uint8)
    if row_bytes * image.height == 0 or step < row_bytes or data.size < step * image.height:
        found = f"{data.size} bytes for {image.width} x {image.height} pixels with rows of {image.step} bytes"
        raise InputError("array_length", f"{name} has {found}; send whole images")
    rows = data[: step * image.height].reshape(image.height, step)
    return np.ascontiguousarray(rows[:, :row_bytes]).view(dtype)


def depth_to_msg(depth_m: np.ndarray, header: Header) -> Image:
    """(h, w) metres as a 32FC1 image."""
    height, width = depth_m.shape
    data = array("B", np.ascontiguousarray(depth_m, dtype="<f4").tobytes())
    return Image(header=header, height=height, width=width, encoding="32FC1", step=4 * width, data=data)
