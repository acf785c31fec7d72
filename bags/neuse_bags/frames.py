"""Segmented RGB-D frames in bags, both ways: written topic by topic, read back joined by their stamps."""

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace

import numpy as np

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.records import OdometrySample, RgbdFrame
from neuse_bags import topics
from neuse_bags.conversions import (
    CAMERA_FRAME,
    camera_info_to_msg,
    color_from_msg,
    depth_to_msg,
    image_to_msg,
    mask_to_msg,
)
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_encoder_node.conversions import frame_from_msgs, header_to_msg, instances_to_msg, stamp_from_msg
from neuse_encoder_node.stamps import StampJoin
from neuse_slam_node.conversions import odometry_from_msg

JOINED = tuple(topic.name for topic in (topics.DEPTH, topics.MASK, topics.INSTANCES, topics.DEPTH_INFO))
JOIN_CAPACITY = 100
IDENTITY = np.eye(4)


def write_frame(writer: BagWriter, frame: RgbdFrame, namespace: str = "") -> None:
    """Append a frame to a bag whose frame topics are declared; colour only if there is any.

    namespace: of the camera's topics, where there are several.
    """

    def write(topic: topics.TopicSpec, message: object) -> None:
        writer.write(namespace + topic.name, message, frame.stamp_ns)

    header = header_to_msg(frame.stamp_ns, CAMERA_FRAME)
    info = camera_info_to_msg(frame.intrinsics, header)
    write(topics.DEPTH, depth_to_msg(frame.depth_m, header))
    write(topics.DEPTH_INFO, info)
    write(topics.MASK, mask_to_msg(frame.mask, header))
    write(topics.INSTANCES, instances_to_msg(frame.instances, header))
    if frame.color is not None:
        write(topics.COLOR, image_to_msg(frame.color, "rgb8", header))
        write(topics.COLOR_INFO, info)


def read_frames(
    bag: BagReader, on_fault: Callable[[InputError], None], stamps_ns: Collection[int] | None = None
) -> Iterator[RgbdFrame]:
    """The frames of a bag, without colour; what cannot be used is told to `on_fault` and left out.

    stamps_ns: of the wanted frames; None for all.
    Raises:
        BagError: a topic is missing, or the bag is damaged.
    """
    bag.require(JOINED)
    join = StampJoin(JOINED, JOIN_CAPACITY)
    for message in bag.messages(JOINED):
        if stamps_ns is not None and message.header_stamp_ns not in stamps_ns:
            continue
        decoded = message.decode()
        joined = join.add(message.topic, stamp_from_msg(decoded.header.stamp), decoded)
        for stamp_ns, missing in join.take_lost():
            on_fault(InputError("incomplete_frame", f"frame {stamp_ns} ns lacks {', '.join(missing)}"))
        if joined is None:
            continue
        try:
            yield frame_from_msgs(*joined)
        except InputError as error:
            on_fault(error)


def with_color(bag: BagReader, frames: Sequence[RgbdFrame]) -> list[RgbdFrame]:
    """The same frames with the colour images of their stamps, where the bag has any."""
    stamps_ns = {frame.stamp_ns for frame in frames}
    images = (m for m in bag.messages([topics.COLOR.name]) if m.header_stamp_ns in stamps_ns)
    colors = {message.header_stamp_ns: color_from_msg(message.decode()) for message in images}
    return [replace(frame, color=colors.get(frame.stamp_ns)) for frame in frames]


class OdometryTrack:
    """All odometry of a bag; the sample nearest to a stamp is the one that belongs to a frame."""

    def __init__(self, samples: Sequence[OdometrySample]) -> None:
        self._samples = samples
        self._stamps_ns = np.array([sample.stamp_ns for sample in samples], dtype=np.int64)

    def at(self, stamp_ns: int) -> OdometrySample | None:
        """The nearest sample, None where there is no odometry at all; the tracker judges its age."""
        if not self._samples:
            return None
        return self._samples[int(np.argmin(np.abs(self._stamps_ns - stamp_ns)))]


def read_odometry(
    bag: BagReader, refuse: Callable[[InputError], None], T_child_camera: Array = IDENTITY
) -> OdometryTrack:
    """The odometry of a bag, of the camera; empty where it has none.

    Args:
        refuse: told of each message whose pose is none.
        T_child_camera: (4, 4) pose of the camera in the odometry's child frame.
    """
    samples = []
    for message in bag.messages([topics.ODOMETRY.name]):
        try:
            samples.append(odometry_from_msg(message.decode(), T_child_camera))
        except InputError as error:
            refuse(error)
    return OdometryTrack(samples)
