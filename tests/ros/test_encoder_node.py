"""encoder_node as a process of its own: good frames, and every bad one between good ones."""

import itertools
import re
from collections.abc import Callable

import numpy as np
import pytest
from hand_made import HEIGHT, INSTANCES, WIDTH, FrameMessages, frame_messages, image
from peer import Peer
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from neuse.records import Instance
from neuse_encoder_node.conversions import instances_to_msg, observed_frame_from_msg
from neuse_encoder_node.node import DETECTIONS, INPUTS
from neuse_msgs.msg import ObjectObservationArray

pytestmark = pytest.mark.ros

MS = 10**6
SENSOR = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)


class Camera:
    """Sends frames, 100 ms apart, and waits for what becomes of them."""

    def __init__(self, peer: Peer) -> None:
        self.peer = peer
        self._stamps_ns = itertools.count(10**12, 100 * MS)

    def next_stamp_ns(self) -> int:
        return next(self._stamps_ns)

    def send(self, frame: FrameMessages, leave_out: str = "") -> None:
        for topic, message in frame.by_topic().items():
            if topic != leave_out:
                self.peer.send(topic, message)

    def observe(self, frame: FrameMessages, stamp_ns: int) -> ObjectObservationArray:
        self.send(frame)
        return self.peer.wait_for_stamp("neuse/observations", stamp_ns)

    def observe_good(self) -> ObjectObservationArray:
        stamp_ns = self.next_stamp_ns()
        return self.observe(frame_messages(stamp_ns), stamp_ns)


@pytest.fixture(scope="module")
def encoder(start_node):
    return start_node("encoder_node", join_size=5)


@pytest.fixture(scope="module")
def camera(node: Node, encoder) -> Camera:
    peer = Peer(node, "encoder_node")
    peer.listen(ObjectObservationArray, "neuse/observations")
    for topic, message_type in INPUTS.items():
        peer.connect(message_type, topic, SENSOR)
    peer.meet()
    return Camera(peer)


def assert_good(message: ObjectObservationArray) -> None:
    """Both bumps are observed, each at its place."""
    observed = observed_frame_from_msg(message)
    assert [o.label for o in observed.observations] == [i.label for i in INSTANCES]
    for observation, x in zip(observed.observations, (-0.23, 0.23), strict=True):
        np.testing.assert_allclose(observation.partial_center, [x, 0.0, 0.97], atol=0.03)
        assert np.isfinite(observation.code.z).all()
        assert np.linalg.norm(observation.code.descriptor) == pytest.approx(1.0)
    assert observed.rejections == ()


def test_objects_of_a_good_frame_are_observed_at_their_places(camera: Camera):
    message = camera.observe_good()
    assert_good(message)
    assert message.header.frame_id == "camera_optical_frame"
    observed = observed_frame_from_msg(message)
    assert (observed.intrinsics.width, observed.intrinsics.fx) == (WIDTH, 500.0)
    assert observed.coarse_depth_m.max() == np.float32(2.0)


def test_same_frame_gives_the_same_codes(camera: Camera):
    first, second = (observed_frame_from_msg(camera.observe_good()) for _ in range(2))
    for one, other in zip(first.observations, second.observations, strict=True):
        assert np.array_equal(one.code.z, other.code.z)


def depth_in_metres(frame: FrameMessages) -> None:
    depth_mm = np.frombuffer(frame.depth.data, np.uint16).reshape(HEIGHT, WIDTH)
    frame.depth = image((depth_mm / 1e3).astype(np.float32), "32FC1", frame.depth.header)


def big_endian_depth(frame: FrameMessages) -> None:
    depth_mm = np.frombuffer(frame.depth.data, np.uint16).reshape(HEIGHT, WIDTH)
    frame.depth = image(depth_mm.astype(">u2"), "mono16", frame.depth.header)
    frame.depth.is_bigendian = 1


def wide_mask(frame: FrameMessages) -> None:
    labels = np.frombuffer(frame.mask.data, np.uint8).reshape(HEIGHT, WIDTH)
    frame.mask = image(labels.astype(np.int32), "32SC1", frame.mask.header)


def padded_rows(frame: FrameMessages) -> None:
    labels = np.frombuffer(frame.mask.data, np.uint8).reshape(HEIGHT, WIDTH)
    frame.mask = image(np.pad(labels, [(0, 0), (0, 24)]), "mono8", frame.mask.header)
    frame.mask.width = WIDTH


@pytest.mark.parametrize("rewrite", [depth_in_metres, big_endian_depth, wide_mask, padded_rows])
def test_same_frame_in_another_encoding_is_observed_alike(
    camera: Camera, rewrite: Callable[[FrameMessages], None]
):
    stamp_ns = camera.next_stamp_ns()
    frame = frame_messages(stamp_ns)
    rewrite(frame)
    assert_good(camera.observe(frame, stamp_ns))


def half_mask(frame: FrameMessages) -> None:
    frame.mask = image(np.zeros((HEIGHT // 2, WIDTH // 2), np.uint8), "mono8", frame.mask.header)


def unknown_depth_encoding(frame: FrameMessages) -> None:
    frame.depth.encoding = "bgr8"


def unknown_mask_encoding(frame: FrameMessages) -> None:
    frame.mask.encoding = "32FC1"


def colored_mask(frame: FrameMessages) -> None:
    labels = np.frombuffer(frame.mask.data, np.uint8).reshape(HEIGHT, WIDTH)
    frame.mask = image(np.repeat(labels, 3, axis=1), "rgb8", frame.mask.header)
    frame.mask.width = WIDTH


def camera_matrix_of_nan(frame: FrameMessages) -> None:
    frame.info.k = np.full(9, np.nan)


def image_without_pixels(frame: FrameMessages) -> None:
    frame.depth.width = frame.depth.height = 0


def short_depth(frame: FrameMessages) -> None:
    frame.depth.data = frame.depth.data[:-1000]


def zero_camera_matrix(frame: FrameMessages) -> None:
    frame.info.k = np.zeros(9)


def camera_of_another_size(frame: FrameMessages) -> None:
    frame.info.width = WIDTH // 2


def twice_the_same_label(frame: FrameMessages) -> None:
    frame.instances = instances_to_msg((*INSTANCES, Instance(3, "mug", 0.1)), frame.instances.header)


REFUSED_FRAMES = {
    half_mask: "size_mismatch",
    unknown_depth_encoding: "encoding",
    unknown_mask_encoding: "encoding",
    colored_mask: "encoding",
    camera_matrix_of_nan: "intrinsics",
    image_without_pixels: "array_length",
    short_depth: "array_length",
    zero_camera_matrix: "intrinsics",
    camera_of_another_size: "intrinsics_size",
    twice_the_same_label: "duplicate_label",
}


@pytest.mark.parametrize(("spoil", "reason"), REFUSED_FRAMES.items())
def test_bad_frame_is_counted_and_the_next_is_right(
    camera: Camera, encoder, spoil: Callable[[FrameMessages], None], reason: str
):
    before = camera.peer.count(reason)
    bad = frame_messages(camera.next_stamp_ns())
    spoil(bad)
    camera.send(bad)
    assert_good(camera.observe_good())
    camera.peer.wait_for_count(reason, before + 1)
    assert f"{reason}: " in encoder.output


def depth_of(value: float) -> Callable[[FrameMessages], None]:
    def spoil(frame: FrameMessages) -> None:
        pixels = np.full((HEIGHT, WIDTH), value, np.float32)
        frame.depth = image(pixels, "32FC1", frame.depth.header)

    return spoil


def unknown_category(frame: FrameMessages) -> None:
    frame.instances.instances[0].category = "unicorn"


def label_without_instance(frame: FrameMessages) -> None:
    del frame.instances.instances[0]


def relabel(frame: FrameMessages, where: np.ndarray | slice, label: int) -> None:
    labels = np.frombuffer(frame.mask.data, np.uint8).reshape(HEIGHT, WIDTH).copy()
    labels[where] = label
    frame.mask = image(labels, "mono8", frame.mask.header)


def empty_mask(frame: FrameMessages) -> None:
    relabel(frame, slice(None), 0)


def one_pixel_mask(frame: FrameMessages) -> None:
    relabel(frame, slice(None), 0)
    relabel(frame, (slice(240, 241), slice(200, 201)), 3)


def mask_over_everything(frame: FrameMessages) -> None:
    relabel(frame, slice(None), 3)


REFUSED_INSTANCES = {
    depth_of(np.nan): ("too_few_points", 0),
    depth_of(np.inf): ("too_few_points", 0),
    unknown_category: ("unknown_category", 1),
    label_without_instance: ("label_without_instance", 1),
    empty_mask: ("empty_mask", 0),
    one_pixel_mask: ("too_few_points", 0),
    mask_over_everything: ("mask_too_large", 0),
}


@pytest.mark.parametrize(("spoil", "outcome"), REFUSED_INSTANCES.items())
def test_bad_instance_is_told_and_the_others_are_used(
    camera: Camera, encoder, spoil: Callable[[FrameMessages], None], outcome: tuple[str, int]
):
    reason, n_usable = outcome
    before, stamp_ns = camera.peer.count(reason), camera.next_stamp_ns()
    bad = frame_messages(stamp_ns)
    spoil(bad)
    message = camera.observe(bad, stamp_ns)
    assert len(message.observations) == n_usable
    assert reason in {rejection.reason for rejection in message.rejections}
    assert_good(camera.observe_good())
    camera.peer.wait_for_count(reason, before + 1)
    assert f"{reason}: " in encoder.output


@pytest.mark.parametrize("topic", INPUTS)
def test_frame_without_one_of_its_messages_is_given_up(camera: Camera, topic: str):
    before = camera.peer.count("incomplete_frame")
    camera.send(frame_messages(camera.next_stamp_ns()), leave_out=topic)
    assert_good(camera.observe_good())
    camera.peer.wait_for_count("incomplete_frame", before + 1)


def test_late_frame_is_dropped(camera: Camera):
    late_ns = camera.next_stamp_ns()
    assert_good(camera.observe_good())
    camera.send(frame_messages(late_ns))
    camera.peer.wait_for_count("stale_stamp")
    assert_good(camera.observe_good())


def test_stamps_that_go_back_start_a_new_run(camera: Camera, encoder):
    stamp_ns = 10**9
    assert_good(camera.observe(frame_messages(stamp_ns), stamp_ns))
    camera.peer.wait_for_count("time_jump")
    assert "time_jump: stamps went back" in encoder.output
    later_ns = stamp_ns + 100 * MS
    assert_good(camera.observe(frame_messages(later_ns), later_ns))


def test_frames_that_wait_are_looked_at_less_closely_and_that_is_told(camera: Camera):
    for frame in [frame_messages(camera.next_stamp_ns()) for _ in range(40)]:
        camera.send(frame)
    camera.peer.wait_for_count("hurried_frames")
    assert_good(camera.observe_good())


def test_diagnostics_give_rate_and_times(camera: Camera):
    camera.peer.wait_for_count("frames")
    assert float(camera.peer.diagnostics["stage_ms/encode"]) > 0
    assert float(camera.peer.diagnostics["stage_ms/encode_per_object"]) > 0
    assert "fps" in camera.peer.diagnostics


def test_detections_of_vision_msgs_are_taken_as_instances(camera: Camera):
    vision = pytest.importorskip("vision_msgs.msg", reason="vision_msgs is not installed")
    camera.peer.connect(vision.Detection2DArray, DETECTIONS, SENSOR)
    camera.peer.meet()
    stamp_ns = camera.next_stamp_ns()
    frame = frame_messages(stamp_ns)
    detections = vision.Detection2DArray(header=frame.depth.header)
    for instance, name in zip(INSTANCES, ("cup", "bottle"), strict=True):
        result = vision.ObjectHypothesisWithPose()
        result.hypothesis = vision.ObjectHypothesis(class_id=name, score=instance.score)
        detections.detections.append(vision.Detection2D(id=str(instance.label), results=[result]))
    camera.send(frame, leave_out="segmentation/instances")
    camera.peer.send(DETECTIONS, detections)
    message = camera.peer.wait_for_stamp("neuse/observations", stamp_ns)
    assert_good(message)
    assert [o.code.category for o in message.observations] == ["mug", "bottle"]


def test_it_says_every_ten_seconds_how_it_goes(camera: Camera, encoder):
    said = r"\d+ frames, \d+ objects, 0 edges, \d+ dropped, \d+ refused"
    camera.peer.wait_for(lambda: re.search(said, encoder.output), "summary in the log")


def test_ctrl_c_ends_it_well(camera: Camera, encoder):
    assert encoder.process.poll() is None
    assert encoder.end() == 0
    assert "Traceback" not in encoder.output
