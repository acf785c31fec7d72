"""Command line of the library: `neuse train ...`, which is `python -m neuse train ...`."""

import argparse
import sys
from collections.abc import Sequence
from importlib import import_module

COMMANDS = {"train": "neuse.embedding.train"}


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command with the arguments that follow it; returns the exit code."""
    parser = argparse.ArgumentParser(prog="neuse", description=__doc__)
    parser.add_argument("command", choices=COMMANDS, help="its own --help says more")
    parser.add_argument("arguments", nargs=argparse.REMAINDER)
    given = parser.parse_args(argv)
    return int(import_module(COMMANDS[given.command]).main(given.arguments))


if __name__ == "__main__":
    sys.exit(main())
