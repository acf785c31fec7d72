"""The truth of a simulated world, gathered frame by frame."""

from collections import Counter

import numpy as np

from neuse.evaluation.trajectory import trajectory_of
from neuse.evaluation.truth import TrueMap, TrueObject, Truth
from neuse.geometry import Array
from neuse.records import ObjectChange
from neuse.simulation.worlds import SimulatedFrame
from neuse.simulation.worlds import TrueObject as PlacedShape

CLEARLY_SEEN_PX = 1000
CLEARLY_SEEN_M = 2.0


class TruthCollector:
    """Keeps poses, maps and changes, and counts how often each object is clearly seen at its place."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._poses: list[Array] = []
        self._maps: list[TrueMap] = []
        self._changes: list[ObjectChange] = []
        self._traversal_starts_ns: dict[int, int] = {}
        self._seen: Counter[int] = Counter()
        self._objects: tuple[PlacedShape, ...] = ()

    def add(self, simulated: SimulatedFrame) -> None:
        """Take in one frame."""
        stamp_ns = simulated.frame.stamp_ns
        for change in simulated.changes:
            self._seen.pop(change.object_id, None)
        self._stamps_ns.append(stamp_ns)
        self._poses.append(simulated.T_world_camera)
        self._changes += simulated.changes
        self._traversal_starts_ns.setdefault(simulated.traversal, stamp_ns)
        self._objects = simulated.objects
        if not self._maps or simulated.changes:
            self._add_map(stamp_ns)
        self._seen.update(item.object_id for item in simulated.objects if is_clearly_seen(item, simulated))

    def finish(self) -> Truth:
        """The truth of all frames so far; its last map has the final counts."""
        if self._stamps_ns:
            self._add_map(self._stamps_ns[-1])
        return Truth(
            trajectory_of(self._stamps_ns, self._poses),
            tuple(self._maps),
            tuple(self._changes),
            tuple(self._traversal_starts_ns.values()),
        )

    def _add_map(self, stamp_ns: int) -> None:
        objects = tuple(true_object(item, self._seen[item.object_id]) for item in self._objects)
        self._maps.append(TrueMap(stamp_ns, objects))


def is_clearly_seen(item: PlacedShape, simulated: SimulatedFrame) -> bool:
    """Near and large in the picture, in the manner of the paper's rule for new objects (appendix)."""
    range_m = np.linalg.norm(item.position - simulated.T_world_camera[:3, 3])
    return bool(range_m <= CLEARLY_SEEN_M and simulated.visible_px.get(item.object_id, 0) >= CLEARLY_SEEN_PX)


def true_object(item: PlacedShape, n_seen: int) -> TrueObject:
    """A placed shape as the evaluation knows it."""
    size = np.ptp(item.shape.mesh.bounds, axis=0)
    return TrueObject(item.object_id, item.shape.category, item.T_world_object, size, n_seen)
