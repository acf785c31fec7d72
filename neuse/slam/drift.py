"""How uncertain it has become where tracks are, by the readings of the drift clock."""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array
from neuse.slam.track import Track


class Ways:
    """The ways to places over tracks that were seen lately.

    The drift clock reads how uncertain dead reckoning has become since the start. An object that was mapped
    at one reading is known relative to another mapped at nearly the same; so the way to an object leads over
    whichever object was seen recently and mapped at about the same time.
    """

    def __init__(self, mapped_at: Array, seen_at: Array, over: np.ndarray) -> None:
        """(m, 2) readings (rad^2, m^2) at which tracks were mapped and seen last, and which may be used."""
        rows = np.flatnonzero(over)
        self._order = rows[np.argsort(mapped_at[rows, 1], kind="stable")]
        self._mapped_at, self._seen_at = mapped_at, seen_at
        self._readings, seen = mapped_at[self._order, 1], seen_at[self._order, 1]
        self._best_before = np.maximum.accumulate(seen + self._readings)  # of those with smaller readings
        self._best_after = np.maximum.accumulate((seen - self._readings)[::-1])  # from the largest down

    def drifts(self, mapped_at: Array, now: Array) -> Array:
        """(n, 2) variances (rad^2, m^2) of the camera relative to places mapped at (n, 2) readings."""
        if not len(self._order):
            return np.full(mapped_at.shape, np.inf)
        via = self._order[self._nearest(mapped_at[:, 1])]
        return np.abs(mapped_at - self._mapped_at[via]) + now - self._seen_at[via]

    def _nearest(self, readings: Array) -> np.ndarray:
        """(n,) positions in the order over which the way is shortest."""
        n_before = np.searchsorted(self._readings, readings, side="right")
        n_after = len(self._order) - n_before
        before = np.where(n_before > 0, self._best_before[n_before - 1], -np.inf)
        after = np.where(n_after > 0, self._best_after[n_after - 1], -np.inf)
        position_before = np.searchsorted(self._best_before, before)
        position_after = len(self._order) - 1 - np.searchsorted(self._best_after, after)
        return np.where(before - readings >= after + readings, position_before, position_after)


def drift_from(anchors: Sequence[Track], tracks: Sequence[Track]) -> Array:
    """(m, 2) variances (rad^2, m^2) of each track's place relative to the anchor mapped nearest in time."""
    mapped = np.stack([track.mapped_at for track in anchors])
    between = np.abs(np.stack([track.mapped_at for track in tracks])[:, None] - mapped[None])  # (m, via, 2)
    return between[np.arange(len(tracks)), between[..., 1].argmin(axis=1)]
