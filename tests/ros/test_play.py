"""The player as a process of its own, heard over DDS."""

import subprocess
import time
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pytest
from nav_msgs.msg import Odometry
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message
from rosgraph_msgs.msg import Clock
from std_msgs.msg import UInt32

from neuse_bags import topics
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.qos import LATCHED

pytestmark = pytest.mark.ros

PERIOD_NS, COUNT, FIRST_NS = 50_000_000, 20, 5_000_000_000
BEST_EFFORT = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
WAIT_S = 120.0


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of odometry, a latched number, and a topic recorded as best effort."""
    path = tmp_path_factory.mktemp("play") / "numbers.mcap"
    with BagWriter(path) as writer:
        topics.declare(writer, (topics.ODOMETRY, topics.TRUE_TRAVERSAL))
        writer.add_topic("/unsure", "std_msgs/msg/UInt32", [BEST_EFFORT])
        writer.write(topics.TRUE_TRAVERSAL.name, UInt32(data=7), FIRST_NS)
        for index in range(COUNT):
            stamp_ns = FIRST_NS + index * PERIOD_NS
            writer.write("/odom", odometry_to_msg(stamp_ns, np.eye(4), f"odom {index}"), stamp_ns)
            writer.write("/unsure", UInt32(data=index), stamp_ns)
    return path


@dataclass
class Heard:
    """What one playback gave; times of odometry are those of sending."""

    data: dict[str, list[bytes]] = field(default_factory=dict)
    odometry_s: list[float] = field(default_factory=list)
    clock_ns: list[int] = field(default_factory=list)
    offered: dict[str, QoSProfile] = field(default_factory=dict)
    output: str = ""
    code: int = -1


@pytest.fixture(scope="module")
def heard(bag_path: Path, node: Node, start_bags) -> Heard:
    """One playback at half the pace, with a clock."""
    found = Heard()
    _listen(node, found)
    arguments = ("--rate", "0.5", "--clock", "--wait-for", WAIT_S, "--wait-topics", "odom", "unsure")
    process = start_bags("play", bag_path, *map(str, arguments))
    _spin_until_ended(node, process, found)
    found.output = "".join(process.communicate(timeout=WAIT_S))
    found.code = process.returncode
    return found


def _listen(node: Node, found: Heard) -> None:
    def hear_odometry(data: bytes, info: dict[str, int]) -> None:
        found.data.setdefault("/odom", []).append(data)
        found.odometry_s.append(info["source_timestamp"] / 1e9)

    def hear_latched(data: bytes) -> None:
        found.data.setdefault(topics.TRUE_TRAVERSAL.name, []).append(data)

    node.create_subscription(Odometry, "/odom", hear_odometry, 100, raw=True)
    node.create_subscription(UInt32, topics.TRUE_TRAVERSAL.name, hear_latched, LATCHED, raw=True)
    node.create_subscription(UInt32, "/unsure", lambda _: None, BEST_EFFORT)
    node.create_subscription(
        Clock, "/clock", lambda m: found.clock_ns.append(m.clock.sec * 10**9 + m.clock.nanosec), BEST_EFFORT
    )


def _spin_until_ended(node: Node, process: subprocess.Popen, found: Heard) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while process.poll() is None:
        executor.spin_once(timeout_sec=0.05)
        for topic in ("/odom", "/unsure", topics.TRUE_TRAVERSAL.name):
            for info in node.get_publishers_info_by_topic(topic):
                found.offered[topic] = info.qos_profile
    end_s = time.monotonic() + 1.0  # all was acknowledged before the player ended
    while time.monotonic() < end_s:
        executor.spin_once(timeout_sec=0.01)
    executor.remove_node(node)


def test_every_message_arrives_byte_for_byte_in_order(heard: Heard, bag_path: Path) -> None:
    with BagReader(bag_path) as bag:
        recorded = {name: [m.data for m in bag.messages([name])] for name in heard.data}
    assert set(heard.data) == {"/odom", topics.TRUE_TRAVERSAL.name}
    assert heard.data == recorded


def test_recorded_quality_of_service_is_offered(heard: Heard) -> None:
    assert heard.offered["/unsure"].reliability == ReliabilityPolicy.BEST_EFFORT
    assert heard.offered["/odom"].reliability == ReliabilityPolicy.RELIABLE
    assert heard.offered[topics.TRUE_TRAVERSAL.name].durability == LATCHED.durability


def test_messages_do_not_come_before_they_are_due(heard: Heard) -> None:
    recorded_s = (COUNT - 1) * PERIOD_NS / 1e9
    # a busy machine may delay the first message
    assert heard.odometry_s[-1] - heard.odometry_s[0] > 0.6 * recorded_s / 0.5


def test_clock_runs_through_the_time_of_the_bag(heard: Heard) -> None:
    assert heard.clock_ns == sorted(heard.clock_ns)
    assert heard.clock_ns[-1] == FIRST_NS + (COUNT - 1) * PERIOD_NS
    assert len(heard.clock_ns) > COUNT


def test_player_ends_well_and_sums_up(heard: Heard) -> None:
    assert heard.code == 0
    assert f"played {2 * COUNT + 1} messages of 3 topics" in heard.output
    assert deserialize_message(heard.data["/odom"][3], Odometry).header.frame_id == "odom 3"


def test_player_says_when_it_cannot_keep_the_pace(tmp_path: Path, start_bags) -> None:
    unheard = replace(topics.ODOMETRY, name="/unheard/odom")  # who was killed lately may count elsewhere
    with BagWriter(tmp_path / "fast.mcap") as writer:
        topics.declare(writer, (unheard,))
        for index in range(50_000):  # in 50 µs: no machine is that fast
            writer.write(unheard.name, Odometry(), index)
    process = start_bags("play", tmp_path / "fast.mcap", "--wait-for", "0")
    output, complaint = process.communicate(timeout=WAIT_S)
    assert process.returncode == 0
    assert "cannot keep the pace" in output
    assert "nobody listens to /unheard/odom" in complaint


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        (["--rate", "0"], "--rate 0.0 must be at least"),
        (["--topics", "odom", "nothing"], "lacks /nothing"),
    ],
)
def test_bad_argument_is_told_in_one_line(
    bag_path: Path, start_bags, arguments: list[str], complaint: str
) -> None:
    process = start_bags("play", bag_path, *arguments)
    _, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    assert errors.startswith("neuse_bags play: ")
    assert complaint in errors
    assert len(errors.splitlines()) == 1


def test_truncated_bag_is_told_in_one_line(bag_path: Path, tmp_path: Path, start_bags) -> None:
    broken = tmp_path / "broken.mcap"
    broken.write_bytes(bag_path.read_bytes()[:-100])
    process = start_bags("play", broken)
    _, errors = process.communicate(timeout=WAIT_S)
    assert process.returncode == 2
    assert "truncated" in errors
    assert len(errors.splitlines()) == 1


def test_nothing_is_played_where_those_that_must_listen_do_not(bag_path: Path, start_bags) -> None:
    process = start_bags("play", bag_path, "--wait-for", "0.5", "--wait-topics", "nobody/at/all")
    output = "".join(process.communicate(timeout=WAIT_S))
    assert process.returncode == 2
    assert "nobody listens to /nobody/at/all, so nothing is played" in output
