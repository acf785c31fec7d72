"""An object at one place, as the tracker knows it (NeuSE IV-A)."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.records import NO_ID
from neuse.slam.object_frames import ObjectFrames

MEMORY = 20  # sightings after which the averages of descriptors and places forget
SHAPE_NOISE_M = 0.03  # a centre known no better than this goes with a descriptor that says nothing
SHAPE_NOISE = (0.004, 0.05)  # 1 - cosine to be expected of a perfect view, and of one that says nothing
AVERAGED_SHAPE_NOISE = 0.002  # of many views
CLEAR_SHAPE_NOISE = 0.01  # of a view that may contradict, or show that an object still is the same
SURE_UNLIKENESS = 4.0  # of one in ten views of the same object
SURELY_SAME = 0.1  # 1 - cosine beyond which no view, however poor, shows that an object still is the same
SHAPE_MEMORY = MEMORY / SHAPE_NOISE[0]  # information that an averaged descriptor keeps


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
    last_sure: last frame that showed that it is still the same; clearly, once it has been seen clearly.
    periods: keyframes of every period of sight, the first and then one every so often, as far as they still
        are in the graph.    last_noted: the last of them.
    changed: whatever is set, the track notes itself here, since the library keeps it in a table as well.
    """

    changed: "set[Track]" = field(repr=False)
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
    seen_clearly: bool = False
    last_sure: int = 0
    last_keyframe: int = NO_ID
    last_noted: int = NO_ID
    periods: list[list[int]] = field(default_factory=list)

    def __setattr__(self, name: str, value: Any) -> None:
        object.__setattr__(self, name, value)
        self.changed.add(self)

    @property
    def shape_noise(self) -> float:
        """1 - cosine to be expected of its descriptor (see `shape_noise`)."""
        return max(1.0 / max(self.shape_weight, 1e-12), AVERAGED_SHAPE_NOISE)

    def see(self, code: Code, place: Array, last: LastSighting, drift: Array, frame_index: int) -> None:
        """Take in one more sighting; the place of an anchored object is the graph's business."""
        self.n_sightings += 1
        self._learn_shape(code, frame_index)
        if not self.anchored:
            weights = 1.0 / last.frames.variances[:, 0]
            self.place_weights = _remembered(self.place_weights) + weights
            share = weights / np.maximum(self.place_weights, 1e-12)
            self.place = orthonormal_places((self.place + share[:, None] * (place - self.place))[None])[0]
        self.measure(last.frames)
        self.last, self.seen_at, self.last_frame = last, drift, frame_index

    def _learn_shape(self, code: Code, frame_index: int) -> None:
        """Average the descriptors, and note whether it still is the same.

        What looks otherwise counts for less (Cauchy's weights): many poor views of another object in this
        place must not make a clear one of it look right.
        """
        noise, difference = shape_noise(code), 1.0 - float(self.descriptor @ code.descriptor)
        unlikeness = difference / (noise + self.shape_noise)
        is_clear = noise <= CLEAR_SHAPE_NOISE
        tells = is_clear or (not self.seen_clearly and difference <= SURELY_SAME)
        if tells and unlikeness <= SURE_UNLIKENESS:
            self.last_sure = frame_index
        self.seen_clearly |= is_clear
        weight = 1.0 / (noise * (1.0 + (unlikeness / SURE_UNLIKENESS) ** 2))
        self.shape_weight = min(self.shape_weight, SHAPE_MEMORY) + weight
        mean = self.descriptor + (code.descriptor - self.descriptor) * weight / self.shape_weight
        self.descriptor = mean / np.linalg.norm(mean)

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
            self.periods = [period for period in self.periods if period]
            self.periods.append([keyframe_id])
            self.last_noted = keyframe_id
        elif keyframe_id % spacing == 0:
            self.periods[-1].append(keyframe_id)
            self.last_noted = keyframe_id
        self.last_keyframe = keyframe_id

    def leave_keyframe(self, keyframe_id: int) -> None:
        """A keyframe that saw it has left the graph."""
        for period in self.periods:
            if keyframe_id in period:
                period.remove(keyframe_id)


def shape_noise(code: Code) -> float:
    """1 - cosine to be expected between the descriptor of one view and a perfect one.

    Descriptors have no sigma of their own, but err together with the centre, whose sigma is predicted.
    """
    least, most = SHAPE_NOISE
    return min(least + float(np.max(code.sigmas[3:]) / SHAPE_NOISE_M) ** 2, most)


def places_of(tracks: Sequence[Track]) -> Array:
    """(3, m, 3) places of tracks."""
    return np.array([track.place for track in tracks]).reshape(-1, 3, 3).swapaxes(0, 1)


def heights_of(tracks: Sequence[Track]) -> tuple[Array, Array]:
    """(m,) half heights of tracks, metres, and their variances, m^2."""
    heights = np.array([track.half_height for track in tracks])
    return heights, 1.0 / np.array([track.height_weight for track in tracks])


def sigmas_of(tracks: Sequence[Track], sigmas: Array) -> Array:
    """(n, 6) sigmas (6,) of known places, but of no rotation where a track tells no axis."""
    told = np.array([track.last.frames.tell_axes[0] for track in tracks], dtype=bool)
    return np.where(told[:, None] | (np.arange(6) >= 3), sigmas, np.pi)


def orthonormal_places(places: Array) -> Array:
    """(n, 3, 3) centre, unit axis and unit handle orthogonal to it, of each."""
    centers, axes, handles = places[:, 0], _normalized(places[:, 1]), places[:, 2]
    handles = handles - axes * (axes * handles).sum(axis=1, keepdims=True)
    lost = (handles**2).sum(axis=1) < 1e-18
    if lost.any():
        handles[lost] = np.cross(axes[lost], np.eye(3)[np.abs(axes[lost]).argmin(axis=1)])
    return np.stack([centers, axes, _normalized(handles)], axis=1)


def _normalized(vectors: Array) -> Array:
    return vectors / np.maximum(np.sqrt((vectors**2).sum(axis=1, keepdims=True)), 1e-12)


def _remembered(weights: Any) -> Any:
    return weights * (1.0 - 1.0 / MEMORY)
