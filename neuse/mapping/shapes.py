"""The map as others see it: every object with its box and its full shape, which may lag behind its code."""

import trimesh

from neuse.errors import InputError
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.reconstruction import MeshCache
from neuse.records import MapObject, ObjectMap

_YOUNG = 8  # the code of an object that has been seen less often still changes a lot


class Shapes:
    """Gives the objects of a library their shapes; decodes those that lag behind when it is told to."""

    def __init__(self, library: ObjectLibrary, meshes: MeshCache) -> None:
        self._library, self._meshes = library, meshes

    def object_map(self, stamp_ns: int, now: bool = True) -> ObjectMap:
        """The map; with `now=False` in no time: nothing is decoded for it."""
        records = sorted(self._library, key=lambda record: record.object_id)
        return ObjectMap(stamp_ns, tuple(self._map_object(record, now) for record in records))

    def mesh(self, object_id: int, now: bool = True) -> trimesh.Trimesh:
        """Full shape of an object, map frame; with `now=False` as it was decoded last.

        Raises:
            InputError: no such object.    MeshError: its category has no decoder, or it lacks a shape yet.
        """
        record = self._library.find(object_id)
        if record is None:
            raise InputError("unknown_object", f"the map has no object {object_id}")
        return self._meshes.mesh(record.object_id, record.code, now)

    def decode_next(self) -> bool:
        """Decode the one shape that lags most behind its code; False where none does noticeably."""
        lags = [
            (record.is_present, self._meshes.lag_m(record.object_id, record.code), record.object_id)
            for record in self._library
            if record.n_observations >= _YOUNG
        ]
        lags = [entry for entry in lags if entry[1] > 0.0]
        if not lags:
            return False
        _, _, object_id = max(lags)
        self._meshes.decode(object_id, self._library.records[object_id].code)
        return True

    def _map_object(self, record: ObjectRecord, now: bool) -> MapObject:
        code = record.code
        box = self._meshes.box(record.object_id, code, record.points, now)
        return MapObject(
            record.object_id, record.category, record.status, code.T_frame_object, box.center, box.size, code,
            record.first_seen_ns, record.last_seen_ns, record.n_observations,
        )  # fmt: skip
