"""Make a bag of a folder of one's own pictures."""

import argparse
from pathlib import Path

from tqdm import tqdm

from neuse.errors import InputError
from neuse_bags import folder, topics
from neuse_bags.cli import command_parser, run_command, stop_on_signal
from neuse_bags.conversions import WORLD_FRAME, odometry_to_msg
from neuse_bags.folder import PictureFolder, open_folder, read_tum
from neuse_bags.frames import write_frame
from neuse_bags.mcap_file import BagWriter

TRAJECTORIES = (
    ("odometry.tum", topics.ODOMETRY, "odom"),
    ("ground_truth.tum", topics.TRUE_ODOMETRY, WORLD_FRAME),
)


def convert(args: argparse.Namespace) -> None:
    """The command; a folder that cannot be converted leaves no bag."""
    pictures = open_folder(args.folder)
    trajectories = [(spec, frame_id, read_tum(args.folder / name)) for name, spec, frame_id in TRAJECTORIES]
    try:
        with BagWriter(args.out) as writer:
            topics.declare(writer, (*topics.FRAME_TOPICS, *topics.COLOR_TOPICS))
            for spec, frame_id, poses in trajectories:
                _write_trajectory(writer, spec, frame_id, poses)
            _write_frames(writer, pictures)
    except InputError:
        args.out.unlink()
        raise
    print(f"{args.out}: {writer.counts[topics.DEPTH.name]} frames")


def _write_frames(writer: BagWriter, pictures: PictureFolder) -> None:
    with stop_on_signal() as stop:
        for frame in tqdm(pictures.frames(), total=len(pictures.entries), unit="frame"):
            write_frame(writer, frame)
            if stop.is_set():
                raise KeyboardInterrupt


def _write_trajectory(writer: BagWriter, spec: topics.TopicSpec, frame_id: str, poses: list) -> None:
    """Poses as odometry; a trajectory that is not there leaves no topic."""
    if poses:
        topics.declare(writer, (spec,))
    for stamp_ns, T_frame_camera in poses:
        writer.write(spec.name, odometry_to_msg(stamp_ns, T_frame_camera, frame_id), stamp_ns)


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("convert", f"{__doc__}\n\n{folder.__doc__}")
    made.add_argument("folder", type=Path, metavar="FOLDER", help="folder with frames.json and the pictures")
    made.add_argument("--out", type=Path, required=True, metavar="BAG", help=".mcap file to write")
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), convert, argv)
