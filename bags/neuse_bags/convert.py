"""Make a bag of one's own data: a folder of pictures, or a ROS 2 bag whose topics have other names.

Which of these a folder is, is seen from its files. What cannot be used is told in one line: which file, and
what to write. `neuse_bags info BAG` says the same of a finished bag.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from tqdm import tqdm

from neuse.errors import BagError, InputError, NeuseError, ParamError
from neuse.records import RgbdFrame
from neuse_bags import bop, folder, topics, tum
from neuse_bags.cli import command_parser, run_command, stop_on_signal
from neuse_bags.conversions import WORLD_FRAME, odometry_to_msg
from neuse_bags.frames import write_frame
from neuse_bags.inspection import inspect_bag
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.pictures import FrameSource, Poses
from neuse_bags.renamed import RenamedBag, read_names
from neuse_bags.roles import ROLES
from neuse_bags.scale import ScaleCheck

LAYOUTS: dict[str, Callable[[Path], FrameSource]] = {
    folder.MARK: folder.open_folder,
    tum.MARK: tum.open_tum,
    bop.MARK: bop.open_bop,
}
EARLY = 20  # so many frames tell whether the unit of depth is right
BAG_HELP = """ROS 2 bag: an .mcap or .db3 file, or a rosbag2 folder.

--remap FROM:=TO ..., or YAML files with lines `FROM: TO`; compressed images (PNG, compressedDepth, colour
as JPEG) are unpacked; TO is one of
"""


def convert(args: argparse.Namespace) -> None:
    """The command; a source that cannot be converted leaves no bag, and one of that name as it was."""
    if args.source.is_file() or (args.source / "metadata.yaml").exists():
        n_frames = _convert_bag(args.source, read_names(args.remap), args.out)
    elif args.remap:
        raise ParamError(f"--remap is for bags, and {args.source} is none; leave it out")
    else:
        n_frames = _convert_folder(open_source(args.source), args.out)
    print(f"{args.out}: {n_frames} frames")


def open_source(path: Path) -> FrameSource:
    """The frames of a folder, by the layout that it has.

    Raises:
        InputError: it has none, or a file of it is missing or wrong.
    """
    for mark, open_layout in LAYOUTS.items():
        if (path / mark).exists():
            return open_layout(path)
    if not path.exists():
        raise InputError("layout", f"{path} does not exist; give a folder of pictures or a bag")
    scenes = sorted([*path.glob(f"*/{bop.MARK}"), *path.glob(f"*/*/{bop.MARK}")])
    if scenes:
        told = f"{path} holds {len(scenes)} scene(s) of BOP; give one scene, such as {scenes[0].parent}"
        raise InputError("layout", told)
    marks = ", ".join(LAYOUTS)
    raise InputError("layout", f"{path} has none of {marks}, and is no bag; see --help for what to write")


def _convert_folder(source: FrameSource, out: Path) -> int:
    """Write a bag of a folder; returns the number of frames."""
    for note in source.notes:
        print(f"convert: {note}", file=sys.stderr)
    with _whole_bag(out) as writer:
        topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
        _write_poses(writer, topics.ODOMETRY, "odom", source.trajectories.odometry)
        _write_poses(writer, topics.TRUE_ODOMETRY, WORLD_FRAME, source.trajectories.ground_truth)
        _write_frames(writer, source)
    _tell_skipped(source.skipped)
    return writer.counts[topics.DEPTH.name]


@contextmanager
def _whole_bag(out: Path) -> Iterator[BagWriter]:
    """A writer whose file gets its name once it is complete; after a fault `out` is as it was."""
    if out.suffix != ".mcap" or out.is_dir():
        raise BagError(f"{out} cannot be a bag: its name must end in .mcap, and be no folder's")
    part = out.with_name(f"{out.stem}.part.mcap")
    try:
        with BagWriter(part) as writer:
            yield writer
        part.replace(out)
    finally:
        part.unlink(missing_ok=True)


def _tell_skipped(skipped: Sequence[NeuseError]) -> None:
    if skipped:
        told = f"{len(skipped)} colour picture(s) left out, which are for people only; the first"
        print(f"convert: {told}: {skipped[0]}", file=sys.stderr)


def _write_frames(writer: BagWriter, source: FrameSource) -> None:
    scale, labels = ScaleCheck(), LabelCheck()
    with stop_on_signal() as stop:
        for index, frame in enumerate(tqdm(source.frames(), total=source.n_frames, unit="frame")):
            write_frame(writer, frame)
            scale.add(frame)
            labels.add(frame)
            if index in (EARLY, source.n_frames - 1):
                _check_unit(scale, source)
            if stop.is_set():
                raise KeyboardInterrupt
    if labels.fault():
        raise InputError("labels", f"{labels.fault()}; {source.label_hint}")


class LabelCheck:
    """Collects which labels the masks have, and which the instances."""

    def __init__(self) -> None:
        self._in_masks, self._named = set[int](), set[int]()
        self._any_seen = False

    def add(self, frame: RgbdFrame) -> None:
        """Take in one frame."""
        in_mask, named = set(np.unique(frame.mask).tolist()), {i.label for i in frame.instances}
        self._any_seen |= bool(in_mask & named)
        self._in_masks |= in_mask - {0}
        self._named |= named

    def fault(self) -> str | None:
        """What is wrong where no frame shows an instance."""
        if self._any_seen:
            return None
        in_masks, named = (_listed(labels) for labels in (self._in_masks, self._named))
        return f"no frame has an instance: the masks have labels {in_masks}, the instances {named}"


def _listed(labels: set[int]) -> str:
    return ", ".join(map(str, sorted(labels)[:10])) or "none"


def _check_unit(scale: ScaleCheck, source: FrameSource) -> None:
    fault = scale.fault()
    if fault:
        raise InputError("unit", f"{fault.text}; {source.unit_hint(fault.factor)}")


def _write_poses(writer: BagWriter, spec: topics.TopicSpec, frame_id: str, poses: Poses) -> None:
    """Poses as odometry; a trajectory that is not there leaves no topic."""
    if poses:
        topics.declare(writer, (spec,))
    for stamp_ns, T_frame_camera in poses:
        writer.write(spec.name, odometry_to_msg(stamp_ns, T_frame_camera, frame_id), stamp_ns)


def _convert_bag(path: Path, names: dict[str, str], out: Path) -> int:
    """Copy what the graph knows under the graph's names; returns the number of frames."""
    if out.exists() and path.resolve() in (out.resolve(), out.resolve().parent):
        raise BagError(f"{path} would be overwritten by its own copy; choose another --out")
    renamed = RenamedBag(path, names)
    with renamed as bag:
        report = inspect_bag(bag)
        for note in report.notes:
            print(f"convert: {note}", file=sys.stderr)
        if report.faults:
            more = f" (and {len(report.faults) - 1} more)" if len(report.faults) > 1 else ""
            raise BagError(f"{path}: {report.faults[0]}{more}")
        with _whole_bag(out) as writer:
            _copy(bag, writer)
        _tell_skipped(renamed.skipped)
    return report.n_frames


def _copy(bag: BagReader, writer: BagWriter) -> None:
    specs = [role.topic for role in ROLES if role.topic.name in bag.topics]
    topics.declare(writer, tuple(specs))
    total = sum(bag.topics[spec.name].n_messages for spec in specs)
    with stop_on_signal() as stop:
        for message in tqdm(bag.messages([s.name for s in specs]), total=total, unit="message"):
            writer.write_raw(message.topic, message.data, message.stamp_ns)
            if stop.is_set():
                raise KeyboardInterrupt


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    known = "\n".join(f"  {role.topic.name:<26}{role.topic.type_name:<30}{role.meaning}" for role in ROLES)
    layouts = (module.__doc__ or "" for module in (folder, tum, bop))
    made = command_parser("convert", "\n\n".join([__doc__ or "", *layouts, BAG_HELP + known]))
    made.add_argument("source", type=Path, metavar="SOURCE", help="folder or bag")
    made.add_argument("--out", type=Path, required=True, metavar="BAG", help=".mcap file to write")
    made.add_argument(
        "--remap",
        nargs="+",
        default=[],
        metavar="FROM:=TO",
        help="topics of a bag under the graph's names, or YAML files of them",
    )
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), convert, argv)
