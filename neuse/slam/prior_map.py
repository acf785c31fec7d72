"""A map that a session did not make, from an earlier run or of another robot: known objects at known places.

Codes are all that is needed of it. Its frame is `map`; a session that is to join it begins in a frame of its
own, `session`.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.distance import cdist

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.records import ObjectMap, ObjectStatus
from neuse.slam.object_frames import ObjectFrames, SigmaParams, is_usable, reduce_codes

SAME_PLACE_M = 0.3  # an object further from where the map has it is not where the map has it
VERY_NEAR_M = 0.05
WITNESSES = 3  # objects, as many as it takes to find a place
MAX_HELD_FRAMES = 3000  # of a session that is not in the map yet


@dataclass(frozen=True)
class PriorMap:
    """Objects that are there as far as the map knows. codes: by object id, frame `map`, averages of many
    views.

    next_id: larger than all ids that the map has ever shown, those of objects long gone among them.
    """

    codes: Mapping[int, Code]
    next_id: int

    @classmethod
    def of(cls, object_map: ObjectMap) -> "PriorMap":
        """What a map tells a session that comes to it."""
        return cls.told((known.object_id, known.status, known.code) for known in object_map.objects)

    @classmethod
    def told(cls, objects: Iterable[tuple[int, ObjectStatus, Code]]) -> "PriorMap":
        """Of all objects that a map has ever shown those that are there; codes that are none are left out."""
        present, next_id = dict[int, Code](), 0
        for object_id, status, code in objects:
            next_id = max(next_id, object_id + 1)
            if status != ObjectStatus.REMOVED and is_usable(code):
                present[object_id] = code
        return cls(present, next_id)

    def __len__(self) -> int:
        return len(self.codes)

    @cached_property
    def ids(self) -> tuple[int, ...]:
        """Object ids, in the order of `frames` and `centers`."""
        return tuple(self.codes)

    @cached_property
    def frames(self) -> ObjectFrames:
        """Poses of the objects, frame `map`."""
        return reduce_codes(list(self.codes.values()), SigmaParams(scale=1.0))

    @property
    def centers(self) -> Array:
        """(m, 3) centres, metres, frame `map`."""
        return self.frames.centers

    @property
    def places(self) -> dict[int, Array]:
        """{object id: (3,) centre, metres, frame `map`}."""
        return dict(zip(self.ids, self.centers, strict=True))

    def neighbours(self, radius_m: float) -> float:
        """How many others there are within a radius of an object, on average."""
        if len(self) < 2:
            return 0.0
        between_m = np.linalg.norm(self.centers[:, None] - self.centers[None], axis=-1)
        return float((between_m <= radius_m).sum(axis=1).mean() - 1.0)


def in_their_places(centers: Mapping[int, Array], known: Mapping[int, Array]) -> bool | None:
    """Whether most objects stand where a map has those of that name; None where that cannot be told.

    Both are {object id: (3,) centre, frame `map`, metres}. Names count from 0 in every session, and what a
    camera sees first stands before it. So an object counts as in place where the map has hardly another one
    nearer by, and where it is as far from the others as the map says; and few objects have to be very near.
    """
    shared = sorted(centers.keys() & known.keys())
    if not shared:
        return None
    here, there = (np.array([places[i] for i in shared]) for places in (centers, known))
    off_m = np.linalg.norm(here - there, axis=1)
    if len(shared) < WITNESSES:
        return True if off_m.max() <= VERY_NEAR_M else None
    nearest_m = cdist(here, list(known.values())).min(axis=1)
    as_far = np.abs(cdist(here, here) - cdist(there, there)) <= VERY_NEAR_M  # (n, n), each from itself, too
    in_layout = 2 * (as_far.sum(axis=1) - 1) >= len(shared) - 1
    in_place = (off_m <= SAME_PLACE_M) & (off_m <= nearest_m + VERY_NEAR_M) & in_layout
    return bool(2 * in_place.sum() > len(shared))
