"""Where objects stand: drawn at random, such that they fit and the camera gets to see them well."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from neuse.errors import ParamError
from neuse.geometry import Array, inverse
from neuse.records import Intrinsics
from neuse.simulation.poses import place
from neuse.simulation.scene import Table, TrueObject, footprint, stands_free
from neuse.simulation.shapes import Shape
from neuse.simulation.trajectory import Trajectory

ATTEMPTS = 600
EDGE_MARGIN_M = 0.02
BORDER_PX = 40  # a point this far inside the image is seen well
MARGIN_M = 0.2  # a point this far outside the field of view is not seen at all, whatever its object's size

Suits = Callable[[Array], bool]


@dataclass(frozen=True)
class Sight:
    """Which points a trajectory gets to see; nothing occludes."""

    trajectory: Trajectory
    intrinsics: Intrinsics

    def closest_view_m(self, point: Array) -> float:
        """Smallest distance at which each traversal sees a point (3,) well; inf if one never does."""
        points_camera = self._in_cameras(point)
        distance_m = np.linalg.norm(points_camera, axis=1)
        distance_m[~self._in_image(points_camera, -BORDER_PX, 0.0)] = np.inf
        traversals = range(int(self.trajectory.traversal.max()) + 1)
        return max(distance_m[self.trajectory.traversal == t].min(initial=np.inf) for t in traversals)

    def is_hidden(self, point: Array, frame: int) -> bool:
        """Whether an object at a point (3,) is out of the image in a frame and in the one before."""
        points_camera = self._in_cameras(point)[max(frame - 1, 0) : frame + 1]
        return not self._in_image(points_camera, 0.0, MARGIN_M).any()

    def _in_cameras(self, point: Array) -> Array:
        return self._T_camera_world[:, :3, :3] @ point + self._T_camera_world[:, :3, 3]

    @cached_property
    def _T_camera_world(self) -> Array:
        return inverse(self.trajectory.T_world_camera)

    def _in_image(self, points_camera: Array, margin_px: float, margin_m: float) -> np.ndarray:
        k, z = self.intrinsics, np.maximum(points_camera[:, 2], 1e-6)
        off_axis = np.abs(points_camera[:, :2]) - margin_m  # the principal point is close to the middle
        half_size = np.array([k.width / 2 + margin_px, k.height / 2 + margin_px])
        inside = off_axis / z[:, None] * [k.fx, k.fy] <= half_size
        return (points_camera[:, 2] > 0.0) & inside.all(axis=1)


class Decorator:
    """Places objects on tables where they fit and are seen from `approach_m` in each traversal."""

    def __init__(
        self, tables: Sequence[Table], sight: Sight, approach_m: float, rng: np.random.Generator
    ) -> None:
        self.tables, self.sight, self.rng = tuple(tables), sight, rng
        self._approach_m = approach_m

    def find_place(
        self,
        shape: Shape,
        kind: str,
        tables: Sequence[Table],
        others: Sequence[TrueObject],
        suits: Suits = lambda T_world_object: True,
    ) -> Array:
        """T_world_object of a free place on one of `tables` that `suits`.

        A place is asked to be seen from close by; the longer the search, the less is asked.

        Raises:
            ParamError: there is no such place.
        """
        for attempt in range(ATTEMPTS):
            table = tables[int(self.rng.integers(len(tables)))]
            half_size = np.array(table.size_m) / 2
            xy, yaw_rad = self.rng.uniform(-half_size, half_size), self.rng.uniform(-np.pi, np.pi)
            T_world_object = table.T_world_table @ place(shape, kind, yaw_rad, xy, self.rng)
            patience = 1.0 - 2.0 * attempt / ATTEMPTS
            limit_m = self._approach_m / patience if patience > 0.0 else np.inf
            if (
                self.sight.closest_view_m(T_world_object[:3, 3]) <= limit_m
                and suits(T_world_object)
                and self._is_on(table, shape, T_world_object)
                and stands_free(shape, T_world_object, others)
            ):
                return T_world_object
        raise ParamError(f"no room for {shape.name} among {len(others)} objects; take fewer or larger tables")

    def fits(self, candidate: TrueObject, others: Sequence[TrueObject]) -> bool:
        """Whether the whole of an object is above a table and free of all others."""
        on_table = any(self._is_on(table, candidate.shape, candidate.T_world_object) for table in self.tables)
        return on_table and stands_free(candidate.shape, candidate.T_world_object, others)

    @staticmethod
    def _is_on(table: Table, shape: Shape, T_world_object: Array) -> bool:
        return table.holds(footprint(shape, T_world_object), EDGE_MARGIN_M)
