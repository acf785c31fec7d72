"""Are the edges' covariances honest? Normalised estimation error squared against true relative poses."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from neuse import geometry
from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array
from neuse.records import Edge, EdgeKind

DOF = 6


@dataclass(frozen=True)
class Nees:
    """NEES of some edges: honest covariances have mean `dof`; n is how many edges it was taken over."""

    mean: float
    median: float
    inside_95: float
    n: int
    dof: int = DOF


def edge_nees(edge: Edge, truth: Trajectory) -> float | None:
    """xi.T @ inv(covariance) @ xi with T_true = T_from_to @ exp(xi); None when ground truth lacks an end."""
    T_world_from, T_world_to = truth.at(edge.from_stamp_ns), truth.at(edge.to_stamp_ns)
    if T_world_from is None or T_world_to is None:
        return None
    T_from_to_true = geometry.inverse(T_world_from) @ T_world_to
    xi = geometry.log(geometry.inverse(edge.T_from_to) @ T_from_to_true)
    return float(xi @ np.linalg.solve(edge.covariance, xi))


def summarize_nees(edges: Iterable[Edge], truth: Trajectory, kinds: Iterable[EdgeKind]) -> Nees | None:
    """NEES over the edges of some kinds; None when there are none."""
    wanted = set(kinds)
    values = [edge_nees(edge, truth) for edge in edges if edge.kind in wanted]
    known: Array = np.array([value for value in values if value is not None])
    if not len(known):
        return None
    inside = float(np.mean(known <= chdtri(DOF, 0.05)))
    return Nees(float(known.mean()), float(np.median(known)), inside, len(known))
