"""Camera trajectories: as published, as finally estimated, as files."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from neuse.errors import InputError
from neuse.geometry import Array, inverse, quaternion_xyzw
from neuse.records import NO_ID, Keyframe, TrackedFrame

MAX_STAMP_DIFFERENCE_S = 0.01


@dataclass(frozen=True)
class Trajectory:
    """Camera poses over time: p_frame = T_frame_camera[i] @ p_camera.

    stamps_ns: (n,) int64, strictly increasing.    T_frame_camera: (n, 4, 4).
    """

    stamps_ns: NDArray[np.int64]
    T_frame_camera: Array

    def __post_init__(self) -> None:
        if self.T_frame_camera.shape != (len(self.stamps_ns), 4, 4):
            raise InputError(
                "trajectory", f"{len(self.stamps_ns)} stamps but poses of shape {self.T_frame_camera.shape}"
            )
        if np.any(np.diff(self.stamps_ns) <= 0):
            raise InputError("trajectory", "stamps must increase; sort the trajectory")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def positions(self) -> Array:
        """(n, 3) camera positions."""
        return self.T_frame_camera[:, :3, 3]

    @property
    def length_m(self) -> float:
        """Length of the path."""
        return float(np.linalg.norm(np.diff(self.positions, axis=0), axis=1).sum())

    def between(self, start_ns: int, end_ns: int) -> "Trajectory":
        """The part with start_ns <= stamp < end_ns."""
        inside = (self.stamps_ns >= start_ns) & (self.stamps_ns < end_ns)
        return Trajectory(self.stamps_ns[inside], self.T_frame_camera[inside])

    def at(self, stamp_ns: int) -> Array | None:
        """Pose nearest in time, or None when it is further than MAX_STAMP_DIFFERENCE_S."""
        if not len(self):
            return None
        nearest = int(np.argmin(np.abs(self.stamps_ns - stamp_ns)))
        close = abs(int(self.stamps_ns[nearest]) - stamp_ns) <= MAX_STAMP_DIFFERENCE_S * 1e9
        return self.T_frame_camera[nearest] if close else None

    def transformed(self, T_target_frame: Array) -> "Trajectory":
        """The same camera path in another frame."""
        return Trajectory(self.stamps_ns, T_target_frame @ self.T_frame_camera)


@dataclass(frozen=True)
class FramePose:
    """Pose of one frame as it was published, before later frames corrected it.

    keyframe_id: NO_ID when the frame is no keyframe.    blind: no object constrained the pose.
    covariance: (6, 6) as in neuse.geometry, None if unknown.
    """

    stamp_ns: int
    T_map_camera: Array
    keyframe_id: int = NO_ID
    blind: bool = False
    n_objects: int = 0
    covariance: Array | None = None

    @classmethod
    def of(cls, frame: TrackedFrame) -> "FramePose":
        """The pose of a tracked frame."""
        return cls(
            frame.stamp_ns,
            frame.T_map_camera,
            frame.keyframe_id,
            frame.odometry_only,
            len(frame.observations),
            frame.covariance,
        )


def smoothed_trajectory(frames: Sequence[FramePose], keyframes: Sequence[Keyframe]) -> Trajectory:
    """Final poses: keyframes as optimised last, frames between carried by the keyframe before them."""
    final = {keyframe.keyframe_id: keyframe.T_map_camera for keyframe in keyframes}
    correction, poses = np.eye(4), []
    for frame in frames:
        if frame.keyframe_id in final:
            correction = final[frame.keyframe_id] @ inverse(frame.T_map_camera)
        poses.append(correction @ frame.T_map_camera)
    return trajectory_of([frame.stamp_ns for frame in frames], poses)


def trajectory_of(stamps_ns: Sequence[int], T_frame_camera: Sequence[Array]) -> Trajectory:
    """A trajectory from lists; both may be empty."""
    return Trajectory(np.array(stamps_ns, dtype=np.int64), np.array(T_frame_camera).reshape(-1, 4, 4))


def tum_lines(trajectory: Trajectory) -> list[str]:
    """Lines of a TUM file: stamp (s), position (m), quaternion in x, y, z, w order."""
    return [
        f"{stamp_ns // 10**9}.{stamp_ns % 10**9:09d} " + " ".join(f"{value:.9f}" for value in _tum_pose(T))
        for stamp_ns, T in zip(trajectory.stamps_ns.tolist(), trajectory.T_frame_camera, strict=True)
    ]


def _tum_pose(T: Array) -> Array:
    return np.concatenate([T[:3, 3], quaternion_xyzw(T)])
