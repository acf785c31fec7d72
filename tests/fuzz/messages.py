"""Messages: every field of every message that a node hears, through conversion and stage.

What follows a malformed message shows whether it was refused in time: the stage must stay sound.
"""

import struct
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
from embedding.tiny import make_network
from hypothesis import strategies as st
from mapping.synthetic import five_things, make_world, orbit
from nodes import samples
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage
from slam.synthetic import small_world

from neuse.embedding.embedding import Embedding
from neuse.embedding.observe import Observer, ObserverParams
from neuse.mapping.mapper import ObjectMapper
from neuse.records import (
    ChangeKind,
    Instance,
    Intrinsics,
    Keyframe,
    MatchStatus,
    RgbdFrame,
    TrackedFrame,
)
from neuse.slam.feedback import ChangeFeedback
from neuse.slam.joining import Joiner
from neuse.slam.slam import ObjectSlam
from neuse_bags import conversions as bag_conversions
from neuse_bags.compressed import PACKED_TYPE, unpacked
from neuse_bags.definitions import message_class
from neuse_bags.mcap_file import RawMessage
from neuse_encoder_node import conversions as encoder
from neuse_encoder_node import images as encoder_images
from neuse_encoder_node.detections import instances_from_detections
from neuse_mapper_node import conversions as mapper
from neuse_msgs.msg import Instance as InstanceMsg
from neuse_slam_node import conversions as slam
from neuse_slam_node.map_memory import MapMemory
from neuse_slam_node.packed_keyframes import KeyframeReader, unpack

from .soundness import LATEST_NS, assert_sound
from .spoiling import FLOATS, TEXTS, spoiled_bytes, spoiled_messages
from .target import Target

CAMERA = Intrinsics(32, 24, 30.0, 31.0, 15.5, 11.5)
LATER_NS = 10**9


def message_targets() -> Iterator[Target]:
    """One for each kind of message."""
    yield from _encoder_targets()
    yield from _slam_targets()
    yield from _mapper_targets()
    yield from _bag_targets()


def _encoder_targets() -> Iterator[Target]:
    header = encoder.header_to_msg(samples.STAMP_NS, "camera")
    frame = mug_frame()
    sound = (
        bag_conversions.depth_to_msg(frame.depth_m, header),
        bag_conversions.mask_to_msg(frame.mask, header),
        encoder.instances_to_msg(frame.instances, header),
        bag_conversions.camera_info_to_msg(CAMERA, header),
    )
    names = ("depth/image", "segmentation/mask", "segmentation/instances", "depth/camera_info")
    observer = Observer(ObserverParams(min_points=8), {"mug": Embedding(make_network())})
    for place, name in enumerate(names):

        def read(message: Any, place: int = place) -> None:
            messages = (*sound[:place], message, *sound[place + 1 :])
            assert_sound(observer.observe(encoder.frame_from_msgs(*messages)))

        yield Target(name, spoiled_messages(sound[place]), read)
    detection = st.builds(SimpleNamespace, id=TEXTS, results=st.lists(_hypotheses(), max_size=3))
    array = st.builds(SimpleNamespace, header=st.just(header), detections=st.lists(detection, min_size=1))
    yield Target("segmentation/detections", array, _read_detections)


def _hypotheses() -> st.SearchStrategy[Any]:
    hypothesis = st.builds(SimpleNamespace, class_id=TEXTS, score=FLOATS)
    return st.builds(SimpleNamespace, hypothesis=hypothesis)


def _read_detections(message: Any) -> None:
    for instance in instances_from_detections(message, {}).instances:
        assert isinstance(instance, InstanceMsg)
        assert 0 < instance.label < 2**32


def mug_frame() -> RgbdFrame:
    """A mug before a wall."""
    depth_m, mask = np.full((24, 32), 1.6, dtype=np.float32), np.zeros((24, 32), dtype=np.int32)
    depth_m[4:12, 4:12], mask[4:12, 4:12] = 0.8, 1
    return RgbdFrame(samples.STAMP_NS, depth_m, mask, (Instance(1, "mug", 0.5),), CAMERA)


def _slam_targets() -> Iterator[Target]:
    steps = list(small_world().steps())[:4]
    observed = encoder.observed_frame_to_msg(steps[2].frame, "camera")
    odometry = bag_conversions.odometry_to_msg(
        steps[2].frame.stamp_ns, steps[2].odometry.T_odom_camera, "odom"
    )
    edge = replace(samples.edge(), from_stamp_ns=steps[0].frame.stamp_ns, to_stamp_ns=steps[2].frame.stamp_ns)

    def tracking(act: Callable[[ObjectSlam, Any], None]) -> Callable[[Any], None]:
        """The act on one message amid sound frames, after which the camera must still be where it is."""

        def read(message: Any) -> None:
            stage = ObjectSlam()
            for step in steps[:2]:
                stage.step(step.frame, step.odometry)
            act(stage, message)
            tracked = stage.step(later(steps[3].frame), None)
            assert_sound((tracked.T_map_camera, tracked.covariance, tracked.edges, stage.keyframes))
            _assert_usable(tracked)

        return read

    def later(frame: Any) -> Any:
        return replace(frame, stamp_ns=2**31 * 10**9 - 1)

    def observe(stage: ObjectSlam, message: Any) -> None:
        tracked = stage.step(encoder.observed_frame_from_msg(message), steps[2].odometry)
        assert_sound((tracked.T_map_camera, tracked.covariance, tracked.edges, tracked.intrinsics))
        _assert_usable(tracked)

    def move(stage: ObjectSlam, message: Any) -> None:
        sample = slam.odometry_from_msg(message, np.eye(4))
        assert_sound(sample)
        tracked = stage.step(steps[2].frame, sample)
        assert_sound((tracked.T_map_camera, tracked.covariance, tracked.edges))

    def constrain(stage: ObjectSlam, message: Any) -> None:
        stage.step(steps[2].frame, steps[2].odometry)
        stage.add_external_edges(slam.edges_from_msgs(message.edges))

    def change(stage: ObjectSlam, message: Any) -> None:
        feedback = ChangeFeedback()
        record = slam.change_from_msg(message)
        assert_sound(record)
        feedback.add(record)
        for due in feedback.due(2**63):
            stage.apply_change(due)

    def join(stage: ObjectSlam, message: Any) -> None:
        prior = slam.prior_map_from_msg(message)
        assert_sound((prior.centers, *prior.codes.values()))
        assert max(prior.ids, default=-1) < prior.next_id < 2**63
        Joiner(stage).offer(prior)

    known = mapper.object_map_to_msg(samples.object_map(), "map")
    yield Target("neuse/prior_map", spoiled_messages(known), tracking(join))
    yield Target("neuse/observations", spoiled_messages(observed), tracking(observe))
    yield Target("odom", spoiled_messages(odometry), tracking(move))
    edges = slam.edges_to_msg([edge, edge], samples.STAMP_NS, "camera")
    yield Target("neuse/external_edges", spoiled_messages(edges), tracking(constrain))
    for kind in ChangeKind:
        message = slam.change_to_msg(samples.change(kind), "map")
        yield Target(f"neuse/changes {kind.name}", spoiled_messages(message), tracking(change))


def _assert_usable(tracked: Any) -> None:
    """Codes that stand for objects are sound; one that is not stays without."""
    for item in tracked.observations:
        if item.status != MatchStatus.TENTATIVE:
            assert_sound(item.observation.code)


@cache
def _fed() -> list[tuple[Any, Any]]:
    """What a mapper was fed in a small world: frames and keyframes."""
    fed: list[tuple[Any, Any]] = []

    class Diary(ObjectMapper):
        def step(self, frame: Any, keyframes: Any = ()) -> Any:
            fed.append((frame, tuple(keyframes)))
            return super().step(frame, keyframes)

    make_world(five_things(), Diary({})).tour(orbit(count=6))
    return fed


def toured_mapper() -> ObjectMapper:
    """A mapper that knows a few objects."""
    stage = ObjectMapper({})
    for item in _fed():
        stage.step(*item)
    return stage


def _mapper_targets() -> Iterator[Target]:
    before, (frame, keyframes), after = _fed()[:4], _fed()[4], _fed()[5]

    def mapping(frame_message: Any, keyframes_message: Any) -> None:
        estimates = slam.keyframes_from_msg(keyframes_message)
        step(slam.tracked_frame_from_msg(frame_message), estimates)

    def unpacking(data: bytes) -> None:
        stamp_ns, records = unpack(data)
        assert 0 <= stamp_ns < LATEST_NS
        step(frame, KeyframeReader().changed(records))

    def step(tracked: TrackedFrame, estimates: tuple[Keyframe, ...]) -> None:
        stage = ObjectMapper({})
        for item in before:
            stage.step(*item)
        assert_sound((tracked.T_map_camera, tracked.covariance, tracked.intrinsics, estimates))
        assert_sound(stage.step(tracked, estimates))
        assert_sound(stage.object_map)
        stage.step(*after)
        stage.finalize()
        assert_sound(stage.object_map)

    sound = (
        slam.tracked_frame_to_msg(frame, "map", "camera"),
        slam.keyframes_to_msg(keyframes, frame.stamp_ns, "map"),
    )
    yield Target("neuse/frames", spoiled_messages(sound[0]), lambda message: mapping(message, sound[1]))
    yield Target("neuse/keyframes", spoiled_messages(sound[1]), lambda message: mapping(sound[0], message))
    packed = serialize_message(sound[1])
    yield Target("neuse/keyframes, bytes", spoiled_bytes(packed), unpacking)
    told = mapper.object_map_to_msg(toured_mapper().object_map, "map")
    yield Target("neuse/recalled_map", spoiled_messages(told), _recall)
    known = mapper.object_map_to_msg(samples.object_map(), "map")
    yield Target("neuse/map", spoiled_messages(known), lambda m: assert_sound(mapper.object_map_from_msg(m)))


def _recall(message: Any) -> None:
    """A map as slam_node remembers it, and as a mapper that has started anew takes it."""
    memory = MapMemory()
    memory.hear(message)
    memory.hear(mapper.object_map_to_msg(toured_mapper().object_map, "map"))
    stage = ObjectMapper({})
    for item in _fed()[:4]:
        stage.step(*item)
    stage.recall(mapper.object_map_from_msg(message))
    assert_sound(stage.object_map)
    for item in _fed()[4:]:
        stage.step(*item)
    stage.finalize()
    assert_sound(stage.object_map)


def _bag_targets() -> Iterator[Target]:
    header = encoder.header_to_msg(samples.STAMP_NS, "camera")
    color = bag_conversions.image_to_msg(np.zeros((6, 8, 3), np.uint8), "rgb8", header)
    yield Target("color/image", spoiled_messages(color), _read_color)
    for name, of_depth in (("/depth/image", True), ("/color/image", False)):
        packed = CompressedImage(header=header, format="32FC1; compressedDepth", data=_packed(of_depth))
        yield Target(f"compressed {name[1:]}", spoiled_messages(packed), partial(_unpack, name))
        spoiled = spoiled_bytes(bytes(packed.data)).map(partial(_repacked, packed))
        yield Target(f"compressed {name[1:]}, bytes", spoiled, partial(_unpack, name))
    truth = mapper.object_map_to_msg(samples.object_map(), "world")
    yield Target(
        "ground_truth/map",
        spoiled_messages(truth),
        lambda message: assert_sound(bag_conversions.true_objects_from_msg(message)),
    )
    for name, message in _serialized().items():
        data = serialize_message(message)
        kind = "/msg/".join((type(message).__module__.split(".")[0], type(message).__name__))

        def read(given: bytes, kind: str = kind) -> None:
            decoded = RawMessage("/topic", kind, 0, given).decode()
            assert deserialize_message(serialize_message(decoded), message_class(kind)) is not None

        yield Target(f"bytes of {name}", spoiled_bytes(data), read)


def _packed(of_depth: bool) -> bytes:
    pixels = np.arange(48, dtype=np.uint16).reshape(6, 8) * 100
    head = struct.pack("<iff", 0, 10.0, -5.0) if of_depth else b""
    return head + cv2.imencode(".png", pixels if of_depth else pixels.astype(np.uint8))[1].tobytes()


def _repacked(packed: CompressedImage, data: bytes) -> CompressedImage:
    return CompressedImage(header=packed.header, format=packed.format, data=data)


def _unpack(topic: str, message: CompressedImage) -> None:
    raw = RawMessage(topic, PACKED_TYPE, 0, serialize_message(message))
    image = unpacked(raw).decode()
    read = encoder_images.depth_from_msg if topic == "/depth/image" else bag_conversions.color_from_msg
    assert_sound(read(image))


def _serialized() -> dict[str, Any]:
    """Messages with nested arrays, texts and images."""
    return {
        "observations": encoder.observed_frame_to_msg(samples.observed_frame(), "camera"),
        "frames": slam.tracked_frame_to_msg(samples.tracked_frame(), "map", "camera"),
        "keyframes": slam.keyframes_to_msg(samples.keyframes(), samples.STAMP_NS, "map"),
    }


def _read_color(message: Any) -> None:
    pixels = bag_conversions.color_from_msg(message)
    assert pixels is None or pixels.shape == (message.height, message.width, 3)
