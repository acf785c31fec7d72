"""Several robots that share a map: where each has found itself in it, and how many bytes have crossed."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from neuse.errors import BagError
from neuse.evaluation.pose_errors import trajectory_errors
from neuse.evaluation.report import write_json
from neuse.evaluation.trajectory import Trajectory, trajectory_of
from neuse.geometry import Array, inverse, rotation_angle
from neuse.records import ObjectStatus
from neuse_bags import topics
from neuse_bags.mcap_file import BagReader
from neuse_encoder_node.conversions import stamp_from_msg
from neuse_mapper_node.conversions import object_map_from_msg
from neuse_slam_node.conversions import keyframes_from_msg
from neuse_slam_node.poses import transform_from_msg

PICTURES = (topics.DEPTH, topics.MASK)  # what a mapper would need instead of codes
UP = (topics.FRAMES, topics.KEYFRAMES)
DOWN = (topics.PRIOR_MAP, topics.CHANGES)
REPORT = "robots.json"


def evaluate_robots(recording: Path, bag: Path, folder: Path) -> str:
    """Writes robots.json; returns the summary for people.

    Raises:
        BagError: a bag cannot be read, or the first robot has published no keyframe.
    """
    with BagReader(recording) as told, BagReader(bag) as played:
        report = robots_report(told, played)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / REPORT, report)
    return summary_text(report)


def robots_report(told: BagReader, played: BagReader) -> dict[str, Any]:
    """Objects in the map, and of each robot bytes by topic, frames, and errors in the map of the first."""
    namespaces = topics.namespaces_in(played)
    paths = {name: _keyframe_path(told, name) for name in namespaces}
    first = paths[namespaces[0]]
    if first is None:
        raise BagError(f"{told.path} has no keyframe of {namespaces[0]}; did it see any object?")
    truth = {name: _true_path(played, name) for name in namespaces}
    T_world_map = np.eye(4)
    if (known := truth[namespaces[0]]) is not None:
        T_world_map = trajectory_errors(first, known).T_world_map
    return {
        "objects": _n_objects(told),
        "robots": {
            name: _counts(told, played, name) | _errors(paths[name], truth[name], T_world_map)
            for name in namespaces
        },
    }


def summary_text(report: dict[str, Any]) -> str:
    """A few lines for people."""
    lines = [f"{report['objects']} objects in the map"]
    for name, robot in report["robots"].items():
        lines.append(f"{name}: {_where(robot)}")
        n = max(robot["frames"], 1)
        up, pictures = (sum(robot[key].values()) / n / 1e3 for key in ("up", "pictures"))
        down = sum(robot["down"].values()) / n / 1e3
        lines.append(
            f"    {up:.1f} kB a frame up, {down:.1f} kB down; its pictures would be {pictures:.0f} kB a frame"
        )
    return "\n".join(lines)


def _where(robot: dict[str, Any]) -> str:
    if not robot["mapped"]:
        return f"none of {robot['frames']} frames in the map: it has not found its place"
    where = f"{robot['mapped']} of {robot['frames']} frames in the map"
    if robot["median_m"] is None:
        return where
    return f"{where}, off by {robot['median_m']:.3f} m and {robot['median_deg']:.2f} degrees (median)"


def _counts(told: BagReader, played: BagReader, namespace: str) -> dict[str, Any]:
    """Frames in the bag and in the map, and serialized bytes of all messages by topic."""
    n_bytes = {
        key: {topic.name: _size(bag, namespace + topic.name) for topic in chosen}
        for key, bag, chosen in (("pictures", played, PICTURES), ("up", told, UP), ("down", told, DOWN))
    }
    sent, mapped = (
        played.topics[namespace + topics.DEPTH.name],
        told.topics.get(namespace + topics.FRAMES.name),
    )
    return {"frames": sent.n_messages, "mapped": mapped.n_messages if mapped else 0, **n_bytes}


def _size(bag: BagReader, topic: str) -> int:
    return sum(len(message.data) for message in bag.messages([topic]))


def _errors(path: Trajectory | None, truth: Trajectory | None, T_world_map: Array) -> dict[str, Any]:
    """How far keyframes are from the truth, on which those of the first robot have been laid."""
    errors = []
    if path is not None and truth is not None:
        for stamp_ns, T_map_camera in zip(path.stamps_ns.tolist(), path.T_frame_camera, strict=True):
            if (T_world_camera := truth.at(stamp_ns)) is not None:
                off = inverse(T_world_camera) @ T_world_map @ T_map_camera
                errors.append((np.linalg.norm(off[:3, 3]), np.rad2deg(rotation_angle(off[:3, :3]))))
    median_m, median_deg = np.median(errors, axis=0).tolist() if errors else (None, None)
    return {"median_m": median_m, "median_deg": median_deg}


def _keyframe_path(told: BagReader, namespace: str) -> Trajectory | None:
    """Keyframes as they are estimated last; None without any."""
    arrays = [message.decode() for message in told.messages([namespace + topics.KEYFRAMES.name])]
    keyframes = keyframes_from_msg(arrays[-1]) if arrays else ()
    poses = [keyframe.T_map_camera for keyframe in keyframes]
    return trajectory_of([keyframe.stamp_ns for keyframe in keyframes], poses) if keyframes else None


def _true_path(played: BagReader, namespace: str) -> Trajectory | None:
    """Where the camera was; None where nobody knows."""
    messages = [message.decode() for message in played.messages([namespace + topics.TRUE_ODOMETRY.name])]
    poses = [transform_from_msg(message.pose.pose) for message in messages]
    return trajectory_of([stamp_from_msg(m.header.stamp) for m in messages], poses) if poses else None


def _n_objects(told: BagReader) -> int:
    """Objects that are there, as the last map says."""
    maps = [message.decode() for message in told.messages([topics.MAP.name])]
    known: Sequence[Any] = object_map_from_msg(maps[-1]).objects if maps else ()
    return sum(item.status != ObjectStatus.REMOVED for item in known)
