"""What the bench of the graph makes of what it has heard; the graph itself is tested with real processes."""

from types import SimpleNamespace

import numpy as np
import pytest

from neuse.records import Instance, Intrinsics, RgbdFrame
from neuse_bags import topics
from neuse_bags.bench import MOST_OBJECTS, Usage, Watch, figures_of, main, with_few_objects


class Listener:
    """A node whose topics the test feeds."""

    def __init__(self) -> None:
        self.hear = {}

    def create_subscription(self, message_type, topic, callback, qos, raw=False) -> None:
        self.hear[topic] = callback


def serialized(stamp_ns: int) -> bytes:
    """The beginning of a message with a header, as it comes over DDS."""
    stamp = (stamp_ns // 10**9).to_bytes(4, "little") + (stamp_ns % 10**9).to_bytes(4, "little")
    return b"\x00\x01\x00\x00" + stamp + bytes(20)


def test_only_the_first_objects_stay_in_a_frame() -> None:
    mask = np.arange(10, dtype=np.int32).reshape(2, 5)
    instances = tuple(Instance(label, "mug", 1.0) for label in range(1, 10))
    camera = Intrinsics(5, 2, 1.0, 1.0, 0.0, 0.0)
    few = with_few_objects(RgbdFrame(0, np.ones((2, 5), np.float32), mask, instances, camera))
    assert len(few.instances) == MOST_OBJECTS
    assert np.unique(few.mask).tolist() == list(range(MOST_OBJECTS + 1))


def test_frames_that_do_not_come_back_count_as_lost() -> None:
    node = Listener()
    watch = Watch(node)
    for stamp_ns in range(1_000_000_000, 1_000_000_020):
        node.hear[topics.DEPTH_INFO.name](serialized(stamp_ns))
        if stamp_ns % 10:
            node.hear[topics.FRAMES.name](serialized(stamp_ns))
            node.hear[topics.EDGES.name](serialized(stamp_ns))
    values = [SimpleNamespace(key="objects", value="90"), SimpleNamespace(key="dropped_frame", value="2")]
    status = SimpleNamespace(name="encoder_node", values=values)
    node.hear["/diagnostics"](SimpleNamespace(status=[status]))
    names = ("encoder_node", "slam_node", "mapper_node")
    figures = figures_of(
        watch, dict.fromkeys(names, Usage(1.0, 1.0)), dict.fromkeys(names, Usage(2.8, 300.0))
    )
    assert (figures["frames_sent"], figures["frames_tracked"], figures["frames_lost"]) == (20, 18, 2)
    assert figures["dropped"] == {"encoder_node": 2}
    assert figures["objects_per_frame"] == 5.0
    assert figures["latency_to_edge_ms"]["n"] == 13
    assert 0 <= figures["latency_to_edge_ms"]["median_ms"] < 1000
    assert figures["processes"]["slam_node"] == {
        "cpu_ms_per_frame": pytest.approx(100.0),
        "peak_memory_mb": 300.0,
    }


@pytest.mark.parametrize("arguments", [["--rate", "0"], ["--frames", "3"]])
def test_bad_argument_is_told_before_anything_starts(tmp_path, capsys, arguments) -> None:
    assert main(["--out", str(tmp_path / "bench"), *arguments]) == 2
    assert "must be at least" in capsys.readouterr().err
    assert not (tmp_path / "bench").exists()
