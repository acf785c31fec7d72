"""encoder_node: segmented depth images in, latent codes of their objects out."""

import sys
import time
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import torch
from sensor_msgs.msg import CameraInfo, Image

from neuse.embedding import devices
from neuse.embedding.embedding import load_embeddings
from neuse.embedding.observe import Observer, ObserverParams
from neuse.params import param
from neuse.records import ObservedFrame
from neuse_encoder_node.conversions import frame_from_msgs, observed_frame_to_msg, stamp_from_msg
from neuse_encoder_node.detections import Detection2DArray, category_names, instances_from_detections
from neuse_encoder_node.qos import reliable, sensor
from neuse_encoder_node.run import run
from neuse_encoder_node.stage_node import StageNode, StageParams
from neuse_encoder_node.stamps import StampJoin
from neuse_encoder_node.weights import MEANING, SHIPPED
from neuse_msgs.msg import InstanceArray, ObjectObservationArray

NAME = "encoder_node"
HURRY_FROM = 2  # frames that wait
INSTANCES = "segmentation/instances"
DETECTIONS = "segmentation/detections"
INPUTS = {
    "depth/image": Image,
    "segmentation/mask": Image,
    INSTANCES: InstanceArray,
    "depth/camera_info": CameraInfo,
}


@dataclass(frozen=True)
class EncoderNodeParams(StageParams):
    """Parameters of encoder_node."""

    input_depth: int = param(5, "depth of the input queues; raise it for bags at full rate", 1, 10000)
    input_reliable: bool = param(
        False, "true: nothing is lost on the way, but publishers that are best effort are not heard"
    )
    join_size: int = param(20, "stamps that may wait for the rest of their messages", 1, 10000)
    output_depth: int = param(50, "depth of the reliable output queue", 1, 10000)
    weights: tuple[str, ...] = param(SHIPPED, MEANING)
    device: str = param(devices.AUTO, devices.MEANING)
    detection_classes: tuple[str, ...] = param(
        ("cup=mug",), "name=category for classes of vision_msgs detections that are called otherwise here"
    )
    threads: int = param(
        1,
        "threads of the network; more are faster only where cores are free, else they wait for each other",
        1,
        64,
    )
    hurried_share: float = param(
        0.5,
        "share of the points that are looked at while frames wait: half take half the time, and poses err by "
        "a tenth more; 1: never hurry, drop frames",
        0.05,
        1.0,
    )
    encoder: ObserverParams = field(default_factory=ObserverParams)

    def __post_init__(self) -> None:
        super().__post_init__()
        category_names(self.detection_classes)


class EncoderNode(StageNode):
    """Joins depth, mask, instances and camera info of equal stamps, and publishes the objects' codes.

    Where vision_msgs is installed, detections of that package are taken as instances.
    """

    def __init__(self) -> None:
        super().__init__(NAME, EncoderNodeParams())

    def build(self, params: EncoderNodeParams) -> None:
        torch.set_num_threads(params.threads)
        embeddings = load_embeddings(params.weights, params.device)
        for embedding in embeddings.values():
            embedding.prepare()
        self._observer = Observer(params.encoder, embeddings)
        self._hurried_share = params.hurried_share
        self._join = StampJoin(list(INPUTS), params.join_size)
        self._observations = self.offer(
            ObjectObservationArray, "neuse/observations", reliable(params.output_depth)
        )
        quality = reliable if params.input_reliable else sensor
        for topic, message_type in INPUTS.items():
            self.listen(message_type, topic, partial(self._receive, topic), quality(params.input_depth))
        self._categories = category_names(params.detection_classes)
        if Detection2DArray is not None:
            self.listen(Detection2DArray, DETECTIONS, self._receive_detections, quality(params.input_depth))

    def forget(self) -> None:
        """Frames are encoded one by one: there is nothing to forget."""

    def process(self, stamp_ns: int, messages: tuple[Any, ...]) -> None:
        frame = frame_from_msgs(*messages)
        started_s = time.perf_counter()
        observed = self._observer.observe(frame, self._share())
        self._count(stamp_ns, observed, time.perf_counter() - started_s)
        self._observations.publish(observed_frame_to_msg(observed, messages[0].header.frame_id))

    def _share(self) -> float:
        """How much of each object is looked at."""
        if self.backlog < HURRY_FROM or self._hurried_share == 1.0:
            return 1.0
        self.health.tally("hurried_frames")
        return self._hurried_share

    def _count(self, stamp_ns: int, observed: ObservedFrame, seconds: float) -> None:
        self.health.add_time("encode", seconds)
        self.health.add_time("encode_per_object", seconds, max(len(observed.observations), 1))
        self.health.tally("objects", len(observed.observations))
        for rejection in observed.rejections:
            self.refuse(rejection.reason, f"{rejection.detail} (stamp {stamp_ns} ns)")

    def _receive_detections(self, message: Any) -> None:
        self._receive(INSTANCES, instances_from_detections(message, self._categories))

    def _receive(self, topic: str, message: Any) -> None:
        stamp_ns = stamp_from_msg(message.header.stamp)
        joined = self._join.add(topic, stamp_ns, message)
        for lost_ns, missing in self._join.take_lost():
            self.refuse(
                "incomplete_frame",
                f"no {' nor '.join(missing)} with stamp {lost_ns} ns; the frame is dropped",
            )
        if joined is not None:
            self.enqueue(stamp_ns, joined)


def main() -> None:
    """Entry point of `ros2 run neuse_encoder_node encoder_node`."""
    sys.exit(run(EncoderNode))
