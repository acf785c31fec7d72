"""The whole graph on a simulated bag: three nodes, a recorder and a player as processes of their own.

Simulates the world unless DIR/<preset>.mcap is there, plays it to the nodes, records what they publish into
DIR/recording.mcap, and writes all that evaluate writes. What each process says goes to DIR/logs/.
"""

import argparse
import os
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from neuse.errors import NeuseError
from neuse_bags import simulate, topics
from neuse_bags.cli import check_at_least, command_parser, run_command
from neuse_bags.evaluate import RECORDING, evaluate_recording, refuse_overwriting
from neuse_bags.mcap_file import BagReader
from neuse_bags.play import LEAST_RATE

NODES = {
    "encoder_node": "neuse_encoder_node",
    "slam_node": "neuse_slam_node",
    "mapper_node": "neuse_mapper_node",
}
PATIENCE = {"queue_size": 1000, "finish_s": 600.0}  # a bag's frames shall all be used
ENCODER_PATIENCE = PATIENCE | {"input_depth": 100, "input_reliable": True}
BETWEEN_NODES = (topics.OBSERVATIONS, topics.FRAMES, topics.EDGES, topics.MAP)
AWAITED = [t.name for t in (*topics.FRAME_TOPICS, topics.ODOMETRY, *BETWEEN_NODES)]
START_S, END_S = 180.0, 660.0


class Graph:
    """The running processes, in the order in which data flows, so that each can finish what it was sent."""

    def __init__(self, logs: Path) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._logs = logs
        self._processes: dict[str, subprocess.Popen] = {}
        self._environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))

    def start(self, package: str, executable: str, *arguments: str | Path | float) -> subprocess.Popen:
        """Start an executable of a package, as `ros2 run` does."""
        with (self._logs / f"{executable}.log").open("w") as log:
            self._processes[executable] = subprocess.Popen(
                [_executable(package, executable), *map(str, arguments)],
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
            )
        return self._processes[executable]

    def wait(self, executable: str) -> None:
        """Wait for one process to end; all others must outlive it.

        Raises:
            NeuseError: it failed, or another one ended before.
        """
        process = self._processes[executable]
        while process.poll() is None:
            self._check_alive()
            time.sleep(0.2)
        if process.returncode:
            raise self._failed(executable)

    def kill(self) -> None:
        """Stop all processes, finished or not."""
        for process in self._processes.values():
            process.kill()
            process.wait()

    def end(self) -> None:
        """Interrupt the processes one after the other, upstream first."""
        for name, process in self._processes.items():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=END_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
                raise self._failed(name) from None

    def _check_alive(self) -> None:
        for name, process in self._processes.items():
            if process.poll():
                raise self._failed(name)

    def _failed(self, name: str) -> NeuseError:
        code = self._processes[name].returncode
        return NeuseError(f"{name} ended with code {code}; its last words are in {self._logs / name}.log")


@contextmanager
def running_graph(logs: Path) -> Iterator[Graph]:
    """A graph that leaves no process behind, and is stopped at once where anything goes wrong."""
    graph = Graph(logs)
    try:
        yield graph
    except BaseException:
        graph.kill()
        raise
    graph.end()


def record_graph(bag: Path, recording: Path, rate: float, logs: Path, live: bool = False) -> None:
    """Play a bag to the three nodes and record what they publish.

    live: the nodes have their defaults, as for a camera: what comes too fast is dropped and counted.
    """
    with running_graph(logs) as graph:
        for executable, package in NODES.items():
            patience = ENCODER_PATIENCE if executable == "encoder_node" else PATIENCE
            graph.start(package, executable, *_ros_arguments({} if live else patience))
        graph.start("neuse_bags", "record", "--out", recording, "--overwrite")
        waiting = ["--wait-for", str(START_S), "--wait-topics", *AWAITED]
        graph.start("neuse_bags", "play", bag, "--rate", rate, *waiting)
        graph.wait("play")
    print((logs / "play.log").read_text().strip())


def demo(args: argparse.Namespace) -> None:
    """The command."""
    check_at_least("--rate", args.rate, LEAST_RATE, "1 is the recorded pace")
    bag, recording = args.bag or args.out / f"{args.preset}.mcap", args.out / RECORDING
    refuse_overwriting(bag, recording)
    if args.bag is None and not bag.exists():
        _simulate(args.preset, bag)
    BagReader(bag).close()  # a bag that cannot be read is told before anything starts
    record_graph(bag, recording, args.rate, args.out / "logs", args.live)
    if args.live:
        print("\n".join(last_summaries(args.out / "logs")))
    print(evaluate_recording(recording, bag, args.out))
    print(f"report: {args.out / 'report.html'}")


def _simulate(preset: str, bag: Path) -> None:
    """Simulate a world; an interrupted simulation leaves no bag that a later demo would take for whole."""
    try:
        simulate.simulate_bag(simulate.parser().parse_args([preset, "--out", str(bag)]))
    except KeyboardInterrupt:
        bag.unlink(missing_ok=True)
        raise


def last_summaries(logs: Path) -> list[str]:
    """What each node counted, as it said it last."""
    lines = []
    for name in NODES:
        told = [line for line in (logs / f"{name}.log").read_text().splitlines() if " dropped, " in line]
        lines.append(f"{name}: {told[-1].rpartition(': ')[2] if told else 'ended before its first summary'}")
    return lines


def _ros_arguments(parameters: Mapping[str, object]) -> list[str]:
    """Parameters as a command line has them."""
    pairs = [("-p", f"{name}:={value}") for name, value in parameters.items()]
    return ["--ros-args", *(word for pair in pairs for word in pair)] if pairs else []


def _executable(package: str, name: str) -> Path:
    try:
        return Path(get_package_prefix(package), "lib", package, name)
    except PackageNotFoundError as error:
        raise NeuseError(f"package {package} is not built; run make, or colcon build") from error


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("demo", __doc__)
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into")
    made.add_argument("--preset", default="tabletop", help="world to simulate (tabletop)")
    made.add_argument("--bag", type=Path, metavar="BAG", help="bag to play instead of a simulated one")
    made.add_argument("--rate", type=float, default=1.0, metavar="R", help="times the recorded pace (1)")
    made.add_argument(
        "--live", action="store_true", help="as from a camera: frames that come too fast are dropped"
    )
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), demo, argv)
