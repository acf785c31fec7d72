"""Messages of the encoder node as records, and back: segmented frames and object observations.

Whatever has the fields of a message will do, so that a bag reader's own classes can be passed. Every fault of
a message is an InputError whose `reason` is a key for counters.
"""

from array import array
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from neuse.embedding.code import Code
from neuse.errors import InputError
from neuse.records import Instance, Intrinsics, Observation, ObservedFrame, Rejection, RgbdFrame
from neuse_encoder_node.images import depth_from_msg, depth_to_msg, mask_from_msg
from neuse_msgs.msg import Code as CodeMsg
from neuse_msgs.msg import Instance as InstanceMsg
from neuse_msgs.msg import InstanceArray, ObjectObservation, ObjectObservationArray
from neuse_msgs.msg import Intrinsics as IntrinsicsMsg
from neuse_msgs.msg import Rejection as RejectionMsg

FARTHEST_M = 1e4  # of a point from the camera
MOST_OBSERVATIONS = 250  # of a frame


def stamp_from_msg(stamp: Time) -> int:
    """A message stamp as integer nanoseconds.

    Raises:
        InputError: `stamp`, it is before 1970 or has more nanoseconds than a second.
    """
    if stamp.sec < 0 or stamp.nanosec >= 10**9:
        raise InputError("stamp", f"stamp {stamp.sec} s {stamp.nanosec} ns is no time; send one of a clock")
    return stamp.sec * 10**9 + stamp.nanosec


def stamp_to_msg(stamp_ns: int) -> Time:
    """Integer nanoseconds as a message stamp."""
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def header_to_msg(stamp_ns: int, frame_id: str) -> Header:
    """Header of one instant and frame."""
    return Header(stamp=stamp_to_msg(stamp_ns), frame_id=frame_id)


def frame_from_msgs(depth: Image, mask: Image, instances: InstanceArray, info: CameraInfo) -> RgbdFrame:
    """One segmented depth image from its four messages, whose stamps are equal.

    Raises:
        InputError: `encoding` or `array_length`; whether the four fit together the observer checks.
    """
    return RgbdFrame(
        stamp_ns=stamp_from_msg(depth.header.stamp),
        depth_m=depth_from_msg(depth),
        mask=mask_from_msg(mask),
        instances=instances_from_msg(instances),
        intrinsics=intrinsics_from_msg(info),
    )


def intrinsics_from_msg(info: CameraInfo) -> Intrinsics:
    """Pinhole camera of the image; where the raw one is distorted, of the rectified one, which p tells."""
    fx, _, cx, _, fy, cy = (float(value) for value in info.k[:6])
    if is_distorted(info):
        fx, _, cx, _, _, fy, cy = (float(value) for value in info.p[:7])
    return Intrinsics(info.width, info.height, fx, fy, cx, cy)


def is_distorted(info: CameraInfo) -> bool:
    """Whether straight lines are bent in the camera's raw image, and p tells how the rectified one is."""
    return any(info.d) and info.p[0] > 0 and info.p[5] > 0


def instances_from_msg(message: InstanceArray) -> tuple[Instance, ...]:
    """The entries of a segmentation."""
    return tuple(Instance(item.label, item.category, item.score) for item in message.instances)


def instances_to_msg(instances: tuple[Instance, ...], header: Header) -> InstanceArray:
    """Entries of a segmentation; the header's stamp is the mask's."""
    items = [InstanceMsg(label=i.label, category=i.category, score=float(i.score)) for i in instances]
    return InstanceArray(header=header, instances=items)


def code_to_msg(code: Code) -> CodeMsg:
    """Latent code; the frame is that of the message around it."""
    return CodeMsg(
        category=code.category,
        ambiguous=code.ambiguous,
        z=floats("d", code.z),
        descriptor=floats("d", code.descriptor),
        sigmas=np.asarray(code.sigmas, dtype=np.float64),
        height_correlation=float(code.height_correlation),
    )


def code_from_msg(message: CodeMsg) -> Code:
    """Latent code.

    Raises:
        InputError: `array_length`, z is not k x 3 with even k >= 4, or the descriptor has not k entries.
    """
    k, rest = divmod(len(message.z), 3)
    if rest or k < 4 or k % 2 or len(message.descriptor) != k:
        found = f"{len(message.z)} numbers in z and {len(message.descriptor)} in descriptor"
        raise InputError("array_length", f"code has {found}; send 3 k and k, k even and at least 4")
    z = np.array(message.z, dtype=np.float64).reshape(k, 3)
    descriptor = np.array(message.descriptor, dtype=np.float64)
    sigmas = np.array(message.sigmas, dtype=np.float64)
    correlation = float(message.height_correlation)
    return Code(message.category, bool(message.ambiguous), z, descriptor, sigmas, correlation)


def observation_to_msg(observation: Observation) -> ObjectObservation:
    """One object seen in one frame."""
    x, y, z = map(float, observation.partial_center)
    return ObjectObservation(
        label=observation.label,
        score=float(observation.score),
        code=code_to_msg(observation.code),
        cloud=floats("f", observation.cloud),
        partial_center=Point(x=x, y=y, z=z),
        mask_px=observation.mask_px,
        touches_border=observation.touches_border,
    )


def observation_from_msg(message: ObjectObservation) -> Observation:
    """One object seen in one frame.

    Raises:
        InputError: `array_length`, in the code, or in a cloud that is not m x 3; `not_finite`, in cloud,
            centre or score. Codes that are not finite are for the tracker to count.
    """
    if len(message.cloud) % 3:
        raise InputError("array_length", f"cloud has {len(message.cloud)} numbers; send 3 a point")
    cloud = np.array(message.cloud, dtype=np.float32).reshape(-1, 3)
    center = np.array([message.partial_center.x, message.partial_center.y, message.partial_center.z])
    if not (_is_near(cloud) and _is_near(center) and 0.0 <= message.score <= 1.0):
        raise InputError("not_finite", f"cloud, centre or score of instance {message.label} is none; drop it")
    return Observation(
        label=message.label,
        score=message.score,
        code=code_from_msg(message.code),
        cloud=cloud,
        partial_center=center,
        mask_px=message.mask_px,
        touches_border=bool(message.touches_border),
    )


def _is_near(points: np.ndarray) -> bool:
    """Whether all coordinates are finite and within any camera's range."""
    return bool((np.abs(points) < FARTHEST_M).all())  # NaN compares false


def observed_frame_to_msg(frame: ObservedFrame, frame_id: str) -> ObjectObservationArray:
    """All objects of one frame; frame_id: the camera optical frame."""
    header = header_to_msg(frame.stamp_ns, frame_id)
    return ObjectObservationArray(
        header=header,
        observations=[observation_to_msg(observation) for observation in frame.observations],
        intrinsics=intrinsics_to_msg(frame.intrinsics),
        coarse_depth=depth_to_msg(frame.coarse_depth_m, header),
        rejections=[RejectionMsg(reason=r.reason, detail=r.detail) for r in frame.rejections],
    )


def observed_frame_from_msg(message: ObjectObservationArray) -> ObservedFrame:
    """All objects of one frame.

    Raises:
        InputError: `too_many`, or whatever is wrong with an observation, the camera or the depth.
    """
    if len(message.observations) > MOST_OBSERVATIONS:
        raise InputError("too_many", f"frame has {len(message.observations)} observations; raise min_score")
    return ObservedFrame(
        stamp_ns=stamp_from_msg(message.header.stamp),
        observations=tuple(observation_from_msg(item) for item in message.observations),
        intrinsics=pinhole_from_msg(message.intrinsics),
        coarse_depth_m=depth_from_msg(message.coarse_depth),
        rejections=tuple(Rejection(item.reason, item.detail) for item in message.rejections),
    )


def intrinsics_to_msg(intrinsics: Intrinsics) -> IntrinsicsMsg:
    """Pinhole camera, pixels."""
    return IntrinsicsMsg(
        width=intrinsics.width,
        height=intrinsics.height,
        fx=float(intrinsics.fx),
        fy=float(intrinsics.fy),
        cx=float(intrinsics.cx),
        cy=float(intrinsics.cy),
    )


def pinhole_from_msg(message: IntrinsicsMsg) -> Intrinsics:
    """Pinhole camera, pixels.

    Raises:
        InputError: `intrinsics`, no camera has these.
    """
    made = Intrinsics(message.width, message.height, message.fx, message.fy, message.cx, message.cy)
    if not made.is_sound:
        raise InputError("intrinsics", f"{made} is no camera; send positive and finite numbers")
    return made


def floats(typecode: str, values: Any) -> array:
    """Numbers as the flat array that message fields take without a check of every element."""
    flat = array(typecode)
    flat.frombytes(np.ascontiguousarray(values, dtype=typecode).tobytes())
    return flat
