"""Are the known objects still there? Counts keyframes that see an object's place empty."""

from collections.abc import Set

import numpy as np

from neuse.geometry import inverse, transform_points
from neuse.mapping.evidence import Evidence
from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe, visible
from neuse.mapping.object_library import ObjectLibrary, ObjectRecord


class Presence:
    """A count per object: up for each keyframe that sees its place empty, down for each that sees it taken.

    The paper calls an object removed if it is not matched in a period with global loop closure. Here its
    place must be seen empty from well-anchored keyframes, so that missed or merged masks remove nothing.
    """

    def __init__(self, evidence: Evidence, enough: int) -> None:
        self._evidence, self._enough = evidence, enough
        self._empty: dict[int, int] = {}
        self._displaced: set[int] = set()

    def update(
        self, keyframe: SeenKeyframe, memory: KeyframeMemory, library: ObjectLibrary, seen_ids: Set[int]
    ) -> None:
        """Take in a new keyframe that saw the objects `seen_ids` at their places."""
        for object_id in seen_ids:
            self._saw(library.records[object_id])
        missing = [record for record in library if record.is_present and record.object_id not in seen_ids]
        if not missing:
            return
        T_camera_map = inverse(memory.poses[keyframe.keyframe_id])
        centers = transform_points(T_camera_map, np.stack([record.center for record in missing]))
        for record, in_view in zip(missing, visible(centers, keyframe.intrinsics), strict=True):
            if in_view:
                self._missed(record, keyframe)

    def is_gone(self, object_id: int) -> bool:
        """The place was seen empty often enough, or another object stands there."""
        return object_id in self._displaced or self._empty.get(object_id, 0) >= self._enough

    def is_back(self, object_id: int) -> bool:
        """Nothing speaks against the object being at its place."""
        return object_id not in self._displaced and self._empty.get(object_id, 0) == 0

    def displace(self, object_id: int) -> None:
        """Another object has taken the place: it is gone until it is matched again."""
        self._displaced.add(object_id)
        self._empty[object_id] = self._enough

    def forget(self, object_id: int) -> None:
        """The object is at a new place, or has left the map."""
        self._empty.pop(object_id, None)
        self._displaced.discard(object_id)

    def _saw(self, record: ObjectRecord) -> None:
        """A match clears an object; one that was called removed must be matched as often as it was missed."""
        self._displaced.discard(record.object_id)
        count = self._empty.get(record.object_id, 0)
        self._empty[record.object_id] = 0 if record.is_present else max(0, count - 1)

    def _missed(self, record: ObjectRecord, keyframe: SeenKeyframe) -> None:
        sight = self._evidence.sight(record.points, keyframe, record.last_tick, record.object_id)
        if sight is None:
            return
        count = self._empty.get(record.object_id, 0)
        if sight.is_empty:
            self._empty[record.object_id] = min(count + 1, 2 * self._enough)
        elif sight.is_taken:
            self._empty[record.object_id] = max(0, count - 1)
