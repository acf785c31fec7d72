"""The library of objects by id (NeuSE IV-A)."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from neuse.geometry import Array, inverse, transform_points
from neuse.mapping.object_record import ObjectRecord, recalled
from neuse.params import CheckedParams, param
from neuse.records import (
    NO_ID,
    MapObject,
    MatchStatus,
    ObjectMap,
    ObjectStatus,
    TrackedFrame,
    TrackedObservation,
)


@dataclass(frozen=True)
class LibraryParams(CheckedParams):
    """What is kept of each object."""

    max_views: int = param(16, "views that are kept of an object, spread evenly", 3, 10000)
    points_per_view: int = param(48, "surface points that are kept of a view", 4, 10000)


class ObjectLibrary:
    """Objects by id. Ids that turned out to mean another object are aliases of it."""

    def __init__(self) -> None:
        self.records: dict[int, ObjectRecord] = {}
        self.left: list[ObjectRecord] = []  # objects that have moved, as they were at the places they left
        self.aliases: dict[int, int] = {}

    def __iter__(self) -> Iterator[ObjectRecord]:
        return iter(self.records.values())

    def resolve(self, object_id: int) -> int:
        """The lasting id behind an id of the tracker."""
        while object_id in self.aliases:
            object_id = self.aliases[object_id]
        return object_id

    def find(self, object_id: int) -> ObjectRecord | None:
        """The object that an id of the tracker means, if known."""
        return self.records.get(self.resolve(object_id))

    def recall(self, known: MapObject, poses: Mapping[int, Array]) -> bool:
        """Take over what a map knew of an object; whether it is new here.

        Views of the present session stay, beside those of an earlier one the map's word counts.
        """
        record, told = self.find(known.object_id), recalled(known, poses)
        if record is None:
            self.records[known.object_id] = told
            return True
        views = {keyframe_id: view for keyframe_id, view in record.views.items() if keyframe_id > NO_ID}
        if len(views) < len(record.views):
            self.records[record.object_id] = replace(
                told,
                object_id=record.object_id,
                last_seen_ns=max(known.last_seen_ns, record.last_seen_ns),
                last_tick=max(record.last_tick, 0),
                n_observations=known.n_observations + len(views),
                views=told.views | views,
            )
            return False
        record.first_seen_ns = min(known.first_seen_ns, record.first_seen_ns)
        record.n_observations += known.n_observations
        record.since_tick = 0
        if record.is_present and known.status != ObjectStatus.REMOVED:
            record.status = known.status
        return False

    def is_earlier_than(self, object_map: ObjectMap) -> bool:
        """Whether these are objects of that map, as they were at some time before."""
        first_seen_ns = {known.object_id: known.first_seen_ns for known in object_map.objects}
        return bool(self.records) and all(
            first_seen_ns.get(record.object_id) == record.first_seen_ns for record in self
        )

    def merge(self, duplicate_id: int, into_id: int) -> None:
        """Two ids mean one object: the first becomes an alias of the second and leaves the map."""
        duplicate, kept = self.records.pop(duplicate_id), self.records[into_id]
        self.aliases[duplicate_id] = into_id
        kept.first_seen_ns = min(kept.first_seen_ns, duplicate.first_seen_ns)
        kept.n_observations += duplicate.n_observations
        kept.take_views(duplicate)
        if duplicate.last_tick > kept.last_tick:
            kept.last_tick, kept.last_sure_ns = duplicate.last_tick, duplicate.last_sure_ns
            kept.last_seen_ns = duplicate.last_seen_ns

    def move(self, object_id: int, newcomer_id: int) -> None:
        """The newcomer is this object at a new place: it takes over the newcomer's views there."""
        moved, newcomer = self.records[object_id], self.records[newcomer_id]
        self.left.append(replace(moved))
        self.aliases = {i: kept for i, kept in self.aliases.items() if self.resolve(i) != object_id}
        self.merge(newcomer_id, object_id)
        moved.views, moved.since_tick = newcomer.views, newcomer.since_tick
        moved.status = ObjectStatus.MOVED
        moved.invalidate()

    def invalidate(self, keyframe_ids: set[int]) -> None:
        """These keyframes moved: whatever hangs on them is averaged anew when next asked for."""
        for record in (*self, *self.left):
            if not keyframe_ids.isdisjoint(record.views):
                record.invalidate()


def associated(frame: TrackedFrame, library: ObjectLibrary) -> dict[int, TrackedObservation]:
    """A frame's observations by lasting object id; of several for one object the one nearest to its place."""
    nearest: dict[int, TrackedObservation] = {}
    for tracked in frame.observations:
        if tracked.status not in (MatchStatus.MATCHED, MatchStatus.NEW):
            continue
        object_id = library.resolve(tracked.object_id)
        record, rival = library.records.get(object_id), nearest.get(object_id)
        if rival is None or _misfit_m(tracked, record, frame) < _misfit_m(rival, record, frame):
            nearest[object_id] = tracked
    return nearest


def _misfit_m(tracked: TrackedObservation, record: ObjectRecord | None, frame: TrackedFrame) -> float:
    """Distance of an observation from the place of its object; from the camera if the object has none yet."""
    center = tracked.observation.code.center
    place = np.zeros(3) if record is None else transform_points(inverse(frame.T_map_camera), record.center)
    return float(np.linalg.norm(center - place))
