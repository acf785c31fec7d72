"""The library of objects: views tied to keyframes, and their average in the map frame (NeuSE IV-A)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array, inverse, transform_points
from neuse.mapping.keyframe_memory import most_redundant
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
from neuse.slam.track import shape_noise

_FLIP_SCALE_M = 0.02  # views whose landmarks lie this far from the average count half
_VIEWS_OF_PLACE = 6  # so many views show an object's surface from all sides
_TELLING_NOISE = 0.02  # 1 - cosine to be expected of a view that tells one shape from another
_TRUSTED_SHARE = 0.8  # the farthest points of a view may be of another surface


@dataclass(frozen=True)
class LibraryParams(CheckedParams):
    """What is kept of each object."""

    max_views: int = param(16, "views that are kept of an object, spread evenly", 3, 10000)
    points_per_view: int = param(48, "surface points that are kept of a view", 4, 10000)


@dataclass(frozen=True)
class View:
    """One observation of an object, in the frame of a keyframe. points: (m, 3) surface points, metres."""

    code: Code
    points: Array
    weight: float = 1.0

    @cached_property
    def center(self) -> Array:
        """(3,) centre of the object, keyframe's frame."""
        return self.code.center


@dataclass
class ObjectRecord:
    """One object. Ticks are steps of the mapper; `views` go by keyframe id, `poses` are the keyframes'.

    since_tick: first step at its present place.    last_tick: latest step that saw it there for sure.
    seen_well: some view told its shape.
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
    seen_well: bool = False
    _code: Code | None = None
    _center: Array | None = None
    _points: Array | None = None

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
    def rough_center(self) -> Array:
        """(3,) centre in the map frame by the latest view alone: right to centimetres, and cheap."""
        keyframe_id, view = next(reversed(self.views.items()))
        return transform_points(self.poses[keyframe_id], view.center)

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

    def similarity(self, other: "ObjectRecord") -> float:
        """Cosine of the averaged descriptors; -1 across categories, and for another network's."""
        own, others = self.code.descriptor, other.code.descriptor
        comparable = self.category == other.category and len(own) == len(others)
        return float(own @ others) if comparable else -1.0

    def seen(self, tick: int, stamp_ns: int, tells_shape: bool = True) -> None:
        """The object was matched at its place.

        A view that does not tell its shape may as well be of another object that stands there by now; once
        the object has been seen well, such views do not show that it still does.
        """
        self.last_seen_ns = stamp_ns
        self.n_observations += 1
        if tells_shape or not self.seen_well:
            self.last_tick = tick
        self.seen_well |= tells_shape

    def add_view(self, keyframe_id: int, view: View, max_views: int) -> None:
        """Keep the first view of each keyframe; beyond `max_views` the one of the smallest gap goes."""
        if keyframe_id in self.views:
            return
        self.views[keyframe_id] = view
        if len(self.views) > max_views:
            ids = list(self.views)
            del self.views[ids[most_redundant(ids)]]
        self.invalidate()

    def invalidate(self) -> None:
        """The views or the poses of their keyframes changed."""
        self._code = self._center = self._points = None


def average_codes(codes: Sequence[Code], T_map_keyframes: Array, weights: Array) -> Code:
    """Robust average of codes of one object, n views of it: a flipped view among good ones hardly counts.

    T_map_keyframes: (n, 4, 4) from each code's frame.    weights: (n,) positive.
    The errors of views are correlated, so the average claims to be no better than its best view.
    """
    z = np.array([code.z for code in codes])  # (n, k, 3)
    z = z @ T_map_keyframes[:, :3, :3].swapaxes(1, 2) + T_map_keyframes[:, None, :3, 3]
    sigmas = np.array([code.sigmas for code in codes])  # (n, 6)
    if sigmas[:, :3].min(axis=1).max() >= np.pi:
        z = _named_alike(codes, z, int(np.argmax(weights)))
    half = z.shape[1] // 2
    robust = weights
    for _ in range(3):
        mean = _weighted_mean(robust, z)  # (k, 3)
        squared_m2 = ((z[:, :half] - mean[:half]) ** 2).sum(axis=(1, 2)) / half  # (n,)
        robust = weights / (1.0 + squared_m2 / _FLIP_SCALE_M**2)
    descriptor = robust @ np.array([code.descriptor for code in codes])
    descriptor = descriptor / max(float(np.linalg.norm(descriptor)), 1e-12)
    correlation = float(robust @ [code.height_correlation for code in codes] / robust.sum())
    return replace(
        codes[0],
        z=mean,
        descriptor=descriptor,
        sigmas=sigmas.min(axis=0),
        height_correlation=correlation,
    )


def _named_alike(codes: Sequence[Code], z: Array, best: int) -> Array:
    """(n, k, 3) latent points in one frame, axes without names named as those of the best code."""
    placed = [replace(code, z=points) for code, points in zip(codes, z, strict=True)]
    return np.array([code.named_like(placed[best]).z for code in placed])


def _weighted_mean(weights: Array, z: Array) -> Array:
    """(k, 3) of (n, k, 3)."""
    return (weights @ z.reshape(len(z), -1) / weights.sum()).reshape(z.shape[1:])


def tells_shape(code: Code) -> bool:
    """Whether the view was good enough to tell an object from others of its category."""
    return shape_noise(code) <= _TELLING_NOISE


def make_view(code: Code, cloud: np.ndarray, T_keyframe_camera: Array, is_cut: bool, count: int) -> View:
    """A view from an observation in the camera frame; a cut one (at the image border) weighs a quarter."""
    cloud = cloud if len(cloud) else code.center[None]
    variance = float(np.mean(code.sigmas[3:] ** 2)) + 1e-6
    nearest = np.argsort(np.linalg.norm(cloud - code.center, axis=1))[
        : int(np.ceil(_TRUSTED_SHARE * len(cloud)))
    ]
    kept = np.sort(nearest)[:: max(1, len(nearest) // count)][:count]
    points = transform_points(T_keyframe_camera, cloud[kept].reshape(-1, 3))
    return View(code.transformed(T_keyframe_camera), points, (0.25 if is_cut else 1.0) * 1e-6 / variance)


def recalled(known: MapObject, poses: Mapping[int, Array]) -> ObjectRecord:
    """The record of an object of which only its entry in a map is left; its box stands for its surface."""
    sides = np.concatenate([np.eye(3), -np.eye(3)]) * known.box_size / 2
    points = known.box_center + sides @ known.T_map_object[:3, :3].T
    variance = float(np.mean(known.code.sigmas[3:] ** 2)) + 1e-6
    return ObjectRecord(
        known.object_id, known.category, poses, known.first_seen_ns, known.last_seen_ns, 0, 0,
        known.n_observations, known.status, {NO_ID: View(known.code, points, 1e-6 / variance)},
    )  # fmt: skip


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

        Of an object that has been seen here since its history is taken over.
        """
        record = self.find(known.object_id)
        if record is None:
            self.records[known.object_id] = recalled(known, poses)
            return True
        if record.last_tick <= 0:  # all that is known here is of an earlier run
            self.records[record.object_id] = replace(recalled(known, poses), object_id=record.object_id)
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
        if duplicate.last_tick > kept.last_tick:
            kept.last_tick, kept.last_seen_ns = duplicate.last_tick, duplicate.last_seen_ns

    def move(self, object_id: int, newcomer_id: int) -> None:
        """The newcomer is this object at a new place: it takes over the newcomer's views there."""
        moved, newcomer = self.records[object_id], self.records[newcomer_id]
        self.left.append(replace(moved))
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
