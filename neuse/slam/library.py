"""The objects that the tracker knows, tentative and confirmed (NeuSE IV-A: the object library)."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import count
from typing import Protocol

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.records import NO_ID
from neuse.slam.track import CLEAR_SHAPE_NOISE, MEMORY, LastSighting, Track, shape_noise
from neuse.slam.track_table import TrackTable

LONG_AGO = -1_000_000  # a frame before all others
RECENT_FRAMES, RECENT_FACTOR = 30, 4.0  # within 3 s nobody trades objects; a mask may be cut
TOO_UNLIKE = 0.08  # 1 - cosine from which on a view may rather be of an object that it looks like far more,
FAR_MORE_ALIKE, PERFECTLY_ALIKE = 4.0, 0.005  # so many times, and no less than this counts


class Shaped(Protocol):
    """Anything with a shape: a code or a track."""

    @property
    def category(self) -> str:
        """Its category."""

    @property
    def descriptor(self) -> Array:
        """(k,) unit length."""


class ObjectLibrary:
    """All tracks. Keys and object ids count up from 0 and are never reused."""

    def __init__(self) -> None:
        self.tracks: dict[int, Track] = {}
        self.table = TrackTable()
        self._next_key = 0
        self._ids = count()
        self._turn = 0

    def count_ids(self, first: int, step: int) -> None:
        """From now on new public names are `first`, `first + step`, ..."""
        self._ids = count(first, step)

    def add(self, code: Code, place: Array, last: LastSighting, drift: Array, frame_index: int) -> Track:
        """A tentative object."""
        descriptor = code.descriptor / np.linalg.norm(code.descriptor)
        track = Track(
            self.table.changed,
            self._next_key,
            code.category,
            code.ambiguous,
            descriptor,
            place,
            drift,
            drift,
            last,
            frame_index,
        )
        track.shape_weight = 1.0 / shape_noise(code)
        track.seen_clearly, track.last_sure = shape_noise(code) <= CLEAR_SHAPE_NOISE, frame_index
        track.place_weights = 1.0 / last.frames.variances[:, 0]
        track.measure(last.frames)
        self.tracks[track.key] = track
        self.table.append(track)
        self._next_key += 1
        return track

    def name(self, track: Track) -> None:
        """Give a track a public name, unless it has one."""
        if track.object_id == NO_ID:
            track.object_id = next(self._ids)

    def rename(self, names: Mapping[int, int], next_id: int) -> dict[int, int]:
        """Give tracks, by their keys, other public names, and new ones to others called less than `next_id`.

        Returns:
            {name before: name now}.
        """
        renamed: dict[int, int] = {self.tracks[key].object_id: name for key, name in names.items()}
        renamed.pop(NO_ID, None)
        for track in self.tracks.values():
            before = track.object_id
            if NO_ID != before < next_id and before not in renamed:
                renamed[before] = next(self._ids)
            track.object_id = names.get(track.key, renamed.get(before, before))
        return renamed

    def adopt(self, object_id: int, code: Code, place: Array, last: LastSighting, drift: Array) -> Track:
        """An object of a map made by others, known as well as one that was seen often and long ago."""
        track = self.add(code, place, last, drift, LONG_AGO)
        track.object_id, track.confirmed, track.in_graph, track.anchored = object_id, True, True, True
        track.n_sightings = MEMORY
        track.shape_weight *= MEMORY
        track.place_weights, track.height_weight = track.place_weights * MEMORY, track.height_weight * MEMORY
        return track

    def confirm(self, track: Track) -> None:
        """Make a tentative object one of the map."""
        self.name(track)
        track.confirmed = True

    def drop(self, tracks: Iterable[Track]) -> None:
        """Forget tentative objects."""
        for track in tracks:
            del self.tracks[track.key]
            self.table.remove(track)

    def active(self) -> list[Track]:
        """Tracks that observations may match."""
        return [track for track in self.tracks.values() if not track.retired]

    def tentative(self) -> list[Track]:
        """Active tracks that are no objects of the map yet."""
        return self.table.at(self.table["active"] & ~self.table["confirmed"])

    def around(self, points: Array, radius_m: float) -> np.ndarray:
        """(m,) mask of the table: active tracks around points (n, 3) of the map."""
        center = points.mean(axis=0)
        reach_m = radius_m + float(np.linalg.norm(points - center, axis=1).max())
        return self.table.near(center, reach_m)

    def most_alike(
        self, codes: Sequence[Code], alike: Sequence[Track], delta_shape: float, most: int
    ) -> np.ndarray:
        """(m,) mask of the table: active ones of those that may be alike, not more than `most` a code."""
        tracks = [track for track in alike if not track.retired]
        similarities = similarity(codes, tracks)
        chosen = np.zeros(len(self.table), dtype=bool)
        for shapes in similarities:
            best = np.argsort(-shapes, kind="stable")[:most]
            chosen[self.table.index(tracks[m] for m in best if shapes[m] >= delta_shape)] = True
        return chosen

    def by_turns(self, always: Iterable[int], most: int) -> list[Track]:
        """Active tracks of the graph: those of some keys, as far as known, and so many of all by turns."""
        allowed = self.table["active"] & self.table["in_graph"]
        turns = np.flatnonzero(allowed)
        chosen = np.zeros(len(self.table), dtype=bool)
        chosen[turns[(self._turn + np.arange(min(most, len(turns)))) % max(len(turns), 1)]] = True
        chosen[self.table.index(self.tracks[key] for key in always if key in self.tracks)] = True
        self._turn += most
        return self.table.at(chosen & allowed)

    def alike(self, some: Sequence[Code | Track], delta_shape: float) -> list[Track]:
        """Objects of the map that may be alike in shape to one of these, wherever they stand or stood."""
        may_be = self.table.may_be_alike([shaped.descriptor for shaped in some], delta_shape)
        return self.table.at(may_be & self.table["confirmed"])

    def rivals(
        self, some: Sequence[Code | Track], alike: Sequence[Track], delta_shape: float, frame_index: int
    ) -> tuple[Track | None, ...]:
        """That which each is most alike to of those that may be, but for those seen for sure a moment ago."""
        unsettled = [track for track in alike if frame_index - track.last_sure > RECENT_FRAMES]
        if not unsettled:
            return (None,) * len(some)
        S = similarity(some, unsettled)
        best = S.argmax(axis=1).tolist()
        return tuple(unsettled[m] if S[i, m] >= delta_shape else None for i, m in enumerate(best))

    def named(self, object_id: int) -> list[Track]:
        """Tracks of one object: the active one and the places where it once was."""
        return [track for track in self.tracks.values() if track.object_id == object_id]


def ids_by_likeness(
    codes: Sequence[Code], alike: Sequence[Track], delta_shape: float
) -> list[tuple[int, ...]]:
    """For each code the objects of like shape among those that may be alike, the most similar first."""
    S = similarity(codes, alike)
    order = np.argsort(-S, axis=1, kind="stable")
    return [
        tuple(dict.fromkeys(alike[m].object_id for m in row if S[i, m] >= delta_shape))
        for i, row in enumerate(order)
    ]


def similarity(some: Sequence[Shaped], others: Sequence[Shaped]) -> Array:
    """(n, m) shape similarity: cosine of the descriptors, -1 across categories (NeuSE IV-B).

    Descriptors of another length are of another network, whatever its category is called.
    """
    S = np.full((len(some), len(others)), -1.0)
    places, other_places = _by_kind(some), _by_kind(others)
    for kind in places.keys() & other_places.keys():
        rows, columns = places[kind], other_places[kind]
        own, theirs = [some[i] for i in rows], [others[m] for m in columns]
        S[np.array(rows)[:, None], columns] = _descriptors(own) @ _descriptors(theirs).T
    return S


def _by_kind(shaped: Sequence[Shaped]) -> dict[tuple[str, int], list[int]]:
    """{category and length of the descriptors: which of these have it}."""
    places: dict[tuple[str, int], list[int]] = {}
    for i, one in enumerate(shaped):
        places.setdefault((one.category, len(one.descriptor)), []).append(i)
    return places


def _descriptors(alike: Sequence[Shaped]) -> Array:
    """(n, k) of one kind."""
    return np.concatenate([shaped.descriptor for shaped in alike]).reshape(len(alike), -1)


def unlikeness(some: Sequence[Code | Track], others: Sequence[Track]) -> Array:
    """(n, m) 1 - cosine of descriptors in units of what their noise explains; infinite across categories."""
    S = similarity(some, others)
    noise = np.array([s.shape_noise if isinstance(s, Track) else shape_noise(s) for s in some])
    known = np.array([track.shape_noise for track in others])
    return np.where(S > -1.0, (1.0 - S) / (noise[:, None] + known[None]), np.inf)


def alike_in_place(
    some: Sequence[Code | Track],
    rivals: Sequence[Track | None],
    others: Sequence[Track],
    max_unlikeness: float,
    frame_index: int,
) -> np.ndarray:
    """(n, m) bool, whether these may be the others by their shapes, standing where those stand.

    What was seen for sure there a moment before this frame is hardly another object now, only half hidden: it
    may look more unlike. Otherwise what looks far more like its rival is taken for that.
    """
    recent = np.array([frame_index - track.last_sure <= RECENT_FRAMES for track in others], dtype=bool)
    alike = unlikeness(some, others) <= np.where(recent, RECENT_FACTOR, 1.0) * max_unlikeness
    return alike & (recent | ~rather_rivals(some, rivals, others))


def rather_rivals(
    some: Sequence[Code | Track], rivals: Sequence[Track | None], others: Sequence[Track]
) -> np.ndarray:
    """(n, m) bool, whether these look far more like their rivals than like the others.

    Of 68 566 good views of one object in 36 simulated worlds two in a thousand do, spread over many visits.
    """
    result = np.zeros((len(some), len(others)), dtype=bool)
    if not any(rivals):
        return result
    differences, ids = 1.0 - similarity(some, others), np.array([track.object_id for track in others])
    for i, rival in enumerate(rivals):
        if rival is not None:
            difference = max(1.0 - float(some[i].descriptor @ rival.descriptor), PERFECTLY_ALIKE)
            too_unlike = differences[i] > max(TOO_UNLIKE, FAR_MORE_ALIKE * difference)
            result[i] = too_unlike & (ids != rival.object_id)
    return result
