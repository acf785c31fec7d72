"""The whole graph on a simulated bag: three nodes, a recorder and a player as processes of their own.

A bag of several cameras gets an encoder_node and a slam_node for each, in the camera's namespace, and one
mapper_node for all; DIR/robots.json then says where each has found itself and what they have exchanged.

Simulates the world unless DIR/<preset>.mcap is there, plays it to the nodes, records what they publish into
DIR/recording.mcap, and writes all that evaluate writes. What each process says goes to DIR/logs/.
"""

import argparse
import json
import os
import signal
import subprocess
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from ament_index_python.packages import PackageNotFoundError, get_package_prefix

from neuse.embedding.embedding import load_embeddings, shipped_categories, weights_file
from neuse.errors import NeuseError
from neuse_bags import simulate, topics
from neuse_bags.cli import add_weights, check_at_least, command_parser, run_command
from neuse_bags.evaluate import RECORDING, evaluate_recording, refuse_overwriting
from neuse_bags.mcap_file import BagReader
from neuse_bags.play import LEAST_RATE
from neuse_bags.robots import evaluate_robots

NODES = {
    "encoder_node": "neuse_encoder_node",
    "slam_node": "neuse_slam_node",
    "mapper_node": "neuse_mapper_node",
}
PATIENCE: dict[str, object] = {"queue_size": 1000, "finish_s": 600.0}  # a bag's frames shall all be used
ENCODER_PATIENCE = PATIENCE | {"input_depth": 100, "input_reliable": True, "hurried_share": 1.0}
OF_EACH_ROBOT = (*topics.FRAME_TOPICS, topics.ODOMETRY, topics.OBSERVATIONS, topics.FRAMES, topics.EDGES)
START_S, END_S = 180.0, 660.0


class Graph:
    """The running processes, in the order in which data flows, so that each can finish what it was sent."""

    def __init__(self, logs: Path) -> None:
        logs.mkdir(parents=True, exist_ok=True)
        self._logs = logs
        self._processes: dict[str, subprocess.Popen] = {}
        self._environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        self._environment.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 100))

    def start(
        self, package: str, executable: str, *arguments: str | Path | float, name: str = ""
    ) -> subprocess.Popen:
        """Start an executable of a package, as `ros2 run` does; name: of its log, where it runs twice."""
        name = name or executable
        with (self._logs / f"{name}.log").open("w") as log:
            self._processes[name] = subprocess.Popen(
                [_executable(package, executable), *map(str, arguments)],
                stdout=log,
                stderr=subprocess.STDOUT,
                env=self._environment,
            )
        return self._processes[name]

    def start_nodes(self, namespaces: Sequence[str], live: bool, weights: Sequence[Path] = ()) -> None:
        """The nodes of one robot, or of several with one mapper.

        live: they have their defaults, as for a camera: what comes too fast is dropped and counted.
        weights: files of categories that are not shipped.
        """
        patience = {} if live else PATIENCE
        own = [weights_file(name).resolve() for name in weights]
        known = {"weights": _listed([*shipped_categories(), *own])} if own else {}
        for index, namespace in enumerate(namespaces):
            encoder = known | ({} if live else ENCODER_PATIENCE)
            self._start_node("encoder_node", encoder, namespace)
            self._start_node("slam_node", patience | _joining(index, len(namespaces)), namespace)
        sharing = {"sessions": ",".join(namespaces)} if len(namespaces) > 1 else {}
        self._start_node("mapper_node", known | patience | sharing)

    def _start_node(self, node: str, parameters: Mapping[str, object], namespace: str = "") -> None:
        name = node + namespace.replace("/", "_")
        self.start(NODES[node], node, *_ros_arguments(parameters, namespace), name=name)

    def wait(self, name: str) -> None:
        """Wait for one process to end; all others must outlive it.

        Raises:
            NeuseError: it failed, or another one ended before.
        """
        process = self._processes[name]
        while process.poll() is None:
            self._check_alive()
            time.sleep(0.2)
        if process.returncode:
            raise self._failed(name)

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
        code, log = self._processes[name].returncode, self._logs / f"{name}.log"
        words = log.read_text(errors="replace").strip().splitlines()
        return NeuseError(f"{name} ended with code {code} ({words[-1] if words else 'silently'}); see {log}")


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


def record_graph(
    bag: Path,
    recording: Path,
    rate: float,
    logs: Path,
    live: bool = False,
    namespaces: Sequence[str] = ("",),
    weights: Sequence[Path] = (),
) -> None:
    """Play a bag to the nodes and record what they publish; namespaces: of the cameras in the bag."""
    with running_graph(logs) as graph:
        graph.start_nodes(namespaces, live, weights)
        graph.start("neuse_bags", "record", "--out", recording, "--overwrite")
        waiting = ["--wait-for", str(START_S), "--wait-topics", *awaited(namespaces)]
        graph.start("neuse_bags", "play", bag, "--rate", rate, *waiting)
        graph.wait("play")
    print((logs / "play.log").read_text().strip())


def awaited(namespaces: Sequence[str] = ("",)) -> list[str]:
    """Topics that have subscribers once all nodes, and who listens to them, are ready."""
    return [topic.under(name).name for name in namespaces for topic in OF_EACH_ROBOT] + [topics.MAP.name]


def demo(args: argparse.Namespace) -> None:
    """The command."""
    check_at_least("--rate", args.rate, LEAST_RATE, "1 is the recorded pace")
    load_embeddings(args.weights)  # weights that cannot be read are told before anything starts
    bag, recording = args.bag or args.out / f"{args.preset}.mcap", args.out / RECORDING
    refuse_overwriting(bag, recording)
    if args.bag is None and not bag.exists():
        _simulate(args.preset, bag)
    with BagReader(bag) as source:  # and so is a bag
        namespaces = topics.namespaces_in(source) or ("",)
    record_graph(bag, recording, args.rate, args.out / "logs", args.live, namespaces, args.weights)
    if len(namespaces) > 1:
        print(evaluate_robots(recording, bag, args.out))
        return
    if args.live:
        print("\n".join(last_summaries(args.out / "logs")))
    print(evaluate_recording(recording, bag, args.out, args.weights))
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


def _joining(index: int, n: int) -> dict[str, object]:
    """Parameters of one slam_node of n that share a map: the first begins it."""
    if n == 1:
        return {}
    return {"joining.session": index, "joining.sessions": n, "joining.wait_for_map": index > 0}


def _ros_arguments(parameters: Mapping[str, object], namespace: str = "") -> list[str]:
    """Parameters and namespace as a command line has them."""
    pairs = [("-p", f"{name}:={value}") for name, value in parameters.items()]
    pairs += [("-r", f"__ns:={namespace}")] if namespace else []
    return ["--ros-args", *(word for pair in pairs for word in pair)] if pairs else []


def _listed(values: Iterable[object]) -> str:
    """A list as the value of a parameter."""
    return f"[{', '.join(json.dumps(str(value)) for value in values)}]"


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
    add_weights(made)
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), demo, argv)
