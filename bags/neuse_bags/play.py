"""Publish a bag over DDS at its recorded pace.

Every topic is sent as the bag has it, byte for byte, with the quality of service it was recorded with. The
player first waits until the nodes' inputs have subscribers, so that no first frame is lost.
"""

import argparse
import sys
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from threading import Event

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from neuse.errors import BagError
from neuse_bags.cli import check_at_least, command_parser, ros_node, run_command, stop_on_signal
from neuse_bags.definitions import message_class
from neuse_bags.mcap_file import BagReader, BagTopic
from neuse_bags.qos import RELIABLE, SENSOR
from neuse_bags.topics import FRAME_TOPICS, ODOMETRY
from neuse_encoder_node.conversions import stamp_to_msg

LEAST_RATE = 1e-3
LATE_S = 0.05
SETTLE_S = 2.0
CLOCK_PERIOD_S = 0.01
CLOCK_QOS = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
SENSOR_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CameraInfo", "sensor_msgs/msg/PointCloud2")
NODE_INPUTS = tuple(topic.name for topic in (*FRAME_TOPICS, ODOMETRY))


class Player:
    """Publishes the messages of a bag when they are due."""

    def __init__(
        self, node: Node, bag: BagReader, topics: Iterable[BagTopic], rate: float, clock: bool
    ) -> None:
        self._bag, self._rate = bag, rate
        self._publishers = _publishers(node, topics)
        self._clock = node.create_publisher(Clock, "/clock", CLOCK_QOS) if clock else None
        self.sent: Counter[str] = Counter()
        self.late = 0
        self.worst_late_s = 0.0

    def play(self, stop: Event) -> None:
        """Send everything, or until stopped; returns when reliable subscribers have it."""
        start_s = time.monotonic()
        for message in self._bag.messages(self._publishers):
            due_s = start_s + (message.stamp_ns - self._bag.start_ns) / 1e9 / self._rate
            self._wait_until(due_s, message.stamp_ns, stop)
            if stop.is_set():
                return
            self._publishers[message.topic].publish(message.data)
            self._count(message.topic, time.monotonic() - due_s)
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=2))

    def _wait_until(self, due_s: float, stamp_ns: int, stop: Event) -> None:
        """Sleep, and tell the time meanwhile if there is a clock."""
        while (remaining_s := due_s - time.monotonic()) > 0 and not stop.is_set():
            self._publish_clock(stamp_ns - round(remaining_s * self._rate * 1e9))
            stop.wait(min(remaining_s, CLOCK_PERIOD_S) if self._clock else remaining_s)
        self._publish_clock(stamp_ns)

    def _publish_clock(self, stamp_ns: int) -> None:
        if self._clock:
            self._clock.publish(Clock(clock=stamp_to_msg(max(stamp_ns, 0))))

    def _count(self, topic: str, late_s: float) -> None:
        self.sent[topic] += 1
        self.late += late_s > LATE_S
        self.worst_late_s = max(self.worst_late_s, late_s)

    def summary(self) -> str:
        """One line: what was sent, and whether the pace was kept."""
        line = f"played {self.sent.total()} messages of {len(self.sent)} topics"
        if not self.late:
            return f"{line} at the recorded pace"
        behind = (
            f"{self.late} of them over {LATE_S * 1e3:.0f} ms late, worst {self.worst_late_s * 1e3:.0f} ms"
        )
        return f"{line}; {behind}: this machine cannot keep the pace, try a lower --rate"


def wait_for_subscribers(node: Node, topics: Iterable[str], timeout_s: float, stop: Event) -> list[str]:
    """Wait until every topic has a subscriber; returns those that have none after the timeout."""
    deadline_s = time.monotonic() + timeout_s
    names = [node.resolve_topic_name(topic) for topic in topics]
    while missing := [name for name in names if node.count_subscribers(name) == 0]:
        if time.monotonic() > deadline_s or stop.wait(0.05):
            return missing
    stop.wait(SETTLE_S)  # each pair of processes discovers itself: others may know each other a little later
    return []


def _publishers(node: Node, topics: Iterable[BagTopic]) -> dict[str, Publisher]:
    """A publisher for every topic whose type is installed; the others are named once and left out."""
    publishers = {}
    for topic in topics:
        try:
            kind = message_class(topic.type_name)
        except BagError as error:
            print(f"play: {topic.name} is left out: {error}", file=sys.stderr)
            continue
        publishers[topic.name] = node.create_publisher(kind, topic.name, _offered(topic))
    return publishers


def _offered(topic: BagTopic) -> QoSProfile:
    """The first recorded profile; without any, best effort for sensor data, reliable for the rest."""
    default = SENSOR if topic.type_name in SENSOR_TYPES else RELIABLE
    return topic.qos[0] if topic.qos else default


def _selected(bag: BagReader, names: list[str]) -> list[BagTopic]:
    wanted = [name if name.startswith("/") else f"/{name}" for name in names]
    bag.require(wanted)
    selected = [topic for name, topic in bag.topics.items() if not wanted or name in wanted]
    if not any(topic.n_messages for topic in selected):
        raise BagError(f"{bag.path} has no messages to play; was its recording ended too soon?")
    return selected


def play(args: argparse.Namespace) -> None:
    """The command."""
    check_at_least("--rate", args.rate, LEAST_RATE, "1 is the recorded pace")
    check_at_least("--wait-for", args.wait_for, 0.0, "0 does not wait")
    with stop_on_signal() as stop, BagReader(args.bag) as bag, ros_node("bag_player") as node:
        player = Player(node, bag, _selected(bag, args.topics), args.rate, args.clock)
        awaited = args.wait_topics or [name for name in bag.topics if name.endswith(NODE_INPUTS)]
        missing = wait_for_subscribers(node, awaited, args.wait_for, stop)
        if missing and not stop.is_set():
            _tell_missing(missing, needed=bool(args.wait_topics))
        player.play(stop)
        print(player.summary())


def _tell_missing(topics: Iterable[str], needed: bool) -> None:
    """Raises BagError where somebody must listen."""
    told = f"nobody listens to {', '.join(topics)}"
    if needed:
        raise BagError(f"{told}, so nothing is played; what do the logs of the nodes say?")
    print(f"play: {told}; playing all the same", file=sys.stderr)


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("play", __doc__)
    made.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    made.add_argument("--rate", type=float, default=1.0, metavar="R", help="times the recorded pace (1)")
    made.add_argument("--clock", action="store_true", help="publish /clock, for nodes with use_sim_time")
    made.add_argument("--topics", nargs="+", default=[], metavar="TOPIC", help="only these (all)")
    made.add_argument(
        "--wait-for", type=float, default=5.0, metavar="S", help="at most so many seconds for subscribers (5)"
    )
    made.add_argument(
        "--wait-topics",
        nargs="+",
        metavar="TOPIC",
        help="play only if these have subscribers (wait for the nodes' inputs, play in any case)",
    )
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), play, argv)
