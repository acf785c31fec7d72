"""Say whether a bag has what the graph needs, and what is missing.

Exit code 0: the graph can use it. 1: it cannot; each line that begins with `missing` says what to change.
2: the bag cannot be read.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from neuse.embedding.embedding import load_embeddings, shipped_categories
from neuse_bags.cli import add_namespace, add_weights, command_parser, run_command
from neuse_bags.inspection import BagReport, inspect_bag
from neuse_bags.mcap_file import BagReader, BagTopic
from neuse_bags.roles import Role

UNUSABLE = 1


def info(args: argparse.Namespace) -> int:
    """The command."""
    with BagReader(args.bag, args.namespace) as bag:
        report = inspect_bag(bag, {*shipped_categories(), *load_embeddings(args.weights)})
    print("\n".join(_lines(report)))
    return UNUSABLE if report.faults else 0


def _lines(report: BagReport) -> Iterator[str]:
    """The report for people."""
    yield f"{report.path}: {report.duration_s:.1f} s, {report.n_frames} frames complete"
    for role, topic in report.found:
        yield _topic_line(role, topic, report.duration_s)
    if report.categories:
        counts = (f"{category} {count}" for category, count in report.categories.most_common())
        yield f"detections: {', '.join(counts)}"
    yield from (f"note: {note}" for note in report.notes)
    yield from (f"missing: {fault}" for fault in report.faults)
    yield "the graph cannot use it" if report.faults else "the graph can use it"


def _topic_line(role: Role, topic: BagTopic, duration_s: float) -> str:
    rate = f"{(topic.n_messages - 1) / duration_s:.1f} Hz" if topic.n_messages > 1 and duration_s else "-"
    qos = " ".join(sorted({f"{q.reliability.short_key}/{q.durability.short_key}" for q in topic.qos})) or "-"
    count = f"{topic.n_messages:>7} x"
    return f"  {role.name:<14}{topic.name:<26}{topic.type_name:<30}{count} {rate:>8}  {qos}"


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("info", __doc__)
    made.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    add_weights(made)
    add_namespace(made)
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), info, argv)
