"""All tracks of a library as arrays, for what is asked of thousands of them in every frame."""

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from operator import attrgetter

import numpy as np

from neuse.geometry import Array
from neuse.slam.drift import Ways
from neuse.slam.track import Track

HEAD = 32  # components of a descriptor that are compared first; of the rest only the length
ROUNDING = 1e-5  # of a cosine in float32
COLUMNS: dict[str, tuple[type, tuple[int, ...]]] = {  # type and shape of an entry
    "center": (np.float64, (3,)),
    "mapped_at": (np.float64, (2,)),
    "seen_at": (np.float64, (2,)),
    "last_frame": (np.int64, ()),
    "active": (np.bool_, ()),
    "confirmed": (np.bool_, ()),
    "in_graph": (np.bool_, ()),
}
HEADS = "heads"  # the column of descriptors, as `_heads` gives them


class TrackTable:
    """An entry for each track in the order of their keys, written anew where a track is among `changed`.

    Kept by number, each in its own array with the tracks last: whoever looks for a few among thousands reads
    two or three of them end to end.
    """

    def __init__(self) -> None:
        self.changed: set[Track] = set()
        self._tracks: list[Track] = []
        self._columns: dict[str, np.ndarray] = {
            name: np.zeros((*shape, 16), kind) for name, (kind, shape) in COLUMNS.items()
        }
        self._columns[HEADS] = np.zeros((HEAD + 1, 16), np.float32)
        self._ways: Ways | None = None

    def __len__(self) -> int:
        return len(self._tracks)

    def append(self, track: Track) -> None:
        """A new track, whose key is larger than all before."""
        self._tracks.append(track)
        self.changed.add(track)

    def remove(self, track: Track) -> None:
        """Forget a track; those after it move up, and few do, since it is young."""
        row = self._row(track)
        del self._tracks[row]
        self.changed |= {track, *self._tracks[row:]}

    def near(self, point: Array, radius_m: float | Array) -> np.ndarray:
        """(m,) bool, active and within the radius, or radii (m,), of a point (3,) of the map, metres."""
        x, y, z = (self["center"] - point[:, None]) ** 2
        return self["active"] & (x + y + z <= radius_m**2)

    def may_be_alike(self, descriptors: Sequence[Array], delta_shape: float) -> np.ndarray:
        """(m,) bool, whether the cosine with one of the descriptors may be this large, from their heads.

        No larger than the product of the heads and of the lengths of the rest (Cauchy, Schwarz).
        """
        bounds = _heads(descriptors).astype(np.float32) @ self[HEADS]  # (n, m)
        return bounds.max(axis=0, initial=-np.inf) >= delta_shape - ROUNDING

    def drifts(self, tracks: Sequence[Track], now: Array) -> Array:
        """(n, 2) variances (rad^2, m^2) of the camera relative to tracks, by way of any active one."""
        mapped_at = self["mapped_at"].T[self.index(tracks)]
        if self._ways is None:
            self._ways = self._ways_over(self["active"])
        return self._ways.drifts(mapped_at, now)

    def all_drifts(self, now: Array, over: np.ndarray) -> Array:
        """(m, 2) variances (rad^2, m^2) of the camera relative to all, by way of the tracks of a mask."""
        return self._ways_over(over).drifts(self["mapped_at"].T, now)

    def _ways_over(self, over: np.ndarray) -> Ways:
        return Ways(self["mapped_at"].T, self["seen_at"].T, over)

    def at(self, chosen: np.ndarray) -> list[Track]:
        """The tracks of a mask."""
        return [self._tracks[row] for row in np.flatnonzero(chosen)]

    def index(self, tracks: Iterable[Track]) -> np.ndarray:
        """(n,) rows of tracks."""
        return np.array([self._row(track) for track in tracks], dtype=np.intp)

    def __getitem__(self, name: str) -> np.ndarray:
        """(..., m) a column, up to date."""
        if self.changed:
            self._write([track for track in self.changed if self._holds(track)])
            self.changed.clear()
            self._ways = None
        return self._columns[name][..., : len(self)]

    def _row(self, track: Track) -> int:
        return bisect_left(self._tracks, track.key, key=attrgetter("key"))

    def _holds(self, track: Track) -> bool:
        row = self._row(track)
        return row < len(self._tracks) and self._tracks[row] is track

    def _write(self, tracks: Sequence[Track]) -> None:
        while self._columns[HEADS].shape[1] < len(self):
            self._columns = {
                name: np.concatenate([column, np.zeros_like(column)], axis=-1)
                for name, column in self._columns.items()
            }
        if tracks:
            index = self.index(tracks)
            for name, values in zip(COLUMNS, zip(*map(_row_of, tracks), strict=True), strict=True):
                self._columns[name][..., index] = np.array(values).T
            self._columns[HEADS][:, index] = _heads([track.descriptor for track in tracks]).T


def _row_of(track: Track) -> tuple[object, ...]:
    """Its entries in the order of COLUMNS."""
    flags = not track.retired, track.confirmed, track.in_graph
    return track.place[0], track.mapped_at, track.seen_at, track.last_frame, *flags


def _heads(descriptors: Sequence[Array]) -> Array:
    """(n, HEAD + 1) the first components of each, and the length of the rest."""
    heads = np.zeros((len(descriptors), HEAD + 1))
    lengths = np.array([len(descriptor) for descriptor in descriptors])
    for length in set(lengths.tolist()):
        index = np.flatnonzero(lengths == length)
        alike = np.array([descriptors[i] for i in index.tolist()])
        heads[index, : min(length, HEAD)] = alike[:, :HEAD]
        heads[index, HEAD] = np.sqrt((alike[:, HEAD:] ** 2).sum(axis=1))
    return heads
