"""Simulate a world and write it as a bag: camera, segmentation, odometry and ground truth.

The same PRESET and --seed give the same bag. Ground truth lies under ground_truth/; only evaluate reads it.
Ctrl-C leaves a whole bag of the frames so far, and exit code 130. Of several cameras each has its own way and
its own topics, under /a, /b and so on; the world and its changes are those of the first.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from std_msgs.msg import UInt32
from tqdm import tqdm

from neuse.evaluation.simulated_truth import is_clearly_seen, true_object
from neuse.records import ObjectChange
from neuse.simulation.returning import fellow
from neuse.simulation.worlds import PRESETS, SimulatedFrame, make_world, simulate
from neuse_bags import topics
from neuse_bags.cli import check_at_least, command_parser, run_command, stop_on_signal
from neuse_bags.conversions import WORLD_FRAME, odometry_to_msg, true_map_to_msg
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagWriter
from neuse_slam_node.conversions import change_to_msg


class TruthWriter:
    """Writes ground truth beside the frames; counts how often each object is clearly seen at its place.

    Of several cameras each has poses under its namespace; the first one also tells the map and its changes.
    """

    def __init__(self, writer: BagWriter, namespaces: Sequence[str] = ("",)) -> None:
        self._writer, self._namespaces = writer, namespaces
        self._seen: Counter[int] = Counter()
        self._last: SimulatedFrame | None = None

    def add(self, simulated: SimulatedFrame, *others: SimulatedFrame) -> None:
        """Truth of one frame, and of those of other cameras; the map only where it begins or has changed."""
        stamp_ns = simulated.frame.stamp_ns
        for namespace, view in zip(self._namespaces, (simulated, *others), strict=True):
            pose = odometry_to_msg(stamp_ns, view.T_world_camera, WORLD_FRAME)
            self._writer.write(namespace + topics.TRUE_ODOMETRY.name, pose, stamp_ns)
        for change in simulated.changes:
            self._add_change(change)
        if self._last is None or simulated.changes:
            self._write_map(simulated)
        if self._last is None or simulated.traversal != self._last.traversal:
            self._writer.write(topics.TRUE_TRAVERSAL.name, UInt32(data=simulated.traversal), stamp_ns)
        for view in (simulated, *others):
            self._seen.update(item.object_id for item in view.objects if is_clearly_seen(item, view))
        self._last = simulated

    def finish(self) -> None:
        """The map once more, with the final counts."""
        if self._last is not None:
            self._write_map(self._last)

    def _add_change(self, change: ObjectChange) -> None:
        self._seen.pop(change.object_id, None)
        self._writer.write(topics.TRUE_CHANGES.name, change_to_msg(change, WORLD_FRAME), change.stamp_ns)

    def _write_map(self, simulated: SimulatedFrame) -> None:
        objects = [true_object(item, self._seen[item.object_id]) for item in simulated.objects]
        stamp_ns = simulated.frame.stamp_ns
        self._writer.write(topics.TRUE_MAP.name, true_map_to_msg(stamp_ns, objects), stamp_ns)


def simulate_bag(args: argparse.Namespace) -> None:
    """The command."""
    if args.frames is not None:
        check_at_least("--frames", args.frames, 1, "leave it out for all")
    namespaces = topics.namespaces(args.cameras)
    world = make_world(args.preset, args.seed, args.meshes)
    worlds = [world, *(fellow(world, index) for index in range(1, args.cameras))]
    n_frames = min(world.frames, args.frames or world.frames)
    with stop_on_signal() as stop, BagWriter(args.out) as writer:
        _declare(writer, namespaces)
        truth = TruthWriter(writer, namespaces)
        views = zip(*(simulate(one, 0, n_frames) for one in worlds), strict=True)
        for simulated in tqdm(views, total=n_frames, unit="frame", desc=args.preset):
            for namespace, view in zip(namespaces, simulated, strict=True):
                write_frame(writer, view.frame, namespace)
                odometry = view.odometry
                message = odometry_to_msg(odometry.stamp_ns, odometry.T_odom_camera, "odom")
                writer.write(namespace + topics.ODOMETRY.name, message, odometry.stamp_ns)
            truth.add(*simulated)
            if stop.is_set():
                break
        truth.finish()
    _report(args.out, writer, namespaces, stopped=stop.is_set())


def _declare(writer: BagWriter, namespaces: Sequence[str]) -> None:
    """All topics; of the truth only the poses are each camera's own."""
    own = (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS, topics.ODOMETRY, topics.TRUE_ODOMETRY)
    shared = tuple(topic for topic in topics.TRUTH_TOPICS if topic not in own)
    topics.declare(writer, (*(topic.under(name) for name in namespaces for topic in own), *shared))


def _report(path: Path, writer: BagWriter, namespaces: Sequence[str], stopped: bool) -> None:
    n_frames = sum(writer.counts[namespace + topics.DEPTH.name] for namespace in namespaces)
    megabytes = path.stat().st_size / 1e6
    print(f"{path}: {n_frames} frames, {megabytes:.0f} MB")
    if stopped:
        raise KeyboardInterrupt


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("simulate", __doc__)
    made.add_argument("preset", metavar="PRESET", help=f"one of {', '.join(PRESETS)}")
    made.add_argument("--seed", type=int, default=0, metavar="N", help="which world of the preset (0)")
    made.add_argument("--out", type=Path, required=True, metavar="BAG", help=".mcap file to write")
    made.add_argument(
        "--meshes",
        type=Path,
        metavar="DIR",
        help="DIR/<category>/*.obj|ply|stl replace the procedural shapes",
    )
    made.add_argument("--frames", type=int, metavar="N", help="only the first N frames (all)")
    made.add_argument("--cameras", type=int, default=1, metavar="N", help="cameras at the same time (1)")
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), simulate_bag, argv)
