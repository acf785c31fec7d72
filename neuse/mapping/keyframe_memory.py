"""Memory of keyframes: their latest poses, and what each saw: centres of objects, and depth."""

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from neuse.geometry import Array, inverse
from neuse.records import NO_ID, Intrinsics, Keyframe, TrackedFrame

_MOVED = 5e-4  # m, rad: a keyframe that moved less keeps its pose, and its objects their averages
_MM = 1000.0
_BLIND_FRAMES = 3  # without a known object in sight, which hardly drift


@dataclass
class SeenKeyframe:
    """What a keyframe saw. depth_mm: (h', w') uint16, 0 = no reading, or None once forgotten.

    tick: step of the mapper at which it came.    centers: object id -> (3,) observed centre, camera frame.
    """

    keyframe_id: int
    tick: int
    intrinsics: Intrinsics
    depth_mm: np.ndarray | None
    centers: dict[int, Array] = field(default_factory=dict)

    @property
    def coarse_depth_m(self) -> np.ndarray:
        """(h', w') float32, metres."""
        assert self.depth_mm is not None
        return self.depth_mm.astype(np.float32) / np.float32(_MM)


class KeyframeMemory:
    """Keyframes by id. `poses` holds p_map = poses[id] @ p_camera; poses[NO_ID] is the map itself."""

    def __init__(self, max_depths: int) -> None:
        self.poses: dict[int, Array] = {NO_ID: np.eye(4)}
        self.seen: dict[int, SeenKeyframe] = {}
        self._max_depths = max_depths
        self._with_depth: list[SeenKeyframe] = []  # in the order in which they came
        self._blind_ticks: list[int] = []  # steps at which no known object was in sight
        self._latest = NO_ID

    def update(self, frame: TrackedFrame, keyframes: Iterable[Keyframe], tick: int) -> set[int]:
        """Take over the latest poses and store a keyframe; the ids of keyframes that moved."""
        if not self._blind_ticks:  # what was before the first frame was long before
            self._blind_ticks = (_BLIND_FRAMES + 1) * [tick]
        elif frame.odometry_only:
            self._blind_ticks.append(tick)
        latest = {keyframe.keyframe_id: keyframe.T_map_camera for keyframe in keyframes}
        if frame.keyframe_id != NO_ID:
            latest.setdefault(frame.keyframe_id, frame.T_map_camera)
            self._latest = frame.keyframe_id
            depth_mm = _to_millimetres(frame.coarse_depth_m)
            self.add(SeenKeyframe(frame.keyframe_id, tick, frame.intrinsics, depth_mm))
        moved = self._moved(latest)
        self.poses |= {i: T for i, T in latest.items() if i in moved or i not in self.poses}
        return moved

    def add(self, keyframe: SeenKeyframe) -> None:
        """Store a keyframe that came after all others."""
        self.seen[keyframe.keyframe_id] = keyframe
        if keyframe.depth_mm is not None:
            self._with_depth.append(keyframe)
            self._keep_to_limit()

    def reference(self, frame: TrackedFrame) -> tuple[int, Array]:
        """The keyframe to which a frame's views are tied, and T_keyframe_camera of the frame."""
        if frame.keyframe_id != NO_ID:
            return frame.keyframe_id, np.eye(4)
        return self._latest, inverse(self.poses[self._latest]) @ frame.T_map_camera

    def in_sight_since(self, tick: int, at_most: int) -> int:
        """Since when, at most so many steps before that one, known objects have been in sight."""
        index = bisect_right(self._blind_ticks, tick) - _BLIND_FRAMES - 1
        return max(tick - at_most, self._blind_ticks[index]) if index >= 0 else tick

    def in_sight_until(self, tick: int, at_most: int) -> int:
        """Until when, at most so many steps after that one, known objects have been in sight."""
        index = bisect_right(self._blind_ticks, tick) + _BLIND_FRAMES
        too_late = self._blind_ticks[index] if index < len(self._blind_ticks) else tick + at_most + 1
        return min(tick + at_most, too_late - 1)

    def shortly_before(self, keyframe: SeenKeyframe, at_most: int) -> Iterator[SeenKeyframe]:
        """Keyframes of the same session at most so many steps before that one, the latest first.

        None from before known objects were out of sight.
        """
        last_id, since = keyframe.keyframe_id, self.in_sight_since(keyframe.tick, at_most)
        for keyframe_id in range(last_id - 1, last_id - 1 - at_most, -1):
            earlier = self.seen.get(keyframe_id)
            if earlier is not None and earlier.tick >= since:
                yield earlier

    def nearest_views(
        self, center: Array, ticks: range, max_range_m: float, count: int
    ) -> list[SeenKeyframe]:
        """The `count` keyframes with depth of those steps nearest to a place (3,) that is in view."""
        candidates = [keyframe for keyframe in self._with_depth if keyframe.tick in ticks]
        if not candidates:
            return []
        T_camera_map = inverse(np.stack([self.poses[k.keyframe_id] for k in candidates]))
        centers = T_camera_map[:, :3, :3] @ center + T_camera_map[:, :3, 3]
        in_view = np.zeros(len(candidates), dtype=bool)
        for intrinsics in {keyframe.intrinsics for keyframe in candidates}:
            by_it = [keyframe.intrinsics == intrinsics for keyframe in candidates]
            in_view[by_it] = visible(centers[by_it], intrinsics)
        ranges_m = np.linalg.norm(centers, axis=1)
        nearest = np.argsort(ranges_m, kind="stable")
        return [candidates[i] for i in nearest if in_view[i] and ranges_m[i] <= max_range_m][:count]

    def _moved(self, latest: Mapping[int, Array]) -> set[int]:
        """Known keyframes whose pose is another now."""
        ids = [keyframe_id for keyframe_id in latest if keyframe_id in self.poses]
        if not ids:
            return set()
        change = np.array([latest[i] for i in ids]) - np.array([self.poses[i] for i in ids])
        return {ids[i] for i in np.flatnonzero(np.abs(change).max(axis=(1, 2)) > _MOVED)}

    def _keep_to_limit(self) -> None:
        """Let go of the depth image that leaves the smallest gap."""
        if len(self._with_depth) > self._max_depths:
            index = most_redundant([keyframe.tick for keyframe in self._with_depth])
            self._with_depth.pop(index).depth_mm = None


def most_redundant(ticks: Sequence[int]) -> int:
    """Index of the one of at least three ascending steps without which the rest is spread most evenly."""
    return int(np.argmin(np.subtract(ticks[2:], ticks[:-2]))) + 1


def visible(centers: Array, intrinsics: Intrinsics) -> np.ndarray:
    """(n,) bool: which points (n, 3), camera frame, project into the image."""
    z = np.maximum(centers[:, 2], 1e-6)
    u = intrinsics.fx * centers[:, 0] / z + intrinsics.cx
    v = intrinsics.fy * centers[:, 1] / z + intrinsics.cy
    inside = (u >= 0) & (u < intrinsics.width) & (v >= 0) & (v < intrinsics.height)
    return inside & (centers[:, 2] > 0)


def _to_millimetres(coarse_depth_m: np.ndarray) -> np.ndarray:
    limit = np.iinfo(np.uint16).max
    return (
        np.nan_to_num(coarse_depth_m * _MM, nan=0.0, posinf=0.0, neginf=0.0).clip(0, limit).astype(np.uint16)
    )
