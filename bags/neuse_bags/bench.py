"""How fast the whole graph is: three nodes as processes with their default parameters, fed over DDS.

Simulates a world whose frames show seven objects at most, five on average, plays it at a pace, and measures:
frames a second, frames lost, the time from a depth image to the edges of its frame, processor and memory of
each node. Writes DIR/graph.json; what each process says goes to DIR/logs/.
"""

import argparse
import json
import os
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy

from neuse.evaluation.timing import WARM_UP
from neuse.records import RgbdFrame
from neuse.simulation.worlds import PRESETS, make_world, simulate
from neuse_bags import topics
from neuse_bags.cli import check_at_least, command_parser, ros_node, run_command
from neuse_bags.conversions import odometry_to_msg
from neuse_bags.definitions import message_class
from neuse_bags.demo import NODES, START_S, awaited, running_graph
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagWriter
from neuse_bags.play import LEAST_RATE

SEED = 100
MOST_OBJECTS = 7  # of a frame: five on average
DROPPED = ("dropped_frame", "incomplete_frame")  # counters of the nodes
QUIET_S = 5.0  # a graph that says nothing for so long is done
WATCHED = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
TICKS_PER_S = os.sysconf("SC_CLK_TCK")

Figures = dict[str, Any]


def write_bag(path: Path, preset: str, frames: int) -> None:
    """The first frames of a world with the labels of a few objects each."""
    with BagWriter(path) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY))
        for simulated in islice(simulate(make_world(preset, SEED)), frames):
            write_frame(writer, with_few_objects(simulated.frame))
            odometry = simulated.odometry
            message = odometry_to_msg(odometry.stamp_ns, odometry.T_odom_camera, "odom")
            writer.write(topics.ODOMETRY.name, message, odometry.stamp_ns)


def with_few_objects(frame: RgbdFrame) -> RgbdFrame:
    """The frame with its first instances only."""
    kept = frame.instances[:MOST_OBJECTS]
    mask = np.where(np.isin(frame.mask, [instance.label for instance in kept]), frame.mask, 0)
    return replace(frame, mask=mask.astype(frame.mask.dtype), instances=kept)


class Watch:
    """When the messages of a graph come in, by their stamps, and what its nodes tell of themselves.

    Only the stamps of messages are read, so that watching takes little from the nodes.
    """

    def __init__(self, node: Node) -> None:
        self.arrived_s: dict[str, dict[int, float]] = {}
        self.diagnostics: dict[str, dict[str, str]] = {}
        for topic in (topics.DEPTH_INFO, topics.EDGES, topics.FRAMES):
            hear = self._hear(self.arrived_s.setdefault(topic.name, {}))
            message_type = message_class(topic.type_name)
            node.create_subscription(message_type, topic.name, hear, WATCHED, raw=True)
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 50)

    def latencies_ms(self, topic: str) -> list[float]:
        """From the camera's messages to those of a topic with their stamps; the first do not count."""
        sent_s = self.arrived_s[topics.DEPTH_INFO.name]
        both = [stamp_ns for stamp_ns in self.arrived_s[topic] if stamp_ns in sent_s][WARM_UP:]
        return [1e3 * (self.arrived_s[topic][stamp_ns] - sent_s[stamp_ns]) for stamp_ns in both]

    def _hear(self, arrived_s: dict[int, float]) -> Callable[[bytes], None]:
        def hear(data: bytes) -> None:
            sec, nanosec = struct.unpack_from("<iI", data, 4)  # after the encapsulation comes the header
            arrived_s[sec * 10**9 + nanosec] = time.monotonic()

        return hear

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self.diagnostics[status.name] = {item.key: item.value for item in status.values}


@dataclass(frozen=True)
class Usage:
    """What a process has used so far."""

    cpu_s: float
    peak_memory_mb: float

    @classmethod
    def of(cls, pid: int) -> "Usage":
        """Of a running process of this machine."""
        fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
        status = Path(f"/proc/{pid}/status").read_text()
        peak_kb = int(status.split("VmHWM:")[1].split()[0])
        return cls((int(fields[11]) + int(fields[12])) / TICKS_PER_S, peak_kb / 1024)


def measure(bag: Path, rate: float, logs: Path) -> Figures:
    """Play the bag to the nodes and watch them until they are done."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))
    with running_graph(logs) as graph, ros_node("bench") as node:
        watch, executor = Watch(node), SingleThreadedExecutor()
        executor.add_node(node)
        threading.Thread(target=executor.spin, daemon=True).start()
        pids = {name: graph.start(package, name).pid for name, package in NODES.items()}
        waiting = ["--wait-for", str(START_S), "--wait-topics", *awaited()]
        graph.start("neuse_bags", "play", bag, "--rate", rate, *waiting)
        before = _used_when(lambda: bool(watch.arrived_s[topics.FRAMES.name]), pids)
        graph.wait("play")
        after = _used_when(lambda: _is_quiet(watch), pids)
        time.sleep(1.5)  # the last diagnostics
        executor.shutdown()
    return figures_of(watch, before, after)


def _used_when(condition: Callable[[], bool], pids: dict[str, int]) -> dict[str, Usage]:
    end_s = time.monotonic() + START_S
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.02)
    return {name: Usage.of(pid) for name, pid in pids.items()}


def _is_quiet(watch: Watch) -> bool:
    return time.monotonic() - max(watch.arrived_s[topics.FRAMES.name].values(), default=0.0) > QUIET_S


def figures_of(watch: Watch, before: dict[str, Usage], after: dict[str, Usage]) -> Figures:
    """Of what was heard, and of what the nodes had used at the first frame and at the end."""
    sent, tracked = (watch.arrived_s[topic.name] for topic in (topics.DEPTH_INFO, topics.FRAMES))
    n, arrivals_s = len(tracked), list(tracked.values())
    encoded = int(watch.diagnostics["encoder_node"]["objects"])
    return {
        "frames_sent": len(sent),
        "frames_tracked": n,
        "frames_lost": len(sent) - n,
        "dropped": {
            name: sum(int(values.get(reason, 0)) for reason in DROPPED)
            for name, values in watch.diagnostics.items()
        },
        "objects_per_frame": encoded / max(n, 1),
        "fed_fps": _rate(list(sent.values())),
        "fps": _rate(arrivals_s),
        "latency_to_edge_ms": _summary(watch.latencies_ms(topics.EDGES.name)),
        "latency_to_pose_ms": _summary(watch.latencies_ms(topics.FRAMES.name)),
        "processes": {
            name: {
                "cpu_ms_per_frame": 1e3 * (after[name].cpu_s - before[name].cpu_s) / max(n, 1),
                "peak_memory_mb": after[name].peak_memory_mb,
            }
            for name in NODES
        },
    }


def _rate(arrivals_s: list[float]) -> float:
    """Frames a second from the first to the last."""
    return (len(arrivals_s) - 1) / max(arrivals_s[-1] - arrivals_s[0], 1e-9)


def _summary(values_ms: list[float]) -> dict[str, float]:
    return {
        "median_ms": float(np.median(values_ms)),
        "p95_ms": float(np.percentile(values_ms, 95)),
        "worst_ms": max(values_ms),
        "n": len(values_ms),
    }


def bench(args: argparse.Namespace) -> None:
    """The command."""
    check_at_least("--rate", args.rate, LEAST_RATE, "1 is ten frames a second")
    check_at_least("--frames", args.frames, 5 * WARM_UP, "the first do not count")
    args.out.mkdir(parents=True, exist_ok=True)
    bag = args.out / f"{args.preset}-{args.frames}.mcap"
    if not bag.exists():
        write_bag(bag, args.preset, args.frames)
    figures = {"world": args.preset, "load_1min": os.getloadavg()[0]} | measure(
        bag, args.rate, args.out / "logs"
    )
    (args.out / "graph.json").write_text(json.dumps(figures, indent=2) + "\n")
    print(json.dumps(figures, indent=2))


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("bench", __doc__)
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into")
    made.add_argument("--preset", default="tabletop", help=f"world to simulate, of {', '.join(PRESETS)}")
    made.add_argument("--frames", type=int, default=300, metavar="N", help="its first frames (300)")
    made.add_argument("--rate", type=float, default=2.6, metavar="R", help="tens of frames a second (2.6)")
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), bench, argv)
