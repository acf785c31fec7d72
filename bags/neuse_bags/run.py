"""Run the in-process pipeline over a bag: the same library calls as the nodes, without DDS, repeatable.

DIR gets recording.mcap, with the topics that the nodes would publish, and all that evaluate writes. Ground
truth is read from the same BAG, after the run; without any, the figures that need it are null.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from neuse.embedding.embedding import load_embeddings
from neuse.errors import BagError, InputError
from neuse.geometry import Array
from neuse.pipeline import Pipeline
from neuse.records import Rejection
from neuse_bags import topics
from neuse_bags.cli import add_namespace, add_weights, command_parser, run_command, stop_on_signal
from neuse_bags.evaluate import RECORDING, evaluate_recording, refuse_overwriting
from neuse_bags.frames import IDENTITY, JOINED, read_frames, read_odometry
from neuse_bags.mcap_file import BagReader, BagWriter
from neuse_bags.parameter_file import NodeParams, read_node_params
from neuse_bags.run_recorder import RunRecorder


class Faults:
    """Counts unusable input by reason, and says each reason once."""

    def __init__(self) -> None:
        self.counts: Counter[str] = Counter()

    def add(self, error: InputError) -> None:
        """Count one."""
        if not self.counts[error.reason]:
            print(f"run: {error.reason}: {error}", file=sys.stderr)
        self.counts[error.reason] += 1

    def add_rejections(self, rejections: Sequence[Rejection]) -> None:
        """Count instances that the front end refused."""
        for rejection in rejections:
            self.add(InputError(rejection.reason, rejection.detail))


def run_pipeline(
    bag: BagReader, writer: BagWriter, pipeline: Pipeline, T_child_camera: Array = IDENTITY
) -> Counter[str]:
    """Every frame of a bag through a pipeline; returns counts of unusable input by reason.

    Args:
        T_child_camera: (4, 4) pose of the camera in the odometry's child frame.
    Raises:
        BagError: the bag has no frame that can be used.
        KeyboardInterrupt: stopped by a signal; what was written is whole.
    """
    faults, recorder = Faults(), RunRecorder(writer, pipeline)
    odometry = read_odometry(bag, faults.add, T_child_camera)
    total = bag.topics[JOINED[0]].n_messages
    with stop_on_signal() as stop:
        for frame in tqdm(read_frames(bag, faults.add), total=total, unit="frame"):
            try:
                result = pipeline.step(frame, odometry.at(frame.stamp_ns))
                recorder.add(result)
                faults.add_rejections(result.observed.rejections)
            except InputError as error:
                faults.add(error)
            if stop.is_set():
                raise KeyboardInterrupt
    if not writer.counts[topics.FRAMES.name]:
        raise BagError(f"{bag.path} has no frame of depth, mask, instances and camera info that can be used")
    recorder.add_changes(pipeline.mapper.finalize())
    recorder.finish()
    return faults.counts


def run(args: argparse.Namespace) -> None:
    """The command."""
    recording = args.out / RECORDING
    params = read_node_params(args.params_file) if args.params_file else NodeParams()
    embeddings = load_embeddings([*params.encoder_node.weights, *args.weights], params.encoder_node.device)
    refuse_overwriting(args.bag, recording)
    with BagReader(args.bag, args.namespace) as bag:
        bag.require(JOINED)
        with BagWriter(recording) as writer:
            pipeline = Pipeline(params.pipeline, embeddings)
            faults = run_pipeline(bag, writer, pipeline, params.slam_node.camera_pose)
    for line in _summary(faults, len(pipeline.mapper.object_map.objects)):
        print(f"run: {line}", file=sys.stderr)
    print(evaluate_recording(recording, args.bag, args.out, args.weights, args.namespace))


def _summary(faults: Mapping[str, int], n_objects: int) -> Iterator[str]:
    """What was not used, and why no object was mapped where there is none."""
    counts = sorted(faults.items(), key=lambda item: -item[1])
    if counts:
        yield "not used: " + ", ".join(f"{count} x {reason}" for reason, count in counts)
    if not n_objects:
        often = f"most frequent fault: {counts[0][0]}" if counts else "too few frames show the same object"
        yield f"no object was mapped; {often}; see `neuse_bags info BAG`"


def parser() -> argparse.ArgumentParser:
    """Arguments of the command."""
    made = command_parser("run", __doc__)
    made.add_argument("bag", type=Path, metavar="BAG", help=".mcap file or rosbag2 folder")
    made.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write into")
    add_weights(made)
    add_namespace(made)
    made.add_argument(
        "--params-file",
        type=Path,
        metavar="YAML",
        help="parameters, as the nodes take them",
    )
    return made


def main(argv: list[str] | None = None) -> int:
    """Entry point."""
    return run_command(parser(), run, argv)
