"""Two objects that claim one place: one object, or one that has taken the place of the other?"""

import numpy as np

from neuse.mapping.evidence import Evidence
from neuse.mapping.free_space import Sight, free_share
from neuse.mapping.newcomer import Newcomer, NewcomerParams
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.reconstruction import Box, MeshCache
from neuse.mapping.upkeep import UpkeepParams, is_displaced, is_residual
from neuse.records import ObjectStatus

_ALIKE = 3.0  # likeness of one object, not of one of twenty
_STAYS = 3.0  # evidence of no change: most objects stay where they are
_LATELY_FRAMES = 300  # and what has come within so many hardly goes again
_FROM_ELSEWHERE = 3.0  # most that it counts that a newcomer looks like an object of another place
_UNKNOWN = 3.0  # evidence against an exchange for something never seen that fills the very same place


class ContestedPlace:
    """Compares a newcomer with an object known there, by object graphs, boxes, depth, shapes and time."""

    def __init__(
        self, library: ObjectLibrary, evidence: Evidence, meshes: MeshCache,
        params: NewcomerParams, upkeep: UpkeepParams,
    ) -> None:  # fmt: skip
        self._library, self._evidence, self._meshes = library, evidence, meshes
        self._params, self._upkeep = params, upkeep

    def is_duplicate(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """In one place relative to the anchors (IV-D), or both cannot be; and alike, or both still seen.

        While both are seen, nothing has changed: two objects in one place are one, whatever it looked like.
        """
        in_place = self._is_in_place(newcomer, known)
        if _is_seen_still(known, newcomer):
            of_one_kind = newcomer.record.category == known.category
            exclusive = of_one_kind and self._are_exclusive(newcomer, known)
            return in_place or exclusive or self._is_partial(newcomer.record, known)
        if in_place:
            return not self._is_other(newcomer, known)
        return self._collide(newcomer, known) and not self._is_exchange(newcomer, known)

    def has_displaced(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """The newcomer stands in the place of an older object that has not been seen since.

        Boxes alone cannot tell a new object from an old one that is badly seen: depth or the shapes must.
        """
        if _is_seen_still(known, newcomer):
            return False
        return self._collide(newcomer, known) and self._is_exchange(newcomer, known)

    def is_filled(self, known: ObjectRecord, newcomer: Newcomer) -> bool:
        """An older object, not seen since, cannot be where a newcomer, surely another one, stands.

        As the anchors have it, if there are any, or the map.
        """
        if _is_seen_still(known, newcomer):
            return False
        in_place = bool(newcomer.views) and self._is_in_place(newcomer, known)
        return in_place or is_displaced(self._box(known), self._box(newcomer.record), self._upkeep)

    def sights_before(self, newcomer: Newcomer, ticks: range) -> list[Sight]:
        """What keyframes of these steps, but after the anchors were met, saw at its place; oldest first."""
        points = newcomer.points
        ticks = range(max(ticks.start, newcomer.tied_since), ticks.stop)
        keyframes = self._evidence.keyframes_at(
            points.mean(axis=0), ticks, self._params.max_evidence_keyframes
        )
        return self._evidence.sights(points, keyframes, newcomer.record)

    def _is_in_place(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """Whether most of a newcomer's views have it in the place of a known object."""
        votes = [self._evidence.agrees(view, known) for view in newcomer.views]
        return 2 * votes.count(True) > len(votes) - votes.count(None)

    def _is_partial(self, newcomer: ObjectRecord, known: ObjectRecord) -> bool:
        """One of the two is a partial instance of the other (appendix).

        The middle of a part lies within the reach of the whole: few boxes have to be decoded.
        """
        if np.linalg.norm(newcomer.center - known.center) > max(newcomer.reach_m, known.reach_m):
            return False
        box, known_box = self._box(newcomer), self._box(known)
        return is_residual(box, known_box, self._upkeep) or is_residual(known_box, box, self._upkeep)

    def _collide(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """Whether both cannot stand where they are, by anchors known when the older was seen."""
        return newcomer.tied_since <= known.last_tick and self._are_exclusive(newcomer, known)

    def _are_exclusive(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """Whether both cannot stand where they are (appendix), by the latest anchors."""
        box = self._box(newcomer.record).moved(newcomer.views[-1].T_reference_observed)
        return is_displaced(self._box(known), box, self._upkeep)

    def _is_exchange(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """Whether depth or the shapes tell the newcomer from an object that it collides with."""
        shifted = self._shift_share(newcomer, known) >= self._params.min_shift_share
        at_once = self._at_once(newcomer.record, known)
        return (shifted and not at_once) or self._is_other(newcomer, known)

    def _is_other(self, newcomer: Newcomer, known: ObjectRecord) -> bool:
        """Whether shapes, depth and time together tell the newcomer from an object in the same place."""
        at_once = self._at_once(newcomer.record, known)
        well_known = len(known.views) >= self._params.discovery_views
        from_elsewhere = self._likeness_to_others(newcomer.record, known) - _ALIKE
        evidence = newcomer.record.likeness(known)
        if _has_come_lately(known, newcomer.record):
            evidence += _STAYS
        if well_known and not at_once:
            evidence -= np.clip(from_elsewhere - _STAYS, 0.0, _FROM_ELSEWHERE)
        if evidence >= 0.0 or evidence == -np.inf:
            return evidence < 0.0
        shift = self._shift_share(newcomer, known) / self._params.min_shift_share
        same_surface = self._params.same_surface + (0.0 if from_elsewhere >= 0.0 else _UNKNOWN)
        evidence += same_surface * max(1.0 - shift, 0.0)
        return evidence + (self._params.same_surface if at_once else 0.0) < 0.0

    def _at_once(self, newcomer: ObjectRecord, known: ObjectRecord) -> bool:
        """So soon after a sure sight of the known object that it can hardly have been taken away."""
        return newcomer.first_seen_ns - known.last_sure_ns <= self._params.exchange_s * 1e9

    def _likeness_to_others(self, newcomer: ObjectRecord, displaced: ObjectRecord) -> float:
        """To the known object that it looks like most, among those not seen since it came."""
        others = (k for k in self._library if k is not displaced and k.last_tick < newcomer.since_tick)
        return max((newcomer.likeness(known) for known in others), default=-np.inf)

    def _shift_share(self, newcomer: Newcomer, known: ObjectRecord) -> float:
        """Share of the newcomer's place seen free before it came, or of the older object's since then."""
        before = self.sights_before(newcomer, range(known.since_tick, known.last_tick + 1))
        after = self._evidence.sights(known.points, [view.keyframe for view in newcomer.views], known)
        return max(free_share(before), free_share(after))

    def _box(self, record: ObjectRecord) -> Box:
        return self._meshes.box(record.object_id, record.code, record.points)


def _has_come_lately(known: ObjectRecord, newcomer: ObjectRecord) -> bool:
    lately = newcomer.since_tick - known.since_tick <= _LATELY_FRAMES
    return lately and known.status in (ObjectStatus.ADDED, ObjectStatus.MOVED)


def _is_seen_still(known: ObjectRecord, newcomer: Newcomer) -> bool:
    return known.last_tick >= newcomer.record.since_tick
