"""Keyframes: when a frame becomes one, what is kept of it, and all frames through them (NeuSE IV-C)."""

from dataclasses import dataclass, replace

import numpy as np

from neuse.geometry import Array, inverse, rotation_angle
from neuse.params import CheckedParams, param
from neuse.slam.growing import GrowingArray
from neuse.slam.object_frames import ObjectFrames, reduce_codes
from neuse.slam.odometry import OdometryFix

NO_KEYS, NO_FRAMES = np.zeros(0, dtype=np.intp), reduce_codes([])


@dataclass(frozen=True)
class KeyframeParams(CheckedParams):
    """When a frame becomes a keyframe; a new object always makes one."""

    min_distance_m: float = param(0.04, "distance from the last keyframe, metres (paper: 0.04)", 0.0, 10.0)
    min_rotation_rad: float = param(0.1, "turn from the last keyframe, rad", 0.0, 3.15)
    near_m: float = param(
        0.15, "keyframes nearer to each other see objects from one place, metres", 0.0, 10.0
    )
    views: int = param(
        14, "a keyframe leaves the graph when so many others have seen from its place all it sees", 1, 10**6
    )


@dataclass(frozen=True)
class KeyframeRecord:
    """A keyframe as it was observed: keys (n,) of the tracks seen, their frames, and the odometry there."""

    keyframe_id: int
    stamp_ns: int
    keys: np.ndarray
    frames: ObjectFrames
    fix: OdometryFix | None

    def forgotten(self) -> "KeyframeRecord":
        """All that is left of a keyframe that has left the graph."""
        return replace(self, keys=NO_KEYS, frames=NO_FRAMES, fix=None)


@dataclass(frozen=True)
class FrameRecord:
    """Any frame, held by its keyframe: p_keyframe = T_keyframe_camera @ p_camera."""

    stamp_ns: int
    keyframe_id: int
    T_keyframe_camera: Array


class KeyframeLibrary:
    """Keyframes with their latest estimates, and all frames relative to them. Ids count up from 0.

    Keyframes that have left the graph keep their places beside others, which stand in for them.
    """

    def __init__(self, params: KeyframeParams | None = None) -> None:
        self.params = params or KeyframeParams()
        self.records: list[KeyframeRecord] = []
        self._stamps_ns, self._holders = GrowingArray((), np.int64), GrowingArray((), np.intp)
        self._T_keyframe_camera = GrowingArray((4, 4))  # of all frames
        self._T_map_camera = GrowingArray((4, 4))
        self._left, self._stand_ins = GrowingArray((), np.intp), GrowingArray((), np.intp)
        self._T_stand_in_left = GrowingArray((4, 4))

    @property
    def T_map_camera(self) -> Array:
        """(n, 4, 4) latest estimates; of the newest keyframe once it is solved."""
        return self._T_map_camera.rows

    def place(self, ids: np.ndarray, T_map_camera: Array) -> None:
        """Latest estimates (n, 4, 4) of the keyframes `ids` (n,), among them all that are new."""
        known = ids < len(self._T_map_camera)
        self.T_map_camera[ids[known]] = T_map_camera[known]
        self._T_map_camera.extend(T_map_camera[~known])

    def move(self, T_target_map: Array) -> None:
        """The map frame becomes another: p_target = T_target_map @ p_map."""
        self.T_map_camera[:] = T_target_map @ self.T_map_camera

    def placed(self, ids: np.ndarray, T_map_camera: Array) -> Array:
        """(n, 4, 4) of all keyframes where those in the graph, `ids` (m,), are at (m, 4, 4).

        Those that have left the graph go where those lead that stand in for them.
        """
        T = self.T_map_camera.copy()
        T[ids] = T_map_camera
        T[self._left.rows] = T[self._stand_ins.rows] @ self._T_stand_in_left.rows
        return T

    def let_go(self, keyframe_id: int, stand_in: int, T_stand_in_left: Array) -> None:
        """A keyframe has left the graph: p_stand_in = T_stand_in_left @ p_left for ever."""
        self.records[keyframe_id] = self.records[keyframe_id].forgotten()
        self._left.append(keyframe_id)
        self._stand_ins.append(stand_in)
        self._T_stand_in_left.append(T_stand_in_left)

    def is_due(self, T_map_camera: Array) -> bool:
        """Whether the camera has moved enough since the last keyframe."""
        if not self.records:
            return True
        motion = inverse(self.T_map_camera[-1]) @ T_map_camera
        far = np.linalg.norm(motion[:3, 3]) >= self.params.min_distance_m
        return bool(far or rotation_angle(motion[:3, :3]) >= self.params.min_rotation_rad)

    def add_frame(self, stamp_ns: int, T_map_camera: Array) -> None:
        """Remember a frame relative to the last keyframe."""
        self._stamps_ns.append(stamp_ns)
        self._holders.append(len(self.records) - 1)
        self._T_keyframe_camera.append(inverse(self.T_map_camera[-1]) @ T_map_camera)

    def trajectory(self, T_map_camera: Array) -> list[tuple[int, Array]]:
        """(stamp_ns, T_map_camera) of every frame, through poses (n, 4, 4) of the keyframes."""
        T = T_map_camera[self._holders.rows] @ self._T_keyframe_camera.rows
        return list(zip(self._stamps_ns.rows.tolist(), T, strict=True))

    def frame_near(self, stamp_ns: int, tolerance_ns: int) -> FrameRecord | None:
        """The frame nearest in time as its keyframe of the graph holds it; None if none is near enough."""
        stamps_ns = self._stamps_ns.rows
        after = int(np.searchsorted(stamps_ns, stamp_ns))
        around = [i for i in (after - 1, after) if 0 <= i < len(stamps_ns)]
        nearest = min(around, key=lambda i: abs(int(stamps_ns[i]) - stamp_ns), default=None)
        if nearest is None or abs(int(stamps_ns[nearest]) - stamp_ns) > tolerance_ns:
            return None
        return self._held_in_graph(nearest)

    def _held_in_graph(self, index: int) -> FrameRecord:
        stamp_ns, holder = int(self._stamps_ns.rows[index]), int(self._holders.rows[index])
        T_holder_camera, left = self._T_keyframe_camera.rows[index], self._left.rows
        row = int(np.searchsorted(left, holder))  # they leave in the order of their ids
        if row == len(left) or left[row] != holder:
            return FrameRecord(stamp_ns, holder, T_holder_camera.copy())
        T_stand_in_camera = self._T_stand_in_left.rows[row] @ T_holder_camera
        return FrameRecord(stamp_ns, int(self._stand_ins.rows[row]), T_stand_in_camera)
