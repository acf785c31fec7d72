"""Ground truth of a simulated world; only the evaluation reads it."""

from dataclasses import dataclass

import numpy as np

from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array
from neuse.records import ObjectChange


@dataclass(frozen=True)
class TrueObject:
    """An object of the world at one place.

    T_world_object: p_world = T_world_object @ p_object.    box_size: (3,) metres, along the object frame.
    n_seen: in how many frames the camera has clearly seen it at this place so far.
    """

    object_id: int
    category: str
    T_world_object: Array
    box_size: Array
    n_seen: int = 0

    @property
    def center(self) -> Array:
        """(3,) centre in the world."""
        return self.T_world_object[:3, 3]


@dataclass(frozen=True)
class TrueMap:
    """The world's objects from an instant on."""

    stamp_ns: int
    objects: tuple[TrueObject, ...]


@dataclass(frozen=True)
class Truth:
    """What the simulation knows: the camera's path, the objects and their changes, in the frame `world`."""

    trajectory: Trajectory
    maps: tuple[TrueMap, ...] = ()
    changes: tuple[ObjectChange, ...] = ()
    traversal_starts_ns: tuple[int, ...] = ()

    def traversals(self) -> list[tuple[int, int]]:
        """[start, end) stamps of every traversal; one over everything when the bag tells none."""
        starts = self.traversal_starts_ns or (int(self.trajectory.stamps_ns[0]),)
        ends = (*starts[1:], np.iinfo(np.int64).max)
        return list(zip(starts, ends, strict=True))

    def final_objects(self) -> tuple[TrueObject, ...]:
        """The objects at the end; empty when the bag has none."""
        return self.maps[-1].objects if self.maps else ()
