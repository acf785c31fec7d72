"""Real processes and a node to meet them, alone in a DDS domain on this machine."""

import itertools
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

START_S = 60.0  # imports of a process on a busy machine

_domains = itertools.cycle(range(20 + os.getpid() % 40, 100))
Start = Callable[..., subprocess.Popen]


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
