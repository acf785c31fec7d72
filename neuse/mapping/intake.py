"""What a frame adds to the objects that it saw (NeuSE IV-A), and which of them it surely saw."""

from neuse.mapping.judge import Judge
from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe
from neuse.mapping.object_library import LibraryParams, ObjectLibrary, associated
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.views import make_view
from neuse.records import NO_ID, MatchStatus, TrackedFrame, TrackedObservation


class Intake:
    """Enters tracked frames into the library of objects."""

    def __init__(
        self, library: ObjectLibrary, memory: KeyframeMemory, judge: Judge, params: LibraryParams
    ) -> None:
        self._library, self._memory, self._judge, self._params = library, memory, judge, params

    def add(self, frame: TrackedFrame, tick: int) -> set[int]:
        """Add the frame's views to the objects it saw; the ids that were unknown before."""
        keyframe_id, T_keyframe_camera = self._memory.reference(frame)
        created = set()
        for object_id, tracked in sorted(associated(frame, self._library).items()):
            seen = tracked.observation
            record = self._library.records.get(object_id)
            if record is None:
                record = self._create(object_id, seen.code.category, frame.stamp_ns, tick)
                created.add(object_id)
            if frame.keyframe_id != NO_ID:
                self._memory.seen[frame.keyframe_id].centers[object_id] = seen.code.center
            if not record.is_present or record.category != seen.code.category:
                continue
            record.seen(tick, frame.stamp_ns, seen.code)
            if keyframe_id not in record.views:
                count = self._params.points_per_view
                view = make_view(seen.code, seen.cloud, T_keyframe_camera, seen.touches_border, count)
                record.add_view(keyframe_id, view, self._params.max_views)
        return created

    def seen_for_sure(self, frame: TrackedFrame, keyframe: SeenKeyframe) -> set[int]:
        """Objects surely seen at their places, and those matched though they are taken to be gone."""
        matched = [self._library.records[object_id] for object_id in keyframe.centers]
        recognised = [self._recognise(tracked, frame, keyframe) for tracked in frame.observations]
        seen = [*matched, *(record for record in recognised if record is not None)]
        return {r.object_id for r in seen if not r.is_present or r.last_tick == keyframe.tick}

    def _create(self, object_id: int, category: str, stamp_ns: int, tick: int) -> ObjectRecord:
        record = ObjectRecord(object_id, category, self._memory.poses, stamp_ns, stamp_ns, tick, tick)
        self._library.records[object_id] = record
        return record

    def _recognise(
        self, tracked: TrackedObservation, frame: TrackedFrame, keyframe: SeenKeyframe
    ) -> ObjectRecord | None:
        """The object, if any, that only the object graph finds in place: a mug with hidden handle."""
        if tracked.status != MatchStatus.UNMATCHED:
            return None
        object_id = self._judge.recognise(tracked, keyframe)
        if object_id is None:
            return None
        record = self._library.records[object_id]
        record.seen(keyframe.tick, frame.stamp_ns, tracked.observation.code)
        return record
