"""Detected changes against true ones: the counts of the paper's change table."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from neuse.geometry import Array, transform_points
from neuse.records import ChangeKind, ObjectChange

PLACE_TOLERANCE_M = 0.15


@dataclass(frozen=True)
class ChangeScore:
    """Index pairs (detected, true) that agree, detections that are false, true changes that were missed."""

    matches: tuple[tuple[int, int], ...]
    false: tuple[int, ...]
    missed: tuple[int, ...]

    @property
    def tp(self) -> int:
        """True positives."""
        return len(self.matches)

    @property
    def fp(self) -> int:
        """False positives."""
        return len(self.false)

    @property
    def fn(self) -> int:
        """False negatives."""
        return len(self.missed)


def score_changes(
    detected: Sequence[ObjectChange],
    true: Sequence[ObjectChange],
    T_world_map: Array,
    tolerance_m: float = PLACE_TOLERANCE_M,
) -> ChangeScore:
    """Match detected changes (map frame) to true ones (world frame), each at most once.

    A detection is right when kind and category agree, it is not earlier than the change, and every place of
    the change (before for removed and moved, after for added and moved) is within `tolerance_m` of the true
    one. Among the possible pairings the one with the most matches, then the least distance, counts.
    """
    cost = np.array([[_distance_m(d, t, T_world_map) for t in true] for d in detected])
    cost = cost.reshape(len(detected), len(true))
    forbidden = ~(cost <= tolerance_m)
    rows, columns = linear_sum_assignment(np.where(forbidden, 1e3, cost))
    matches = tuple((int(i), int(j)) for i, j in zip(rows, columns, strict=True) if not forbidden[i, j])
    found, explained = {i for i, _ in matches}, {j for _, j in matches}
    return ChangeScore(
        matches,
        tuple(i for i in range(len(detected)) if i not in found),
        tuple(j for j in range(len(true)) if j not in explained),
    )


def _distance_m(detected: ObjectChange, true: ObjectChange, T_world_map: Array) -> float:
    """Largest distance of the places; infinite when the changes cannot be the same."""
    if detected.kind != true.kind or detected.category != true.category or detected.stamp_ns < true.stamp_ns:
        return np.inf
    pairs = []
    if true.kind != ChangeKind.ADDED:
        pairs.append((detected.T_map_before, true.T_map_before))
    if true.kind != ChangeKind.REMOVED:
        pairs.append((detected.T_map_after, true.T_map_after))
    return max(_place_distance_m(d, t, T_world_map) for d, t in pairs)


def _place_distance_m(T_map: Array | None, T_world: Array | None, T_world_map: Array) -> float:
    if T_map is None or T_world is None:
        return np.inf
    return float(np.linalg.norm(transform_points(T_world_map, T_map[:3, 3]) - T_world[:3, 3]))
