"""What the commands have in common: exit codes, one clear line for bad input, a whole file on Ctrl-C and SIGTERM."""

import argparse
import signal
import sys
from collections.abc import Callable
from typing import Any

from neuse.errors import NeuseError

BAD_INPUT = 2
INTERRUPTED = 130


def parser(command: str, description: str, **options: Any) -> argparse.ArgumentParser:
    """An argument parser that shows defaults and keeps the description's line breaks."""
    return argparse.ArgumentParser(
        prog=command, description=description, formatter_class=argparse.RawDescriptionHelpFormatter, **options
    )


def run_command(
    parser: argparse.ArgumentParser,
    action: Callable[[argparse.Namespace], None],
    argv: list[str] | None = None,
) -> int:
    """Parse, act, and turn expected errors into an exit code; SIGTERM ends a command like Ctrl-C.

    Arguments that `ros2 launch` appends (--ros-args ...) are left to rclpy.
    """
    args = parser.parse_args(_own_arguments(sys.argv[1:] if argv is None else argv))
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        action(args)
    except NeuseError as error:
        print(f"{parser.prog}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        return INTERRUPTED
    return 0


def _own_arguments(argv: list[str]) -> list[str]:
    return argv[: argv.index("--ros-args")] if "--ros-args" in argv else argv
