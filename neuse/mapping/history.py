"""All changes so far, at the places where the map has them now."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from neuse.geometry import Array, inverse
from neuse.mapping.change_detection import settled_changes
from neuse.mapping.object_record import ObjectRecord
from neuse.records import ChangeKind, ObjectChange


@dataclass(frozen=True)
class _Place:
    """A pose tied to the keyframe that saw it last: p_keyframe = T_keyframe_object @ p_object."""

    keyframe_id: int
    T_keyframe_object: Array


class History:
    """Reports of changes, their places tied to keyframes: a loop closure moves them with the map."""

    def __init__(self, poses: Mapping[int, Array]) -> None:
        self._poses = poses
        self._reports: list[tuple[ObjectChange, _Place | None, _Place | None]] = []

    def report(
        self, stamp_ns: int, kind: ChangeKind, subject: ObjectRecord,
        before: ObjectRecord | None = None, after: ObjectRecord | None = None,
    ) -> ObjectChange:  # fmt: skip
        """Note a change of an object.

        before, after: the records of the object at its old and at its new place, None where it was not there.
        """
        change = ObjectChange(
            stamp_ns, kind, subject.object_id, subject.category,
            before.code.T_frame_object if before else None, after.code.T_frame_object if after else None,
        )  # fmt: skip
        if kind == ChangeKind.MOVED and after is not None:
            change = replace(change, merged_id=after.object_id)
        self._reports.append((change, self._place(before), self._place(after)))
        return change

    def take_back_added(self, object_id: int) -> None:
        """An object has turned out to be one that was known: it had not come."""
        of_it = [i for i, (change, _, _) in enumerate(self._reports) if change.object_id == object_id]
        if of_it and self._reports[of_it[-1]][0].kind == ChangeKind.ADDED:
            del self._reports[of_it[-1]]

    @property
    def changes(self) -> tuple[ObjectChange, ...]:
        """All reports, without those that a later one has superseded."""
        return settled_changes(
            replace(change, T_map_before=self._pose(before), T_map_after=self._pose(after))
            for change, before, after in self._reports
        )

    def _place(self, record: ObjectRecord | None) -> _Place | None:
        if record is None:
            return None
        keyframe_id = record.latest_keyframe_id
        return _Place(keyframe_id, inverse(self._poses[keyframe_id]) @ record.code.T_frame_object)

    def _pose(self, place: _Place | None) -> Array | None:
        return None if place is None else self._poses[place.keyframe_id] @ place.T_keyframe_object
