"""What a run recorded, and what the simulated bag knows, as the records that the evaluation compares."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from neuse.errors import BagError
from neuse.evaluation.estimate import Estimate
from neuse.evaluation.trajectory import FramePose, Trajectory, trajectory_of
from neuse.evaluation.truth import TrueMap, Truth
from neuse.mapping.change_detection import settled_changes
from neuse.records import ObjectMap
from neuse_bags import topics
from neuse_bags.conversions import true_objects_from_msg
from neuse_bags.mcap_file import BagReader
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_slam_node.conversions import (
    change_from_msg,
    keyframes_from_msg,
    tracked_frame_from_msg,
    transform_from_msg,
)

STAGE_PREFIX = "stage_ms/"


def read_estimate(path: Path) -> Estimate:
    """The output of a run, from the topics that it recorded.

    Raises:
        BagError: the bag cannot be read, or has no tracked frames.
    """
    with BagReader(path) as bag:
        bag.require([topics.FRAMES.name])
        frames = [tracked_frame_from_msg(message) for message in _decoded(bag, topics.FRAMES)]
        keyframes = [keyframes_from_msg(message) for message in _decoded(bag, topics.KEYFRAMES)]
        changes = [change_from_msg(message) for message in _decoded(bag, topics.CHANGES)]
        maps = [object_map_from_msg(message) for message in _decoded(bag, topics.MAP)]
        stage_ms = _stage_times(_decoded(bag, topics.DIAGNOSTICS))
    if not frames:
        raise BagError(f"{path} has no message on {topics.FRAMES.name}; did the run see any frame?")
    return Estimate(
        frames=tuple(
            FramePose(f.stamp_ns, f.T_map_camera, f.keyframe_id, f.odometry_only, len(f.observations))
            for f in frames
        ),
        keyframes=keyframes[-1] if keyframes else (),
        edges=tuple(edge for frame in frames for edge in frame.edges),
        rejected_edges=sum(frame.rejected_edges for frame in frames),
        changes=settled_changes(changes),
        maps=tuple(_by_stamp(maps)),
        stage_ms=stage_ms,
    )


def read_truth(path: Path, namespace: str = "") -> Truth | None:
    """The ground truth of a simulated bag; None for a bag that has no true camera poses.

    Raises:
        BagError: the bag cannot be read.
    """
    with BagReader(path, namespace) as bag:
        if topics.TRUE_ODOMETRY.name not in bag.topics:
            return None
        return Truth(
            trajectory=_trajectory(_decoded(bag, topics.TRUE_ODOMETRY)),
            maps=tuple(
                TrueMap(stamp_from_msg(message.header.stamp), true_objects_from_msg(message))
                for message in _decoded(bag, topics.TRUE_MAP)
            ),
            changes=tuple(change_from_msg(message) for message in _decoded(bag, topics.TRUE_CHANGES)),
            traversal_starts_ns=tuple(m.stamp_ns for m in bag.messages([topics.TRUE_TRAVERSAL.name])),
        )


def _decoded(bag: BagReader, topic: topics.TopicSpec) -> Iterator[Any]:
    return (message.decode() for message in bag.messages([topic.name]))


def _trajectory(messages: Iterator[Any]) -> Trajectory:
    poses = [(stamp_from_msg(m.header.stamp), transform_from_msg(m.pose.pose)) for m in messages]
    return trajectory_of([stamp_ns for stamp_ns, _ in poses], [T for _, T in poses])


def _by_stamp(maps: list[ObjectMap]) -> list[ObjectMap]:
    """Maps in the order of their stamps, the last of each stamp."""
    latest = {one.stamp_ns: one for one in maps}
    return [latest[stamp_ns] for stamp_ns in sorted(latest)]


def _stage_times(messages: Iterator[Any]) -> dict[str, float]:
    """Means over the run by stage: each node reports its own since its start, so its last word counts."""
    values = (value for message in messages for status in message.status for value in status.values)
    stages = (value for value in values if value.key.startswith(STAGE_PREFIX))
    return {value.key.removeprefix(STAGE_PREFIX): float(value.value) for value in stages}
