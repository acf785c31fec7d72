"""The objects that the tracker knows, tentative and confirmed (NeuSE IV-A: the object library)."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.records import NO_ID
from neuse.slam.object_frames import ObjectFrames

MEMORY = 20  # sightings after which the averages of descriptors and places forget
SHAPE_NOISE_M = 0.03  # a centre known no better than this goes with a descriptor that says nothing
SHAPE_NOISE = (0.004, 0.05)  # 1 - cosine to be expected of a perfect view, and of one that says nothing
AVERAGED_SHAPE_NOISE = 0.002  # of many views
RECENT_FRAMES, RECENT_FACTOR = 30, 4.0  # within 3 s nobody trades objects; a mask may be cut


class Shaped(Protocol):
    """Anything with a shape: a code or a track."""

    @property
    def category(self) -> str:
        """Its category."""

    @property
    def descriptor(self) -> Array:
        """(k,) unit length."""


@dataclass(frozen=True)
class LastSighting:
    """What the paper's rule compares with: the object in the last frame that saw it."""

    frames: ObjectFrames
    partial_center: Array
    T_map_camera: Array


@dataclass(eq=False)
class Track:
    """One object at one place.

    key: names it inside the tracker, never used again.    object_id: its public name, NO_ID at first.
    confirmed: it is an object of the map; tentative until then.    in_graph: it constrains keyframes.
    place: (3, 3) centre (metres), unit axis and unit handle in the map frame.    place_weights: (3,) and
        shape_weight: information in these and in the descriptor.    half_height: metres, and height_weight.
    mapped_at, seen_at: (2,) reading of the drift clock (rad^2, m^2) when it was met first and last.
    anchored: the graph says where it stands.
    periods: keyframes of every period of sight, the first and then one every so often.
    """

    key: int
    category: str
    ambiguous: bool
    descriptor: Array
    place: Array
    mapped_at: Array
    seen_at: Array
    last: LastSighting
    last_frame: int
    object_id: int = NO_ID
    retired: bool = False
    n_sightings: int = 1
    n_eligible: int = 0
    confirmed: bool = False
    in_graph: bool = False
    shape_weight: float = 0.0
    place_weights: Array = field(default_factory=lambda: np.zeros(3))
    half_height: float = 0.0
    height_weight: float = 0.0
    anchored: bool = False
    last_keyframe: int = NO_ID
    periods: list[list[int]] = field(default_factory=list)

    @property
    def shape_noise(self) -> float:
        """1 - cosine to be expected of its descriptor (see `shape_noise`)."""
        return max(1.0 / max(self.shape_weight, 1e-12), AVERAGED_SHAPE_NOISE)

    def see(self, code: Code, place: Array, last: LastSighting, drift: Array, frame_index: int) -> None:
        """Take in one more sighting; the place of an anchored object is the graph's business."""
        self.n_sightings += 1
        self.shape_weight = _remembered(self.shape_weight) + 1.0 / shape_noise(code)
        mean = self.descriptor + (code.descriptor - self.descriptor) / (shape_noise(code) * self.shape_weight)
        self.descriptor = mean / np.linalg.norm(mean)
        if not self.anchored:
            weights = 1.0 / last.frames.variances[:, 0]
            self.place_weights = _remembered(self.place_weights) + weights
            share = weights / np.maximum(self.place_weights, 1e-12)
            self.place = orthonormal_place(self.place + share[:, None] * (place - self.place))
        self.measure(last.frames)
        self.last, self.seen_at, self.last_frame = last, drift, frame_index

    def measure(self, frames: ObjectFrames) -> None:
        """Take in the height that one sighting shows, (1,) frames."""
        weight = float(frames.sigmas[0, 5]) ** -2
        self.height_weight = _remembered(self.height_weight) + weight
        self.half_height += (float(frames.half_heights[0]) - self.half_height) * weight / self.height_weight

    def enter_keyframe(self, keyframe_id: int, gap: int, spacing: int) -> None:
        """Note that a keyframe sees it; more than `gap` keyframes without it end a period of sight.

        After the first of a period, every `spacing`th of all keyframes counts: objects share such keyframes.
        """
        if self.last_keyframe == NO_ID or keyframe_id - self.last_keyframe > gap:
            self.periods.append([keyframe_id])
        elif keyframe_id % spacing == 0:
            self.periods[-1].append(keyframe_id)
        self.last_keyframe = keyframe_id


class ObjectLibrary:
    """All tracks. Keys and object ids count up from 0 and are never reused."""

    def __init__(self) -> None:
        self.tracks: dict[int, Track] = {}
        self._next_key = 0
        self._next_id = 0

    def add(self, code: Code, place: Array, last: LastSighting, drift: Array, frame_index: int) -> Track:
        """A tentative object."""
        descriptor = code.descriptor / np.linalg.norm(code.descriptor)
        track = Track(
            self._next_key, code.category, code.ambiguous, descriptor, place, drift, drift, last, frame_index
        )
        track.shape_weight = 1.0 / shape_noise(code)
        track.place_weights = 1.0 / last.frames.variances[:, 0]
        track.measure(last.frames)
        self.tracks[track.key] = track
        self._next_key += 1
        return track

    def name(self, track: Track) -> None:
        """Give a track a public name, unless it has one."""
        if track.object_id == NO_ID:
            track.object_id = self._next_id
            self._next_id += 1

    def confirm(self, track: Track) -> None:
        """Make a tentative object one of the map."""
        self.name(track)
        track.confirmed = True

    def drop(self, tracks: Iterable[Track]) -> None:
        """Forget tentative objects."""
        for track in tracks:
            del self.tracks[track.key]

    def active(self) -> list[Track]:
        """Tracks that observations may match."""
        return [track for track in self.tracks.values() if not track.retired]

    def named(self, object_id: int) -> list[Track]:
        """Tracks of one object: the active one and the places where it once was."""
        return [track for track in self.tracks.values() if track.object_id == object_id]


def similarity(some: Sequence[Shaped], others: Sequence[Shaped]) -> Array:
    """(n, m) shape similarity: cosine of the descriptors, -1 across categories (NeuSE IV-B)."""
    S = np.full((len(some), len(others)), -1.0)
    for category in {shaped.category for shaped in some}:
        rows = [i for i, shaped in enumerate(some) if shaped.category == category]
        columns = [m for m, shaped in enumerate(others) if shaped.category == category]
        if columns:
            descriptors = np.stack([some[i].descriptor for i in rows])
            S[np.ix_(rows, columns)] = descriptors @ np.stack([others[m].descriptor for m in columns]).T
    return S


def shape_noise(code: Code) -> float:
    """1 - cosine to be expected between the descriptor of one view and a perfect one.

    Descriptors have no sigma of their own, but err together with the centre, whose sigma is predicted.
    """
    least, most = SHAPE_NOISE
    return min(least + float(np.max(code.sigmas[3:]) / SHAPE_NOISE_M) ** 2, most)


def unlikeness(some: Sequence[Code | Track], others: Sequence[Track]) -> Array:
    """(n, m) 1 - cosine of descriptors in units of what their noise explains; infinite across categories."""
    S = similarity(some, others)
    noise = np.array([s.shape_noise if isinstance(s, Track) else shape_noise(s) for s in some])
    known = np.array([track.shape_noise for track in others])
    return np.where(S > -1.0, (1.0 - S) / (noise[:, None] + known[None]), np.inf)


def alike_in_place(
    some: Sequence[Code | Track], others: Sequence[Track], max_unlikeness: float
) -> np.ndarray:
    """(n, m) bool, whether these may be the others by their shapes, standing where those stand.

    What was seen there a moment ago is hardly another object now, only half hidden: it may look more unlike.
    """
    latest = max((track.last_frame for track in others), default=0)
    recent = np.array([latest - track.last_frame <= RECENT_FRAMES for track in others], dtype=bool)
    return unlikeness(some, others) <= np.where(recent, RECENT_FACTOR, 1.0) * max_unlikeness


def places_of(tracks: Sequence[Track]) -> Array:
    """(3, m, 3) places of tracks."""
    return np.array([track.place for track in tracks]).reshape(-1, 3, 3).swapaxes(0, 1)


def heights_of(tracks: Sequence[Track]) -> tuple[Array, Array]:
    """(m,) half heights of tracks, metres, and their variances, m^2."""
    heights = np.array([track.half_height for track in tracks])
    return heights, 1.0 / np.array([track.height_weight for track in tracks])


def drift_between(tracks: Sequence[Track], now: Array) -> Array:
    """(m, 2) variances (rad^2, m^2) of the camera relative to each track's place.

    The drift clock reads how uncertain dead reckoning has become since the start. An object that was mapped
    at one reading is known relative to another mapped at nearly the same; so the way to an object leads over
    whichever object was seen recently and mapped at about the same time.
    """
    if not tracks:
        return np.zeros((0, 2))
    mapped = np.stack([track.mapped_at for track in tracks])
    since_seen = now - np.stack([track.seen_at for track in tracks])
    via = _nearest_way(mapped[:, 1], since_seen[:, 1])
    return np.abs(mapped - mapped[via]) + since_seen[via]


def _remembered(weights: Any) -> Any:
    return weights * (1.0 - 1.0 / MEMORY)


def _nearest_way(readings: Array, costs: Array) -> np.ndarray:
    """(m,) index v of the least |readings[m] - readings[v]| + costs[v], in m log m steps."""
    order = np.argsort(readings, kind="stable")
    at, cost = readings[order], costs[order]
    before = _running_argmin(cost - at)  # of those with smaller readings
    after = len(at) - 1 - _running_argmin((cost + at)[::-1])[::-1]
    is_before = at - at[before] + cost[before] <= at[after] - at + cost[after]
    best = np.empty(len(at), dtype=np.intp)
    best[order] = order[np.where(is_before, before, after)]
    return best


def _running_argmin(values: Array) -> np.ndarray:
    """(m,) index of the smallest of the values so far."""
    is_least = values == np.minimum.accumulate(values)
    return np.maximum.accumulate(np.where(is_least, np.arange(len(values)), 0))


def drift_from(anchors: Sequence[Track], tracks: Sequence[Track]) -> Array:
    """(m, 2) variances (rad^2, m^2) of each track's place relative to the anchor mapped nearest in time."""
    mapped = np.stack([track.mapped_at for track in anchors])
    between = np.abs(np.stack([track.mapped_at for track in tracks])[:, None] - mapped[None])  # (m, via, 2)
    return between[np.arange(len(tracks)), between[..., 1].argmin(axis=1)]


def orthonormal_place(place: Array) -> Array:
    """(3, 3) centre, unit axis and unit handle orthogonal to it."""
    center, axis, handle = place
    axis = axis / max(np.linalg.norm(axis), 1e-12)
    handle = handle - axis * (axis @ handle)
    if np.linalg.norm(handle) < 1e-9:
        handle = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    return np.stack([center, axis, handle / np.linalg.norm(handle)])
