"""What is known of one object: its views and when it was seen (NeuSE IV-A)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array, transform_points
from neuse.mapping.keyframe_memory import most_redundant
from neuse.mapping.likeness import likeness
from neuse.mapping.views import View, average_codes, tells_shape, weight_of
from neuse.records import NO_ID, MapObject, ObjectStatus
from neuse.slam.track import SURELY_SAME

_NEVER_NS = -(2**62)
_VIEWS_OF_PLACE = 6  # so many views show an object's surface from all sides


@dataclass
class ObjectRecord:
    """One object. Ticks are steps of the mapper; `views` go by keyframe id, `poses` are the keyframes'.

    since_tick: first step at its present place.    last_tick: latest step that saw it there for sure.
    seen_well: some view told its shape.    last_sure_ns: stamp of the step `last_tick`.
    """

    object_id: int
    category: str
    poses: Mapping[int, Array]
    first_seen_ns: int
    last_seen_ns: int
    since_tick: int
    last_tick: int
    n_observations: int = 0
    status: ObjectStatus = ObjectStatus.UNCHANGED
    views: dict[int, View] = field(default_factory=dict)
    last_sure_ns: int = _NEVER_NS
    seen_well: bool = field(init=False)
    _code: Code | None = None
    _center: Array | None = None
    _points: Array | None = None

    def __post_init__(self) -> None:
        self.seen_well = any(tells_shape(view.code) for view in self.views.values())

    @property
    def is_present(self) -> bool:
        """Still somewhere in the scene, as far as known."""
        return self.status != ObjectStatus.REMOVED

    @property
    def code(self) -> Code:
        """Latent code in the map frame, averaged over the views."""
        if self._code is None:
            T_map_keyframes = np.stack([self.poses[keyframe_id] for keyframe_id in self.views])
            weights = np.array([view.weight for view in self.views.values()])
            self._code = average_codes([view.code for view in self.views.values()], T_map_keyframes, weights)
        return self._code

    @property
    def center(self) -> Array:
        """(3,) centre in the map frame."""
        if self._center is None:
            self._center = self.code.center
        return self._center

    @property
    def latest_keyframe_id(self) -> int:
        """The keyframe of the latest view that is kept."""
        return next(reversed(self.views))

    @property
    def rough_center(self) -> Array:
        """(3,) centre in the map frame by the latest view alone: right to centimetres, and cheap."""
        keyframe_id = self.latest_keyframe_id
        return transform_points(self.poses[keyframe_id], self.views[keyframe_id].center)

    @property
    def points(self) -> Array:
        """(m, 3) observed surface points of a few views, map frame."""
        if self._points is None:
            self._points = self.points_of(list(self.views))
        return self._points

    def points_of(self, keyframe_ids: Sequence[int]) -> Array:
        """(m, 3) surface points of a few of these views, evenly spread, map frame."""
        step = -(-len(keyframe_ids) // _VIEWS_OF_PLACE)
        return np.concatenate(
            [transform_points(self.poses[i], self.views[i].points) for i in keyframe_ids[::step]]
        )

    @property
    def reach_m(self) -> float:
        """Distance of the farthest observed point from the centre: a radius that needs no decoding."""
        return float(np.linalg.norm(self.points - self.center, axis=1).max())

    def likeness(self, other: "ObjectRecord") -> float:
        """Evidence that both have one shape (see `likeness.likeness`)."""
        return likeness(self.code, other.code)

    def seen(self, tick: int, stamp_ns: int, code: Code) -> None:
        """The object was matched at its place.

        A view that does not tell its shape may as well be of another object that stands there by now. Once
        the object has been seen well, such views do not show that it still does; before, those that look
        like it do.
        """
        self.last_seen_ns = stamp_ns
        self.n_observations += 1
        tells = tells_shape(code)
        if tells or not self.views or (not self.seen_well and self._looks_like(code)):
            self.last_tick, self.last_sure_ns = tick, stamp_ns
        self.seen_well |= tells

    def _looks_like(self, code: Code) -> bool:
        return bool(1.0 - self.code.descriptor @ code.descriptor <= SURELY_SAME)

    def add_view(self, keyframe_id: int, view: View, max_views: int) -> None:
        """Keep the first view of each keyframe; beyond `max_views` the one of the smallest gap goes."""
        if keyframe_id in self.views:
            return
        self.views[keyframe_id] = view
        if len(self.views) > max_views:
            ids = list(self.views)
            del self.views[ids[most_redundant(ids)]]
        self.invalidate()

    def take_views(self, duplicate: "ObjectRecord") -> None:
        """Keep the views of a record of the same object beside the own ones, no more than the larger had."""
        most = max(len(self.views), len(duplicate.views), 3)
        self.seen_well |= duplicate.seen_well
        views = duplicate.views | self.views
        self.views = {}
        for keyframe_id in sorted(views):
            self.add_view(keyframe_id, views[keyframe_id], most)
        self.invalidate()

    def invalidate(self) -> None:
        """The views or the poses of their keyframes changed."""
        self._code = self._center = self._points = None


def recalled(known: MapObject, poses: Mapping[int, Array]) -> ObjectRecord:
    """The record of an object of which only its entry in a map is left; its box stands for its surface."""
    sides = np.concatenate([np.eye(3), -np.eye(3)]) * known.box_size / 2
    points = known.box_center + sides @ known.T_map_object[:3, :3].T
    return ObjectRecord(
        known.object_id, known.category, poses, known.first_seen_ns, known.last_seen_ns, 0, 0,
        known.n_observations, known.status, {NO_ID: View(known.code, points, weight_of(known.code))},
    )  # fmt: skip
