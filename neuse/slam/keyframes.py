"""Keyframes: when a frame becomes one, what is kept of it, and all frames through them (NeuSE IV-C)."""

from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array, inverse, rotation_angle
from neuse.params import CheckedParams, param
from neuse.slam.object_frames import ObjectFrames
from neuse.slam.odometry import OdometryFix


@dataclass(frozen=True)
class KeyframeParams(CheckedParams):
    """When a frame becomes a keyframe; a new object always makes one."""

    min_distance_m: float = param(0.04, "distance from the last keyframe, metres (paper: 0.04)", 0.0, 10.0)
    min_rotation_rad: float = param(0.1, "turn from the last keyframe, rad", 0.0, 3.15)


@dataclass(frozen=True)
class KeyframeRecord:
    """A keyframe as it was observed: keys (n,) of the tracks seen, their frames, and the odometry there."""

    keyframe_id: int
    stamp_ns: int
    keys: np.ndarray
    frames: ObjectFrames
    fix: OdometryFix | None


@dataclass(frozen=True)
class FrameRecord:
    """Any frame, held by its keyframe: p_keyframe = T_keyframe_camera @ p_camera."""

    stamp_ns: int
    keyframe_id: int
    T_keyframe_camera: Array


class KeyframeLibrary:
    """Keyframes with their latest estimates, and all frames relative to them. Ids count up from 0."""

    def __init__(self, params: KeyframeParams | None = None) -> None:
        self.params = params or KeyframeParams()
        self.records: list[KeyframeRecord] = []
        self.frames: list[FrameRecord] = []
        self.T_map_camera: Array = np.zeros((0, 4, 4))

    def is_due(self, T_map_camera: Array) -> bool:
        """Whether the camera has moved enough since the last keyframe."""
        if not self.records:
            return True
        motion = inverse(self.T_map_camera[-1]) @ T_map_camera
        far = np.linalg.norm(motion[:3, 3]) >= self.params.min_distance_m
        return bool(far or rotation_angle(motion[:3, :3]) >= self.params.min_rotation_rad)

    def add_frame(self, stamp_ns: int, T_map_camera: Array) -> None:
        """Remember a frame relative to the last keyframe."""
        T_keyframe_camera = inverse(self.T_map_camera[-1]) @ T_map_camera
        self.frames.append(FrameRecord(stamp_ns, len(self.records) - 1, T_keyframe_camera))

    def trajectory(self) -> list[tuple[int, Array]]:
        """(stamp_ns, T_map_camera) of every frame by the latest estimates."""
        if not self.frames:
            return []
        held = self.T_map_camera[[frame.keyframe_id for frame in self.frames]]
        T = held @ np.stack([frame.T_keyframe_camera for frame in self.frames])
        return [(frame.stamp_ns, pose) for frame, pose in zip(self.frames, T, strict=True)]

    def frame_near(self, stamp_ns: int, tolerance_ns: int) -> FrameRecord | None:
        """The frame nearest in time, None if none is within the tolerance."""
        if not self.frames:
            return None
        stamps = np.array([frame.stamp_ns for frame in self.frames], dtype=np.int64)
        nearest = int(np.abs(stamps - stamp_ns).argmin())
        return self.frames[nearest] if abs(int(stamps[nearest]) - stamp_ns) <= tolerance_ns else None
