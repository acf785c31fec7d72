"""Are the known objects still there? Counts keyframes that see an object's place empty."""

from collections.abc import Set

import numpy as np

from neuse.geometry import inverse, transform_points
from neuse.mapping.evidence import Evidence
from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe, visible
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord


class Presence:
    """A count per object: up for each keyframe that sees its place empty, down for each that sees it taken.

    A place partly seen through counts half. The paper calls an object removed if it is not matched in a
    period with global loop closure. Here its place must be seen empty from well-anchored keyframes, so that
    missed or merged masks remove nothing.
    """

    def __init__(self, evidence: Evidence, enough: int) -> None:
        self._evidence, self._enough = evidence, enough
        self._empty: dict[int, float] = {}
        self._claims: dict[int, int] = {}  # {object: by whom its place was taken}
        self._returned: dict[int, int] = {}

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
        centers = transform_points(T_camera_map, np.array([record.rough_center for record in missing]))
        for record, in_view in zip(missing, visible(centers, keyframe.intrinsics), strict=True):
            if in_view:
                self._missed(record, keyframe)

    def is_gone(self, object_id: int) -> bool:
        """The place was seen empty often enough, or another object stands there."""
        return object_id in self._claims or self._is_empty(object_id)

    def disputed(self, waiting: Set[int]) -> set[int]:
        """Objects whose places were not seen empty, only taken by others that wait to be reported."""
        return {i for i, by_id in self._claims.items() if by_id in waiting and not self._is_empty(i)}

    def has_returned(self, object_id: int) -> bool:
        """An object that was removed has been matched at its place often enough since."""
        return self._returned.get(object_id, 0) >= self._enough

    def displace(self, object_id: int, by_id: int) -> None:
        """Another object has taken the place: this one is gone until it is matched again."""
        self._claims[object_id] = by_id

    def withdraw(self, by_id: int) -> None:
        """That object has taken no place: it is one known before."""
        self._claims = {i: claimant for i, claimant in self._claims.items() if claimant != by_id}

    def forget(self, object_id: int) -> None:
        """What was known no longer holds: the object has moved, returned, or left the map."""
        self._empty.pop(object_id, None)
        self._returned.pop(object_id, None)
        self._claims.pop(object_id, None)

    def _saw(self, record: ObjectRecord) -> None:
        if record.is_present:
            self.forget(record.object_id)
        else:
            self._returned[record.object_id] = self._returned.get(record.object_id, 0) + 1

    def _is_empty(self, object_id: int) -> bool:
        return self._empty.get(object_id, 0.0) >= self._enough

    def _missed(self, record: ObjectRecord, keyframe: SeenKeyframe) -> None:
        sight = self._evidence.sight(
            record.points, keyframe, record.last_tick, record.object_id, carried=True
        )
        if sight is None:
            return
        count = self._empty.get(record.object_id, 0.0)
        if sight.emptiness:
            self._empty[record.object_id] = count + sight.emptiness
        elif sight.is_taken:
            self._empty[record.object_id] = max(0.0, count - 1.0)
