"""The map at rest: what is kept of the mapper's memory over the end of a run, and how it goes on from it."""

from collections.abc import Sequence

from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.stored_map import StoredKeyframe, StoredMap, StoredObject
from neuse.records import NO_ID, Intrinsics, ObjectChange, ObjectStatus

_NO_CAMERA = Intrinsics(1, 1, 1.0, 1.0, 0.5, 0.5)


def snapshot(
    library: ObjectLibrary, memory: KeyframeMemory, changes: Sequence[ObjectChange], tick: int, stamp_ns: int
) -> StoredMap:
    """The map as it is at a step: all objects, and the keyframes that have views of them or depth."""
    in_use = {keyframe_id for record in library for keyframe_id in record.views}
    kept = [k for k in memory.seen.values() if k.depth_mm is not None or k.keyframe_id in in_use]
    if NO_ID in in_use:  # views in the map itself, of objects told by another map or seen before any keyframe
        kept.insert(0, SeenKeyframe(NO_ID, 0, kept[0].intrinsics if kept else _NO_CAMERA, None))
    index = {keyframe.keyframe_id: i for i, keyframe in enumerate(kept)}
    keyframes = tuple(
        StoredKeyframe(
            k.tick - tick, memory.poses[k.keyframe_id], k.intrinsics, k.depth_mm,
            {library.resolve(i): center for i, center in k.centers.items()},
        )
        for k in kept
    )  # fmt: skip
    objects = tuple(_stored(record, index, tick) for record in library)
    return StoredMap(stamp_ns, objects, keyframes, tuple(changes))


def restore(stored: StoredMap, library: ObjectLibrary, memory: KeyframeMemory) -> None:
    """Fill an empty library and memory. Stored keyframes get ids below NO_ID: no new estimate moves them."""
    first_id = NO_ID - len(stored.keyframes)
    for keyframe_id, keyframe in enumerate(stored.keyframes, first_id):
        memory.poses[keyframe_id] = keyframe.T_map_camera
        memory.add(
            SeenKeyframe(
                keyframe_id, keyframe.tick, keyframe.intrinsics, keyframe.depth_mm, dict(keyframe.centers)
            )
        )
    for known in stored.objects:
        library.records[known.object_id] = ObjectRecord(
            known.object_id, known.category, memory.poses, known.first_seen_ns, known.last_seen_ns,
            known.since_tick, known.last_tick, known.n_observations, ObjectStatus(known.status),
            {first_id + index: view for index, view in known.views.items()},
        )  # fmt: skip


def _stored(record: ObjectRecord, index: dict[int, int], tick: int) -> StoredObject:
    """An object with its views, in the order in which they came."""
    views = {index[keyframe_id]: view for keyframe_id, view in record.views.items()}
    return StoredObject(
        record.object_id, record.category, int(record.status), record.first_seen_ns, record.last_seen_ns,
        record.n_observations, record.since_tick - tick, record.last_tick - tick, views,
    )  # fmt: skip
