"""What a keyframe saw at a place, the place being put relative to the anchors that the keyframe saw."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np

from neuse.geometry import Array, inverse, transform_points
from neuse.mapping.free_space import FreeSpaceParams, Sight, look
from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe
from neuse.mapping.object_graph import Anchor, LayoutParams, align_graphs, is_unchanged
from neuse.mapping.object_library import ObjectLibrary
from neuse.mapping.object_record import ObjectRecord


@dataclass(frozen=True)
class AnchoredView:
    """One view of an object among anchors. center: (3,) as observed through the keyframe's pose, map frame.

    T_reference_observed: (4, 4) the drift that the anchors show (see `align_graphs`).
    points: (n, 3) its surface points, map frame, with that drift taken out.
    tied_since: step since when keyframes are tied to it by the anchors.
    """

    keyframe: SeenKeyframe
    center: Array
    anchors: tuple[Anchor, ...]
    T_reference_observed: Array
    points: Array
    tied_since: int


class Tie(NamedTuple):
    """What ties a keyframe to the map: anchors, and the drift that they show (see `align_graphs`)."""

    anchors: tuple[Anchor, ...]
    T_reference_observed: Array


class Evidence:
    """Looks places up in stored keyframes; anchors take out the drift between a keyframe and the map."""

    def __init__(
        self,
        memory: KeyframeMemory,
        library: ObjectLibrary,
        layout: LayoutParams,
        free_space: FreeSpaceParams,
    ) -> None:
        self._memory, self._library = memory, library
        self._layout, self._free_space = layout, free_space

    def tie(
        self,
        keyframe: SeenKeyframe,
        center: Array,
        known_by: Sequence[int],
        excluded_id: int,
        carried: bool = False,
    ) -> Tie | None:
        """Objects that the keyframe saw and that served as landmarks of a place (3,), map frame, if any.

        They stood where the keyframe saw them and were known at the first of the steps `known_by`, or else at
        a later one. The age matters: objects met together after a drift confirm each other, but tie none of
        them to what was seen before. Where those near the place do not suffice, as on a table where nothing
        has stayed, those of the next one help.

        carried: where that is out of sight, too, those serve that the camera saw a moment before.
        """
        seen = self._landmarks(keyframe, excluded_id)
        tie = self._tie_to(seen.values(), center, known_by)
        if tie is not None or not carried:
            return tie
        for earlier in self._memory.shortly_before(keyframe, self._layout.carried_frames):
            seen = self._landmarks(earlier, excluded_id) | seen
        return self._tie_to(seen.values(), center, known_by)

    def _tie_to(self, landmarks: Iterable[Anchor], center: Array, known_by: Sequence[int]) -> Tie | None:
        seen = list(landmarks)
        distances_m = [np.linalg.norm(anchor.observed - center) for anchor in seen]
        radii_m = self._layout.anchor_radius_m, self._layout.far_anchor_radius_m
        for latest, radius_m in product(known_by, radii_m):
            anchors = [
                anchor
                for anchor, distance_m in zip(seen, distances_m, strict=True)
                if anchor.since_tick <= latest and distance_m <= radius_m
            ]
            T_reference_observed = align_graphs(anchors, self._layout)
            if T_reference_observed is not None:
                return Tie(tuple(anchors), T_reference_observed)
        return None

    def _landmarks(self, keyframe: SeenKeyframe, excluded_id: int) -> dict[int, Anchor]:
        """All other objects, by their ids, that the keyframe saw where the map has, or had, them."""
        T_map_camera, landmarks = self._memory.poses[keyframe.keyframe_id], dict[int, Anchor]()
        for seen_id, center_camera in keyframe.centers.items():
            record = self._standing(self._library.resolve(seen_id), keyframe.tick)
            if record is not None and record.object_id != excluded_id:
                observed = T_map_camera[:3, :3] @ center_camera + T_map_camera[:3, 3]
                anchor = Anchor(record.object_id, observed, record.center, record.since_tick)
                landmarks[record.object_id] = anchor
        return landmarks

    def _standing(self, object_id: int, tick: int) -> ObjectRecord | None:
        """The object as it stood at that step: where it is, or, of one that went since, where it was."""
        present = self._library.records.get(object_id)
        if present is not None and present.is_present and present.since_tick <= tick:
            return present
        former = [record for record in (present, *self._library.left) if record is not None]
        then = (r for r in former if r.object_id == object_id and r.since_tick <= tick <= r.last_tick)
        return next(then, None)

    def around(self, record: ObjectRecord) -> Iterator[ObjectRecord]:
        """Other objects that are, or were, near enough to serve as an object's anchors."""
        for known in (*self._library, *self._library.left):
            near = np.linalg.norm(known.rough_center - record.center) <= self._layout.anchor_radius_m
            if near and known is not record:
                yield known

    def anchored_views(self, record: ObjectRecord, count: int) -> list[AnchoredView]:
        """Those of the latest `count` views of an object that saw it among anchors, best older ones."""
        views = []
        for keyframe_id in list(record.views)[-count:]:
            keyframe = self._memory.seen.get(keyframe_id)
            if keyframe is None:
                continue
            center = transform_points(self._memory.poses[keyframe_id], record.views[keyframe_id].center)
            before = record.since_tick - 1
            known_by = before - self._layout.met_together_frames, before
            tie = self.tie(keyframe, center, known_by, record.object_id, carried=True)
            if tie is not None:
                points = transform_points(tie.T_reference_observed, record.points_of([keyframe_id]))
                oldest = min(anchor.since_tick for anchor in tie.anchors)
                tied_since = self._memory.in_sight_since(oldest, self._layout.met_together_frames)
                views.append(AnchoredView(keyframe, center, *tie, points, tied_since))
        return views

    def agrees(self, view: AnchoredView, known: ObjectRecord) -> bool | None:
        """Whether an object graph has the viewed object in the place of a known one (NeuSE eq. 10)."""
        others = [anchor for anchor in view.anchors if anchor.object_id != known.object_id]
        return is_unchanged(view.center, known.center, others, self._layout)

    def is_in_place(self, center_camera: Array, known: ObjectRecord, keyframe: SeenKeyframe) -> bool:
        """Whether what a keyframe saw at (3,), camera frame, is in the place of a known object."""
        center = transform_points(self._memory.poses[keyframe.keyframe_id], center_camera)
        tie = self.tie(keyframe, center, self._met_by(known.last_tick), known.object_id)
        return tie is not None and bool(is_unchanged(center, known.center, tie.anchors, self._layout))

    def sight(
        self,
        points: Array,
        keyframe: SeenKeyframe,
        known_by: int,
        excluded_id: int,
        carried: bool = False,
    ) -> Sight | None:
        """What the keyframe saw at the points (n, 3), map frame; None if it is no evidence.

        carried: see `tie`.
        """
        if keyframe.depth_mm is None:
            return None
        T_map_camera, center = self._memory.poses[keyframe.keyframe_id], points.mean(axis=0)
        depth_m = (center - T_map_camera[:3, 3]) @ T_map_camera[:3, 2]
        if depth_m > self._free_space.max_range_m + self._layout.anchor_radius_m:
            return None  # whatever the anchors say
        tie = self.tie(keyframe, center, self._met_by(known_by), excluded_id, carried)
        if tie is None:
            return None
        T_map_camera = tie.T_reference_observed @ T_map_camera
        in_camera = transform_points(inverse(T_map_camera), points)
        return look(in_camera, keyframe.coarse_depth_m, keyframe.intrinsics, self._free_space)

    def sights(self, points: Array, keyframes: Sequence[SeenKeyframe], record: ObjectRecord) -> list[Sight]:
        """What keyframes saw at points (n, 3) of an object, map frame, as far as it is evidence."""
        sights = [self.sight(points, k, min(k.tick, record.last_tick), record.object_id) for k in keyframes]
        return [sight for sight in sights if sight is not None]

    def _met_by(self, tick: int) -> tuple[int, int]:
        """That step, and the last one at which an object may be met and still count as met by then."""
        return tick, self._memory.in_sight_until(tick, self._layout.met_together_frames)

    def keyframes_at(self, center: Array, ticks: range, count: int) -> list[SeenKeyframe]:
        """The `count` nearest keyframes of those steps with a place (3,), map frame, in view, by age."""
        nearest = self._memory.nearest_views(center, ticks, self._free_space.max_range_m, count)
        return sorted(nearest, key=lambda keyframe: keyframe.tick)
