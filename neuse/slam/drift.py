"""How uncertain it has become where tracks are, by the readings of the drift clock."""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array
from neuse.slam.track import Track


def drift_between(tracks: Sequence[Track], now: Array) -> Array:
    """(m, 2) variances (rad^2, m^2) of the camera relative to each track's place.

    The drift clock reads how uncertain dead reckoning has become since the start. An object that was mapped
    at one reading is known relative to another mapped at nearly the same; so the way to an object leads over
    whichever object was seen recently and mapped at about the same time.
    """
    if not tracks:
        return np.zeros((0, 2))
    mapped = np.stack([track.mapped_at for track in tracks])
    seen = np.stack([track.seen_at for track in tracks])
    everything = np.arange(len(tracks))
    return over_ways(mapped, seen, now, everything, nearest_ways(mapped[:, 1], -seen[:, 1]))


def over_ways(mapped_at: Array, seen_at: Array, now: Array, index: np.ndarray, ways: np.ndarray) -> Array:
    """(n, 2) drifts of some tracks by way of others, from (m, 2) readings of all."""
    return np.abs(mapped_at[index] - mapped_at[ways]) + now - seen_at[ways]


def drift_from(anchors: Sequence[Track], tracks: Sequence[Track]) -> Array:
    """(m, 2) variances (rad^2, m^2) of each track's place relative to the anchor mapped nearest in time."""
    mapped = np.stack([track.mapped_at for track in anchors])
    between = np.abs(np.stack([track.mapped_at for track in tracks])[:, None] - mapped[None])  # (m, via, 2)
    return between[np.arange(len(tracks)), between[..., 1].argmin(axis=1)]


def nearest_ways(readings: Array, costs: Array) -> np.ndarray:
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
