"""Real processes and a node to meet them, alone in a DDS domain on this machine."""

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Generator, Iterator
from pathlib import Path

import pytest
import rclpy
from ament_index_python.packages import get_package_prefix
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

START_S = 120.0  # imports of a process on a busy machine
TAIL = 4000  # characters of what a node has said that a failed test shows

_domains = itertools.cycle(range(20 + os.getpid() % 40, 100))
_running: list["RunningNode"] = []  # by the tests of this module
Start = Callable[..., subprocess.Popen]
StartNode = Callable[..., "RunningNode"]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """A failed test shows what the nodes that it met have said last."""
    report = yield
    if report.failed:
        report.sections += [(f"output of {node.name}", node.output[-TAIL:]) for node in _running]
    return report


@pytest.fixture(scope="module")
def domain() -> Iterator[int]:
    """A domain of its own for the tests of a module."""
    number = next(_domains)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(number))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        yield number


@pytest.fixture(scope="module")
def node(domain: int) -> Iterator[Node]:
    """A node in the test's own process."""
    rclpy.init(domain_id=domain, signal_handler_options=SignalHandlerOptions.NO)
    made = rclpy.create_node("listener")
    yield made
    made.destroy_node()
    rclpy.shutdown()


@pytest.fixture(scope="module")
def start_bags(domain: int) -> Iterator[Start]:
    """Starts a command of neuse_bags as a process; whatever still runs at the end is interrupted."""
    processes: list[subprocess.Popen] = []

    def start(command: str, *arguments: str | Path) -> subprocess.Popen:
        code = f"import sys; from neuse_bags.{command} import main; sys.exit(main())"
        process = subprocess.Popen(
            [sys.executable, "-c", code, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        return process

    yield start
    for process in processes:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
        process.communicate(timeout=START_S)


@pytest.fixture(scope="module")
def start_node(domain: int, tmp_path_factory: pytest.TempPathFactory) -> Iterator[StartNode]:
    """Starts a node of this project as `ros2 run` does; it is interrupted at the end and must end well."""

    def start(name: str, **parameters: object) -> RunningNode:
        _running.append(RunningNode(name, tmp_path_factory.mktemp(name) / "output.log", parameters))
        return _running[-1]

    yield start
    for node in _running:
        node.end()
    _running.clear()


class RunningNode:
    """One of the nodes as a process of its own; `output` is what it has said so far."""

    def __init__(self, name: str, log: Path, parameters: dict[str, object]) -> None:
        self.name, package = name, f"neuse_{name}"
        values = [f"-p{key}:={value}" for key, value in parameters.items() if key != "params_file"]
        executable = Path(get_package_prefix(package), "lib", package, name)
        self.log = log
        with log.open("w") as stream:
            command = [str(executable), *(["--ros-args"] if values else [])]
            command += [word for value in values for word in (value[:2], value[2:])]
            if "params_file" in parameters:
                command += ["--ros-args", "--params-file", str(parameters["params_file"])]
            self.process = subprocess.Popen(command, stdout=stream, stderr=subprocess.STDOUT)

    @property
    def output(self) -> str:
        return self.log.read_text()

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Interrupt the process if it runs; its exit code."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        return self.process.wait(timeout=START_S)
