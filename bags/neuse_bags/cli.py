"""What the commands have in common: exit codes, one line for bad input, a clean end on signals."""

import argparse
import math
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from neuse.errors import NeuseError, ParamError
from neuse_encoder_node.start import INTERRUPTED

BAD_INPUT = 2


def command_parser(command: str, description: str | None) -> argparse.ArgumentParser:
    """An argument parser that keeps the line breaks of its description."""
    return argparse.ArgumentParser(
        prog=f"neuse_bags {command}",
        description=description,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )


def add_weights(parser: argparse.ArgumentParser) -> None:
    """The option that names weights beside those that are shipped."""
    parser.add_argument(
        "--weights", type=Path, nargs="+", default=[], metavar="FILE", help="weights of your own categories"
    )


def add_namespace(parser: argparse.ArgumentParser) -> None:
    """The option that chooses one camera among several."""
    parser.add_argument(
        "--namespace", default="", metavar="/A", help="camera whose topics are meant, in a bag of several"
    )


def run_command(
    parser: argparse.ArgumentParser,
    action: Callable[[argparse.Namespace], int | None],
    argv: list[str] | None = None,
) -> int:
    """Parse, act, and turn expected errors into an exit code; SIGTERM interrupts like Ctrl-C.

    action: may return an exit code of its own.    What follows --ros-args is left to rclpy.
    """
    args = parser.parse_args(_own_arguments(sys.argv[1:] if argv is None else argv))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return action(args) or 0
    except NeuseError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        missing = isinstance(error, FileNotFoundError)
        hint = "check the name of the file" if missing else "choose another place"
        print(f"{parser.prog}: {where}{error.strerror or error}; {hint}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED


def check_at_least(option: str, value: float, least: float, hint: str) -> None:
    """Raises ParamError unless least <= value < infinity."""
    if not least <= value < math.inf:
        raise ParamError(f"{option} {value} must be at least {least:g} and finite; {hint}")


@contextmanager
def stop_on_signal() -> Iterator[threading.Event]:
    """An event that the first Ctrl-C or SIGTERM sets, so that no write is cut; the second interrupts."""
    stop = threading.Event()

    def handle(number: int, frame: FrameType | None) -> None:
        if stop.is_set():
            raise KeyboardInterrupt
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def ros_node(name: str) -> Iterator[Node]:
    """A node of this process; signals stay with Python, remappings come from the command line."""
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node(name)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown()


def _own_arguments(argv: list[str]) -> list[str]:
    return argv[: argv.index("--ros-args")] if "--ros-args" in argv else argv
