"""Trajectory files of the TUM kind, and stamps that are written in seconds."""

from collections.abc import Collection
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np

from neuse.errors import InputError
from neuse.geometry import transform_from_quaternion
from neuse_bags.pictures import Poses
from neuse_slam_node.poses import FARTHEST_M

LATEST_NS = 2**31 * 10**9  # beyond what a message can hold
NEAR_NS = 500_000_000


def read_tum(path: Path, first_ns: int = 0) -> Poses:
    """(stamp_ns, T_frame_camera) of a file with lines `stamp_s x y z qx qy qz qw`; empty where there is none.

    first_ns: stamp of the second zero.
    Raises:
        InputError: a line does not have eight numbers, or no quaternion.
    """
    if not path.exists():
        return []
    return [_pose(line, path, first_ns) for line in read_lines(path)]


def read_poses(path: Path, frames_ns: Collection[int], first_ns: int = 0) -> Poses:
    """As `read_tum`, of a camera whose frames have the stamps frames_ns.

    Raises:
        InputError: as read_tum's; or no pose is at the time of a frame.
    """
    poses = read_tum(path, first_ns)
    apart = another_clock([stamp_ns for stamp_ns, _ in poses], frames_ns, first_ns)
    if apart:
        told = f"{path}: {apart}; write its stamps in the clock of the depth pictures, or leave the file out"
        raise InputError("other_clock", told)
    return poses


def another_clock(poses_ns: Collection[int], frames_ns: Collection[int], first_ns: int = 0) -> str | None:
    """What is wrong with stamps of poses, of which none is at the time of a frame; None where some are."""
    poses, frames = np.unique(np.array(poses_ns, np.int64)), np.unique(np.array(frames_ns, np.int64))
    if not len(poses) or not len(frames):
        return None
    after = np.searchsorted(poses, frames)
    around = poses[np.stack([np.maximum(after - 1, 0), np.minimum(after, len(poses) - 1)])]
    if np.abs(around - frames).min() <= NEAR_NS:
        return None
    of_poses, of_frames = (
        f"{(s[0] - first_ns) / 1e9:.3f} to {(s[-1] - first_ns) / 1e9:.3f} s" for s in (poses, frames)
    )
    return f"no pose is at the time of a frame: poses are at {of_poses}, depth at {of_frames}"


def read_lines(path: Path) -> list[list[str]]:
    """Words of each line, without comments and empty lines.

    Raises:
        InputError: the file cannot be read.
    """
    try:
        lines = path.read_text().splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError("unreadable_file", f"{path} cannot be read: {error}") from error
    return [words for line in lines if (words := line.split("#")[0].split())]


def seconds_to_ns(text: str, path: Path) -> int:
    """A stamp in seconds, digit by digit.

    Raises:
        InputError: it is no time, or none that a message can hold.
    """
    try:
        stamp_ns = int(Decimal(text) * 10**9)
    except (InvalidOperation, ValueError, OverflowError):
        stamp_ns = -1
    if not 0 <= stamp_ns < LATEST_NS:
        raise InputError("stamp", f"{path}: {text!r} is no stamp; write seconds, such as 1305031102.175304")
    return stamp_ns


def _pose(words: list[str], path: Path, first_ns: int) -> tuple[int, np.ndarray]:
    try:
        x, y, z, *q_xyzw = map(float, words[1:8])
        if len(words) < 8 or not np.isfinite([x, y, z, *q_xyzw]).all():
            raise ValueError(" ".join(words))
        if abs(np.linalg.norm(q_xyzw) - 1.0) > 0.01 or np.abs([x, y, z]).max() >= FARTHEST_M:
            raise ValueError(f"{' '.join(words)} is no pose in metres with a unit quaternion")
        T_frame_camera = transform_from_quaternion(q_xyzw, [x, y, z])
    except ValueError as error:
        raise InputError("tum", f"{path} is not `stamp_s x y z qx qy qz qw` a line: {error}") from error
    return first_ns + seconds_to_ns(words[0], path), T_frame_camera
