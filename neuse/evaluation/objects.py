"""Mapped objects against true ones: is every object that was seen in the map exactly once?"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from neuse.evaluation.truth import TrueObject
from neuse.geometry import Array, transform_points
from neuse.records import MapObject, ObjectStatus

CENTER_TOLERANCE_M = 0.06
MIN_FRAMES_SEEN = 5


@dataclass(frozen=True)
class ObjectScore:
    """How the map's present objects compare with the world.

    true: how many the camera has clearly seen where they stand at the end.    mapped: how many the map has.
    missed: ids of true objects.    duplicates: ids of map objects that map a true object once more.
    ghosts: ids of map objects where nothing of their category stands.    center_error_m: median.
    """

    true: int
    mapped: int
    missed: tuple[int, ...]
    duplicates: tuple[int, ...]
    ghosts: tuple[int, ...]
    center_error_m: float | None


def score_objects(
    mapped: Sequence[MapObject],
    true: Sequence[TrueObject],
    T_world_map: Array,
    tolerance_m: float = CENTER_TOLERANCE_M,
) -> ObjectScore:
    """Compare the final map (map frame; removed objects do not count) with the final world.

    A map object and a true one agree when their categories do and their centres are within `tolerance_m`;
    each counts once. Objects seen in less than MIN_FRAMES_SEEN frames need not be mapped, but may be.
    """
    present = [item for item in mapped if item.status != ObjectStatus.REMOVED]
    distance_m = _distances_m(present, true, T_world_map)
    near = distance_m <= tolerance_m
    rows, columns = linear_sum_assignment(np.where(near, distance_m, 1e3))
    pairs = [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if near[i, j]]
    paired, found = {i for i, _ in pairs}, {j for _, j in pairs}
    expected = [j for j, item in enumerate(true) if item.n_seen >= MIN_FRAMES_SEEN]
    extra = [i for i in range(len(present)) if i not in paired]
    return ObjectScore(
        true=len(expected),
        mapped=sum(j in found for j in expected),
        missed=tuple(true[j].object_id for j in expected if j not in found),
        duplicates=tuple(present[i].object_id for i in extra if near[i].any()),
        ghosts=tuple(present[i].object_id for i in extra if not near[i].any()),
        center_error_m=float(np.median([distance_m[pair] for pair in pairs])) if pairs else None,
    )


def _distances_m(mapped: Sequence[MapObject], true: Sequence[TrueObject], T_world_map: Array) -> Array:
    """(n mapped, n true) distances of centres, infinite between categories."""
    distance_m = np.full((len(mapped), len(true)), np.inf)
    for i, item in enumerate(mapped):
        center = transform_points(T_world_map, item.T_map_object[:3, 3])
        for j, other in enumerate(true):
            if item.category == other.category:
                distance_m[i, j] = np.linalg.norm(center - other.center)
    return distance_m
