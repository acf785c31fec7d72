"""What is an object that the tracker has just instantiated: one known already, a discovery, or a change?"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.distance import cdist

from neuse.mapping.contested_place import ContestedPlace
from neuse.mapping.evidence import Evidence
from neuse.mapping.keyframe_memory import SeenKeyframe
from neuse.mapping.newcomer import Newcomer, NewcomerParams
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.reconstruction import MeshCache
from neuse.mapping.upkeep import UpkeepParams
from neuse.records import TrackedObservation

_SWEEP_M = 0.1  # rough centres further apart are of two objects
_NEIGHBOUR_M = 1.0  # objects further apart do not touch


class Origin(Enum):
    """Where a newcomer comes from."""

    OPEN = "open"
    DISCOVERY = "discovery"
    DUPLICATE = "duplicate"
    CHANGE = "change"


@dataclass(frozen=True)
class Verdict:
    """duplicate_of: the object that a duplicate is.    displaced: objects whose place a change has taken.

    is_doubtful: nothing tells that it has come, but objects known around it have not been seen since.
    """

    origin: Origin
    duplicate_of: int | None = None
    displaced: tuple[int, ...] = ()
    is_doubtful: bool = False


class Judge:
    """Judges newcomers by the objects known at their places and by what earlier keyframes saw there."""

    def __init__(
        self, library: ObjectLibrary, evidence: Evidence, meshes: MeshCache,
        params: NewcomerParams, upkeep: UpkeepParams,
    ) -> None:  # fmt: skip
        self._library, self._evidence, self._params = library, evidence, params
        self._place = ContestedPlace(library, evidence, meshes, params, upkeep)

    def judge(self, record: ObjectRecord) -> Verdict:
        """Verdict on a newcomer from all that is known now; OPEN while that is not enough."""
        if not any(known.since_tick < record.since_tick for known in self._library):
            return Verdict(Origin.DISCOVERY)
        newcomer = self._among_anchors(record)
        if len(newcomer.views) < self._params.min_views:
            return Verdict(Origin.OPEN, is_doubtful=self._is_doubtful(record))
        displaced = []
        for known in self._neighbours(record, [k for k in self._library if k.is_present]):
            if self._place.is_duplicate(newcomer, known):
                return Verdict(Origin.DUPLICATE, duplicate_of=known.object_id)
            if self._place.has_displaced(newcomer, known):
                displaced.append(known.object_id)
        gone = self._neighbours(record, self._library.left)
        follows = displaced or any(self._place.has_displaced(newcomer, known) for known in gone)
        if follows or self._was_free(newcomer):
            return Verdict(Origin.CHANGE, displaced=tuple(displaced))
        enough = len(record.views) >= self._params.discovery_views
        origin = Origin.DISCOVERY if enough else Origin.OPEN
        return Verdict(origin, is_doubtful=self._is_doubtful(record))

    def displaced_by(self, record: ObjectRecord) -> list[int]:
        """Objects, not seen since, in whose place one stands that has turned out to be yet another."""
        newcomer = self._among_anchors(record)
        older = self._neighbours(record, [k for k in self._library if k.is_present])
        return [known.object_id for known in older if self._place.is_filled(known, newcomer)]

    def recognise(self, unmatched: TrackedObservation, keyframe: SeenKeyframe) -> int | None:
        """The known object of like shape, if any, in whose place an unmatched observation is (IV-D)."""
        for similar_id in unmatched.similar_ids:
            known = self._library.find(similar_id)
            if known is None or not known.is_present or known.object_id in keyframe.centers:
                continue
            if self._evidence.is_in_place(unmatched.observation.code.center, known, keyframe):
                return known.object_id
        return None

    def duplicates(self) -> list[tuple[int, int]]:
        """(duplicate, older object) of every two objects of like shape in one place."""
        present = sorted(
            (r for r in self._library if r.is_present), key=lambda r: (r.since_tick, r.object_id)
        )
        centers = np.array([record.rough_center for record in present]).reshape(-1, 3)
        pairs, paired = list[tuple[int, int]](), set[int]()
        for i, j in np.argwhere(np.triu(cdist(centers, centers) <= _SWEEP_M, k=1)).tolist():
            older, later = present[i], present[j]
            if paired.isdisjoint({older.object_id, later.object_id}) and self._is_same(later, older):
                paired |= {older.object_id, later.object_id}
                pairs.append((later.object_id, older.object_id))
        return pairs

    def _is_same(self, later: ObjectRecord, older: ObjectRecord) -> bool:
        """In one place, and alike or both still seen: then nothing has changed, whatever they look like."""
        distance_m = np.linalg.norm(later.center - older.center)
        if distance_m > self._params.same_place_m or later.category != older.category:
            return False
        return older.last_tick >= later.since_tick or later.likeness(older) >= 0.0

    def _among_anchors(self, record: ObjectRecord) -> Newcomer:
        return Newcomer(record, tuple(self._evidence.anchored_views(record, self._params.discovery_views)))

    def _neighbours(self, newcomer: ObjectRecord, among: Iterable[ObjectRecord]) -> list[ObjectRecord]:
        """Older objects whose box may touch the newcomer's, nearest first."""
        near = []
        for known in among:
            distance_m = float(np.linalg.norm(known.rough_center - newcomer.center))
            older = known.since_tick < newcomer.since_tick
            if older and distance_m <= _NEIGHBOUR_M and distance_m <= known.reach_m + newcomer.reach_m:
                near.append((distance_m, known.object_id, known))
        return [known for *_, known in sorted(near, key=lambda entry: entry[:2])]

    def _was_free(self, newcomer: Newcomer) -> bool:
        """Earlier keyframes saw through the place, until something came that has been there since."""
        before = self._place.sights_before(newcomer, range(newcomer.tied_since, newcomer.record.since_tick))
        while before and not before[-1].emptiness:
            before.pop()
        empty, taken = sum(sight.emptiness for sight in before), sum(sight.is_taken for sight in before)
        return empty >= self._params.min_empty_keyframes and empty > taken

    def _is_doubtful(self, record: ObjectRecord) -> bool:
        """Some object known around the place has not been seen since: this is where things have changed."""
        well_seen = len(record.views) >= self._params.min_views
        return well_seen and any(k.last_tick < record.since_tick for k in self._evidence.around(record))
