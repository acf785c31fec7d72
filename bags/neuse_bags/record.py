"""Record topics to a bag until Ctrl-C or SIGTERM.

Topics may appear at any time and have any type whose package is installed; each is subscribed to with what
its publishers offer, and stored byte for byte. Without TOPIC: everything under neuse/, /diagnostics and /tf.
"""

import argparse
import sys
import time
from functools import partial
from pathlib import Path

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from neuse.errors import BagError
from neuse_bags.cli import command_parser, ros_node, run_command, stop_on_signal
from neuse_bags.definitions import message_class
from neuse_bags.mcap_file import BagWriter

DISCOVERY_PERIOD_S = 0.1
QUEUE_DEPTH = 1000
FINISH_S, QUIET_S = 5.0, 0.3
DEFAULT_TOPICS = ("/diagnostics", "/tf")
DEFAULT_PART = "/neuse/"


class Recorder:
    """Subscribes to wanted topics as they appear, and writes what arrives.

    wanted: full topic names; empty for the default choice.
    """

    def __init__(self, node: Node, writer: BagWriter, wanted: list[str]) -> None:
        self._node, self._writer = node, writer
        self._wanted = {node.resolve_topic_name(name) for name in wanted}
        self._known: set[str] = set()
        node.create_timer(DISCOVERY_PERIOD_S, self.discover)

    def missing(self) -> set[str]:
        """Topics that were asked for and never appeared."""
        return self._wanted - self._known

    def discover(self) -> None:
        """Subscribe to wanted topics that somebody publishes since the last look."""
        for name, types in self._node.get_topic_names_and_types():
            if name not in self._known and self._wants(name) and self._node.count_publishers(name):
                self._known.add(name)
                self._subscribe(name, types[0])

    def _wants(self, name: str) -> bool:
        return name in self._wanted if self._wanted else DEFAULT_PART in name or name in DEFAULT_TOPICS

    def _subscribe(self, name: str, type_name: str) -> None:
        offered = [info.qos_profile for info in self._node.get_publishers_info_by_topic(name)]
        try:
            kind = message_class(type_name)
            self._writer.add_topic(name, type_name, offered)
        except BagError as error:
            print(f"record: {name} is left out: {error}", file=sys.stderr)
            return
        self._node.create_subscription(kind, name, partial(self._write, name), _requested(offered), raw=True)

    def _write(self, name: str, data: bytes) -> None:
        self._writer.write_raw(name, data, self._node.get_clock().now().nanoseconds)


def _requested(offered: list[QoSProfile]) -> QoSProfile:
    """The most that all publishers of a topic offer, so that none of them is refused."""
    reliable = all(profile.reliability == ReliabilityPolicy.RELIABLE for profile in offered)
    latched = all(profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for profile in offered)
    return QoSProfile(
        depth=QUEUE_DEPTH,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


def record(args: argparse.Namespace) -> None:
    """The command."""
    if args.out.exists() and not args.overwrite:
        raise BagError(f"{args.out} exists; choose another name or say --overwrite")
    with stop_on_signal() as stop, BagWriter(args.out) as writer, ros_node("bag_recorder") as node:
        recorder = Recorder(node, writer, args.topics)
        executor = SingleThreadedExecutor()
        executor.add_node(node)
        print(f"recording to {args.out}; Ctrl-C ends it", flush=True)
        while not stop.is_set():
            executor.spin_once(timeout_sec=0.1)
        _take_what_has_arrived(executor, writer)
    _report(writer, recorder.missing())


def _take_what_has_arrived(executor: SingleThreadedExecutor, writer: BagWriter) -> None:
    """Spin on while messages come out of the queues, for a little while."""
    end_s, quiet_s = time.monotonic() + FINISH_S, time.monotonic() + QUIET_S
    while time.monotonic() < min(end_s, quiet_s):
        before = writer.counts.total()
        executor.spin_once(timeout_sec=0.05)
        if writer.counts.total() > before:
            quiet_s = time.monotonic() + QUIET_S


def _report(writer: BagWriter, missing: set[str]) -> None:
    for name, count in sorted(writer.counts.items()):
        print(f"{count:8d}  {name}")
    print(f"{writer.counts.total():8d}  messages in {writer.path}")
    if missing:
        print(f"record: never published: {', '.join(sorted(missing))}", file=sys.stderr)


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("record", __doc__)
    made.add_argument(
        "topics", nargs="*", metavar="TOPIC", help="topics to record (all outputs of the nodes)"
    )
    made.add_argument("--out", type=Path, required=True, metavar="BAG", help=".mcap file to write")
    made.add_argument("--overwrite", action="store_true", help="replace the file if it exists")
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), record, argv)
