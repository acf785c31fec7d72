"""Hand-made frames of two bumps before a wall, as messages that a test may spoil."""

from array import array
from dataclasses import dataclass
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, Image

from neuse.records import Instance
from neuse_encoder_node.conversions import header_to_msg, instances_to_msg
from neuse_msgs.msg import InstanceArray

HEIGHT, WIDTH = 480, 640
INSTANCES = (Instance(3, "mug", 0.9), Instance(5, "bottle", 0.8))


@dataclass
class FrameMessages:
    """The four messages of one frame."""

    depth: Image
    mask: Image
    instances: InstanceArray
    info: CameraInfo

    def by_topic(self) -> dict[str, Any]:
        return {
            "depth/image": self.depth,
            "segmentation/mask": self.mask,
            "segmentation/instances": self.instances,
            "depth/camera_info": self.info,
        }


def frame_messages(stamp_ns: int) -> FrameMessages:
    """A sound frame."""
    header = header_to_msg(stamp_ns, "camera_optical_frame")
    depth_mm, labels = _pixels()
    info = CameraInfo(header=header, height=HEIGHT, width=WIDTH)
    info.k = np.array([500.0, 0.0, 319.5, 0.0, 500.0, 239.5, 0.0, 0.0, 1.0])
    return FrameMessages(
        image(depth_mm, "16UC1", header),
        image(labels, "mono8", header),
        instances_to_msg(INSTANCES, header),
        info,
    )


def image(pixels: np.ndarray, encoding: str, header: Any) -> Image:
    """(h, w) pixels as an image message."""
    return Image(
        header=header,
        height=pixels.shape[0],
        width=pixels.shape[1],
        encoding=encoding,
        step=pixels.strides[0],
        data=array("B", pixels.tobytes()),
    )


def _pixels() -> tuple[np.ndarray, np.ndarray]:
    """Depth in millimetres and labels: two half spheres of 10 cm, one metre away, before a wall at two."""
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    depth_mm, labels = np.full((HEIGHT, WIDTH), 2000.0), np.zeros((HEIGHT, WIDTH), dtype=np.uint8)
    for instance, center_u in zip(INSTANCES, (200, 440), strict=True):
        square = 50.0**2 - (2.0 * (u - center_u)) ** 2 - (2.0 * (v - 240)) ** 2  # 2 mm a pixel
        labels[square > 0] = instance.label
        depth_mm[square > 0] = 1000.0 - np.sqrt(square[square > 0])
    return depth_mm.astype(np.uint16), labels
