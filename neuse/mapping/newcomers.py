"""What is an object that the tracker has just instantiated: one known already, a discovery, or a change?"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.spatial.distance import cdist

from neuse.mapping.evidence import AnchoredView, Evidence
from neuse.mapping.free_space import Sight, free_share
from neuse.mapping.keyframe_memory import SeenKeyframe
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord
from neuse.mapping.reconstruction import Box, MeshCache
from neuse.mapping.upkeep import UpkeepParams, is_displaced, is_residual
from neuse.params import CheckedParams, param
from neuse.records import TrackedObservation


@dataclass(frozen=True)
class NewcomerParams(CheckedParams):
    """When a newcomer is judged."""

    min_views: int = param(
        3, "keyframes with anchors that must have seen a newcomer before it is judged", 1, 1000
    )
    discovery_views: int = param(
        6, "keyframes after which a newcomer without evidence of change is a discovery", 1, 1000
    )
    min_empty_keyframes: int = param(
        3, "keyframes that must have seen a place empty before an object came or after it went", 1, 1000
    )
    max_evidence_keyframes: int = param(24, "earlier keyframes that are looked up for a newcomer", 1, 10000)
    min_shift_share: float = param(
        0.15, "share of an object's points that must be seen free where it was shifted, or displaced", 0.01, 1
    )
    same_place_m: float = param(0.03, "objects of like shape this near to each other are one, m", 0.0, 1.0)
    same_surface: float = param(
        2.0, "evidence (log likelihood ratio) of one object where no point of its place is seen free", 0, 100
    )
    exchange_s: float = param(
        1.0, "nothing takes the place of an object within this time of a sure sight of it, s", 0, 1e6
    )


_SWEEP_M = 0.1  # rough centres further apart are of two objects
_NEIGHBOUR_M = 1.0  # objects further apart do not touch
_ALIKE = 3.0  # likeness of one object, not of one of twenty
_STAYS = 3.0  # evidence of no change: most objects stay where they are
_UNKNOWN = 3.0  # evidence against an exchange for something never seen that fills the very same place


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
    """Judges newcomers by object graphs, by boxes, and by what earlier keyframes saw at their places."""

    def __init__(
        self, library: ObjectLibrary, evidence: Evidence, meshes: MeshCache,
        params: NewcomerParams, upkeep: UpkeepParams,
    ) -> None:  # fmt: skip
        self._library, self._evidence, self._meshes = library, evidence, meshes
        self._params, self._upkeep = params, upkeep

    def judge(self, newcomer: ObjectRecord) -> Verdict:
        """Verdict on a newcomer from all that is known now; OPEN while that is not enough."""
        if not any(known.since_tick < newcomer.since_tick for known in self._library):
            return Verdict(Origin.DISCOVERY)
        views = self._evidence.anchored_views(newcomer, self._params.discovery_views)
        if len(views) < self._params.min_views:
            return Verdict(Origin.OPEN, is_doubtful=self._is_doubtful(newcomer))
        displaced = []
        for known in self._neighbours(newcomer, [k for k in self._library if k.is_present]):
            if self._is_duplicate(newcomer, known, views):
                return Verdict(Origin.DUPLICATE, duplicate_of=known.object_id)
            if self._has_displaced(newcomer, known, views):
                displaced.append(known.object_id)
        gone = self._neighbours(newcomer, self._library.left)
        follows = displaced or any(self._has_displaced(newcomer, known, views) for known in gone)
        if follows or self._was_free(newcomer, views):
            return Verdict(Origin.CHANGE, displaced=tuple(displaced))
        enough = len(newcomer.views) >= self._params.discovery_views
        origin = Origin.DISCOVERY if enough else Origin.OPEN
        return Verdict(origin, is_doubtful=self._is_doubtful(newcomer))

    def displaced_by(self, newcomer: ObjectRecord) -> list[int]:
        """Objects, not seen since, in whose place one stands that has turned out to be yet another."""
        views = self._evidence.anchored_views(newcomer, self._params.discovery_views)
        older = self._neighbours(newcomer, [k for k in self._library if k.is_present])
        unseen = [known for known in older if known.last_tick < newcomer.since_tick]
        return [known.object_id for known in unseen if self._fills_place(newcomer, known, views)]

    def _fills_place(
        self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]
    ) -> bool:
        """As the anchors have it, if there are any, or the map."""
        in_place = bool(views) and self._is_in_place(known, views)
        return in_place or is_displaced(self._box(known), self._box(newcomer), self._upkeep)

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
        distance_m = np.linalg.norm(later.center - older.center)
        return bool(distance_m <= self._params.same_place_m) and later.likeness(older) >= 0.0

    def _neighbours(self, newcomer: ObjectRecord, among: Iterable[ObjectRecord]) -> list[ObjectRecord]:
        """Older objects whose box may touch the newcomer's, nearest first."""
        near = []
        for known in among:
            distance_m = float(np.linalg.norm(known.rough_center - newcomer.center))
            older = known.since_tick < newcomer.since_tick
            if older and distance_m <= _NEIGHBOUR_M and distance_m <= known.reach_m + newcomer.reach_m:
                near.append((distance_m, known.object_id, known))
        return [known for *_, known in sorted(near, key=lambda entry: entry[:2])]

    def _is_duplicate(
        self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]
    ) -> bool:
        """In one place relative to the anchors (IV-D) and alike, or one inside the other and both still seen.

        While both are seen, nothing has changed: two objects in one place are one, whatever it looked like.
        """
        in_place = self._is_in_place(known, views)
        if known.last_tick >= newcomer.since_tick:
            return in_place or self._is_partial(newcomer, known)
        if in_place:
            return not self._is_other(newcomer, known, views)
        return self._collide(newcomer, known, views) and not self._is_exchange(newcomer, known, views)

    def _is_in_place(self, known: ObjectRecord, views: Sequence[AnchoredView]) -> bool:
        """Whether most of a newcomer's views have it in the place of a known object."""
        votes = [self._evidence.agrees(view, known) for view in views]
        return 2 * votes.count(True) > len(votes) - votes.count(None)

    def _is_partial(self, newcomer: ObjectRecord, known: ObjectRecord) -> bool:
        """One of the two is a partial instance of the other (appendix).

        The middle of a part lies within the reach of the whole: few boxes have to be decoded.
        """
        if np.linalg.norm(newcomer.center - known.center) > max(newcomer.reach_m, known.reach_m):
            return False
        box, known_box = self._box(newcomer), self._box(known)
        return is_residual(box, known_box, self._upkeep) or is_residual(known_box, box, self._upkeep)

    def _has_displaced(
        self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]
    ) -> bool:
        """The newcomer stands in the place of an older object that has not been seen since.

        Boxes alone cannot tell a new object from an old one that is badly seen: depth or the shapes must.
        """
        if known.last_tick >= newcomer.since_tick:
            return False
        return self._collide(newcomer, known, views) and self._is_exchange(newcomer, known, views)

    def _collide(self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]) -> bool:
        """Whether both cannot stand where they are (appendix), by anchors known when the older was seen."""
        if _tied_since(views) > known.last_tick:
            return False
        box = self._box(newcomer).moved(views[-1].T_reference_observed)
        return is_displaced(self._box(known), box, self._upkeep)

    def _is_exchange(
        self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]
    ) -> bool:
        """Whether depth or the shapes tell the newcomer from an object that it collides with."""
        shifted = self._shift_share(newcomer, known, views) >= self._params.min_shift_share
        return (shifted and not self._at_once(newcomer, known)) or self._is_other(newcomer, known, views)

    def _is_other(self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]) -> bool:
        """Whether shapes, depth and time together tell the newcomer from an object in the same place."""
        at_once = self._at_once(newcomer, known)
        well_known = len(known.views) >= self._params.discovery_views
        from_elsewhere = self._likeness_to_others(newcomer, known) - _ALIKE
        evidence = newcomer.likeness(known)
        if well_known and not at_once:
            evidence -= max(from_elsewhere - _STAYS, 0.0)
        if evidence >= 0.0 or evidence == -np.inf:
            return evidence < 0.0
        shift = self._shift_share(newcomer, known, views) / self._params.min_shift_share
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

    def _shift_share(
        self, newcomer: ObjectRecord, known: ObjectRecord, views: Sequence[AnchoredView]
    ) -> float:
        """Share of the newcomer's place seen free before it came, or of the older object's since then."""
        before = self._sights_at(newcomer, views, range(known.since_tick, known.last_tick + 1))
        after = self._evidence.sights(known.points, [view.keyframe for view in views], known)
        return max(free_share(before), free_share(after))

    def _was_free(self, newcomer: ObjectRecord, views: Sequence[AnchoredView]) -> bool:
        """Earlier keyframes saw through the place, until something came that has been there since."""
        before = self._sights_at(newcomer, views, range(_tied_since(views), newcomer.since_tick))
        while before and not before[-1].is_empty:
            before.pop()
        empty, taken = sum(sight.is_empty for sight in before), sum(sight.is_taken for sight in before)
        return empty >= self._params.min_empty_keyframes and empty > taken

    def _is_doubtful(self, newcomer: ObjectRecord) -> bool:
        """Some object known around the place has not been seen since: this is where things have changed."""
        well_seen = len(newcomer.views) >= self._params.min_views
        return well_seen and any(k.last_tick < newcomer.since_tick for k in self._evidence.around(newcomer))

    def _sights_at(self, newcomer: ObjectRecord, views: Sequence[AnchoredView], ticks: range) -> list[Sight]:
        """What keyframes of these steps, but after the anchors were met, saw at the place; oldest first."""
        points = np.concatenate([view.points for view in views])
        ticks = range(max(ticks.start, _tied_since(views)), ticks.stop)
        keyframes = self._evidence.keyframes_at(
            points.mean(axis=0), ticks, self._params.max_evidence_keyframes
        )
        return self._evidence.sights(points, keyframes, newcomer)

    def _box(self, record: ObjectRecord) -> Box:
        return self._meshes.box(record.object_id, record.code, record.points)


def _tied_since(views: Sequence[AnchoredView]) -> int:
    """Keyframes before that step tell nothing about the place."""
    return min(view.tied_since for view in views)
