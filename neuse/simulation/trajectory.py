"""Smooth closed camera trajectories: splines through positions and look-at points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from neuse.errors import ParamError
from neuse.geometry import Array
from neuse.simulation.camera import look_at

DENSITY = 40


@dataclass(frozen=True)
class Waypoint:
    """Where the camera passes and what it looks at there, (3,) each, metres, world."""

    position: Array
    target: Array


@dataclass(frozen=True)
class Trajectory:
    """Camera poses (n, 4, 4), p_world = T_world_camera @ p_camera, and the traversal (n,) each belongs to."""

    T_world_camera: Array
    traversal: np.ndarray

    def start_of(self, traversal: int) -> int:
        """First frame of a traversal."""
        return int(np.searchsorted(self.traversal, traversal))

    @property
    def length_m(self) -> float:
        """Length of the camera's path."""
        return float(np.linalg.norm(np.diff(self.T_world_camera[:, :3, 3], axis=0), axis=1).sum())


def closed_trajectory(
    traversals: Sequence[Sequence[Waypoint]], frames: int, turn_radius_m: float = 1.0
) -> Trajectory:
    """A closed path through all waypoints of all traversals, in order, twice continuously differentiable.

    Frames are evenly spaced in the arc length of SE(3), ds^2 = |dp|^2 + (turn_radius_m dangle)^2: the camera
    slows down where it turns, and no frame moves or turns more than its share.

    Raises:
        ParamError: fewer than three waypoints or two frames.
    """
    waypoints = [waypoint for traversal in traversals for waypoint in traversal]
    if len(waypoints) < 3 or frames < 2:
        raise ParamError(f"a closed path needs 3 waypoints and 2 frames, got {len(waypoints)} and {frames}")
    knots = np.array([[w.position, w.target] for w in waypoints])  # (m, 2, 3)
    knots = np.concatenate([knots, knots[:1]])
    chords_m = np.linalg.norm(np.diff(knots, axis=0), axis=2).max(axis=1)
    stations = _cumulative(np.sqrt(chords_m))  # centripetal: no overshoot where waypoints are unevenly spaced
    spline = CubicSpline(stations, knots, bc_type="periodic")
    dense = np.linspace(0.0, stations[-1], frames * DENSITY + 1)
    arc = _cumulative(_steps(look_at(*np.moveaxis(spline(dense), 1, 0)), turn_radius_m))
    station = np.interp(np.arange(frames) * arc[-1] / frames, arc, dense)
    starts = stations[np.cumsum([0, *map(len, traversals)])[:-1]]
    traversal = np.searchsorted(starts, station, side="right") - 1
    return Trajectory(look_at(*np.moveaxis(spline(station), 1, 0)), traversal)


def _steps(T_world_camera: Array, turn_radius_m: float) -> Array:
    """(n - 1,) lengths of steps between (n, 4, 4) poses; small angles."""
    moved_m = np.linalg.norm(np.diff(T_world_camera[:, :3, 3], axis=0), axis=1)
    turned_rad = np.linalg.norm(np.diff(T_world_camera[:, :3, :3], axis=0), axis=(1, 2)) / np.sqrt(2.0)
    return np.hypot(moved_m, turn_radius_m * turned_rad)


def _cumulative(steps: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(steps)])
