"""encoder_node on real frames, if they are there, and on simulated ones with every fault of a real sensor."""

from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from peer import Peer
from rclpy.node import Node
from real_frames import REAL_FRAMES, needs_real_frames

import neuse
from neuse.evaluation.reconstructions import ReconstructedObject, reconstruct_frame
from neuse.records import ObservedFrame, RgbdFrame
from neuse_bags import convert, simulate
from neuse_bags.frames import JOINED, read_frames
from neuse_bags.mcap_file import BagReader
from neuse_encoder_node.conversions import observed_frame_from_msg
from neuse_encoder_node.node import INPUTS
from neuse_encoder_node.qos import reliable
from neuse_msgs.msg import ObjectObservationArray

pytestmark = [pytest.mark.ros, pytest.mark.slow]

ENCLOSED_SHARE = 0.85
N_SIMULATED = 2


@dataclass
class Seen:
    """A frame that was sent, and what the node made of it."""

    frame: RgbdFrame
    observed: ObservedFrame

    def objects(self) -> tuple[ReconstructedObject, ...]:
        categories = {instance.category for instance in self.frame.instances}
        decoders = {name: neuse.load_embedding(name).reconstruct for name in categories}
        return reconstruct_frame(self.frame, self.observed, decoders).objects


@pytest.fixture(scope="module")
def peer(node: Node, start_node) -> Peer:
    start_node("encoder_node", input_reliable=True, restart_s=0.1)
    peer = Peer(node, "encoder_node")
    peer.listen(ObjectObservationArray, "neuse/observations")
    for topic, message_type in INPUTS.items():
        peer.connect(message_type, topic, reliable(10))
    peer.meet()
    return peer


def observe(peer: Peer, path: Path) -> list[Seen]:
    """Send the frames of a bag, byte for byte, each as the one before is answered."""
    with BagReader(path) as bag:
        frames = {frame.stamp_ns: frame for frame in read_frames(bag, pytest.fail)}
        messages = defaultdict(list)
        for message in bag.messages(JOINED):
            messages[message.header_stamp_ns].append(message)
    peer.heard["neuse/observations"].clear()
    seen = []
    for stamp_ns, frame in frames.items():
        for message in messages[stamp_ns]:
            peer.send(message.topic.removeprefix("/"), message.data)
        answer = peer.wait_for_stamp("neuse/observations", stamp_ns)
        seen.append(Seen(frame, observed_frame_from_msg(answer)))
    return seen


def assert_finite(observed: ObservedFrame) -> None:
    for observation in observed.observations:
        code = observation.code
        assert all(np.isfinite(part).all() for part in (code.z, code.descriptor, code.sigmas))


@needs_real_frames
def test_every_instance_of_real_frames_has_a_code_whose_shape_encloses_what_was_seen(
    peer: Peer, tmp_path: Path
):
    bag = tmp_path / "real.mcap"
    assert convert.main([str(REAL_FRAMES), "--out", str(bag)]) == 0
    seen = observe(peer, bag)
    assert sum(len(one.frame.instances) for one in seen) == 6
    for one in seen:
        assert_finite(one.observed)
        labels = [instance.label for instance in one.frame.instances]
        assert [observation.label for observation in one.observed.observations] == labels
        assert one.observed.rejections == ()
        for item in one.objects():
            assert item.mesh.is_watertight
            assert item.enclosed_share >= ENCLOSED_SHARE


def test_instances_of_frames_with_every_fault_of_a_sensor_are_encoded_or_told(peer: Peer, tmp_path: Path):
    bag = tmp_path / "faults.mcap"
    arguments = ["four-round", "--seed", "7", "--frames", str(N_SIMULATED), "--out", str(bag)]
    assert simulate.main(arguments) == 0
    seen = observe(peer, bag)
    assert len(seen) == N_SIMULATED
    for one in seen:
        assert_finite(one.observed)
        used = len(one.observed.observations)
        assert used + len(one.observed.rejections) >= len(one.frame.instances)
    shares = [item.enclosed_share for one in seen for item in one.objects()]
    assert len(shares) >= 2 * N_SIMULATED
    assert np.median(shares) >= ENCLOSED_SHARE
