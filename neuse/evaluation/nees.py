"""Are covariances honest? Normalised estimation error squared of edges and poses against ground truth."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from neuse import geometry
from neuse.evaluation.trajectory import FramePose, Trajectory
from neuse.geometry import Array
from neuse.records import Edge, EdgeKind

DOF = 6


@dataclass(frozen=True)
class Nees:
    """NEES of some edges or poses: honest covariances have mean `dof`; n is how many it was taken over."""

    mean: float
    median: float
    inside_95: float
    n: int
    dof: int = DOF


def edge_error(edge: Edge, truth: Trajectory) -> Array | None:
    """(6,) xi with T_true = T_from_to @ exp(xi), rad and m; None when ground truth lacks an end."""
    T_world_from, T_world_to = truth.at(edge.from_stamp_ns), truth.at(edge.to_stamp_ns)
    if T_world_from is None or T_world_to is None:
        return None
    T_from_to_true = geometry.inverse(T_world_from) @ T_world_to
    return geometry.log(geometry.inverse(edge.T_from_to) @ T_from_to_true)


def edge_nees(edge: Edge, truth: Trajectory) -> float | None:
    """xi.T @ inv(covariance) @ xi of `edge_error`; None when ground truth lacks an end."""
    xi = edge_error(edge, truth)
    return None if xi is None else _nees(xi, edge.covariance)


def summarize_nees(edges: Iterable[Edge], truth: Trajectory, kinds: Iterable[EdgeKind]) -> Nees | None:
    """NEES over the edges of some kinds; None when there are none."""
    wanted = set(kinds)
    return _summary([edge_nees(edge, truth) for edge in edges if edge.kind in wanted])


def nees_by_objects(
    edges: Iterable[Edge], categories: Mapping[int, str], truth: Trajectory
) -> dict[str, Nees | None]:
    """NEES over edges by what they were computed from: objects of one category, or "mixed"."""
    groups: dict[str, list[float | None]] = {}
    for edge in edges:
        known = {categories[i] for i in edge.object_ids if i in categories}
        if known:
            name = known.pop() if len(known) == 1 else "mixed"
            groups.setdefault(name, []).append(edge_nees(edge, truth))
    return {name: _summary(values) for name, values in sorted(groups.items())}


def pose_nees(frames: Sequence[FramePose], truth: Trajectory) -> Nees | None:
    """NEES of poses as published, relative to the first pose, which defines the map; None without two."""
    known = [f for f in frames if f.covariance is not None and truth.at(f.stamp_ns) is not None]
    return _summary([_relative_nees(known[0], frame, truth) for frame in known[1:]])


def _relative_nees(first: FramePose, frame: FramePose, truth: Trajectory) -> float | None:
    T_world_first, T_world_camera = truth.at(first.stamp_ns), truth.at(frame.stamp_ns)
    if T_world_first is None or T_world_camera is None or frame.covariance is None:
        return None
    T_true = geometry.inverse(T_world_first) @ T_world_camera
    T_estimated = geometry.inverse(first.T_map_camera) @ frame.T_map_camera
    return _nees(geometry.log(geometry.inverse(T_estimated) @ T_true), frame.covariance)


def _nees(xi: Array, covariance: Array) -> float:
    return float(xi @ np.linalg.solve(covariance, xi))


def _summary(values: Iterable[float | None]) -> Nees | None:
    known: Array = np.array([value for value in values if value is not None])
    if not len(known):
        return None
    inside = float(np.mean(known <= chdtri(DOF, 0.05)))
    return Nees(float(known.mean()), float(np.median(known)), inside, len(known))
