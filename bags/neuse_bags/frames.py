"""Segmented RGB-D frames in bags, both ways: written topic by topic, read back joined by their stamps."""

from neuse.records import RgbdFrame
from neuse_bags import topics
from neuse_bags.conversions import (
    CAMERA_FRAME,
    camera_info_to_msg,
    depth_to_msg,
    header_to_msg,
    image_to_msg,
    instances_to_msg,
    mask_to_msg,
)
from neuse_bags.mcap_file import BagWriter


def write_frame(writer: BagWriter, frame: RgbdFrame) -> None:
    """Append a frame to a bag whose frame topics are declared; colour only if there is any."""
    header = header_to_msg(frame.stamp_ns, CAMERA_FRAME)
    info = camera_info_to_msg(frame.intrinsics, header)
    writer.write(topics.DEPTH.name, depth_to_msg(frame.depth_m, header), frame.stamp_ns)
    writer.write(topics.DEPTH_INFO.name, info, frame.stamp_ns)
    writer.write(topics.MASK.name, mask_to_msg(frame.mask, header), frame.stamp_ns)
    writer.write(topics.INSTANCES.name, instances_to_msg(frame.instances, header), frame.stamp_ns)
    if frame.color is not None:
        writer.write(topics.COLOR.name, image_to_msg(frame.color, "rgb8", header), frame.stamp_ns)
        writer.write(topics.COLOR_INFO.name, info, frame.stamp_ns)
