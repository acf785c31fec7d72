"""Motions between keyframes of the graph; those of a keyframe that leaves it go over to its stand-in."""

from dataclasses import replace

import numpy as np

from neuse.geometry import Array, adjoint, inverse
from neuse.records import Edge

STAND_IN_COVARIANCE = np.diag(np.repeat([0.005**2], 6))  # of a place beside the stand-in, rad^2, m^2


class Chain:
    """Edges between keyframes, one for any two of them once they have gone over."""

    def __init__(self) -> None:
        self._edges: dict[int, list[Edge]] = {}  # by keyframe, each edge at both ends

    def add(self, edge: Edge) -> None:
        """A motion between two keyframes."""
        for end in (edge.from_id, edge.to_id):
            self._edges.setdefault(end, []).append(edge)

    def hand_over(self, keyframe_id: int, stand_in: int, T_stand_in_left: Array) -> list[Edge]:
        """Take a keyframe out: what was known between it and others, as far as it is new of its stand-in."""
        new = list[Edge]()
        for edge in self._edges.pop(keyframe_id, []):
            other = edge.from_id if edge.to_id == keyframe_id else edge.to_id
            self._edges[other] = [held for held in self._edges[other] if held is not edge]
            if other != stand_in and not self._joins(stand_in, other):
                new.append(_handed_over(edge, keyframe_id, stand_in, T_stand_in_left))
                self.add(new[-1])
        return new

    def _joins(self, one: int, other: int) -> bool:
        return any(other in (edge.from_id, edge.to_id) for edge in self._edges.get(one, []))


def _handed_over(edge: Edge, left: int, stand_in: int, T_stand_in_left: Array) -> Edge:
    """The edge with the stand-in at the end of the keyframe that leaves; to first order."""
    if edge.from_id == left:
        A = adjoint(inverse(edge.T_from_to))
        T_from_to, covariance = T_stand_in_left @ edge.T_from_to, edge.covariance + _moved(A)
        return replace(edge, from_id=stand_in, T_from_to=T_from_to, covariance=covariance)
    A = adjoint(T_stand_in_left)
    covariance = A @ edge.covariance @ A.T + _moved(A)
    return replace(
        edge, to_id=stand_in, T_from_to=edge.T_from_to @ inverse(T_stand_in_left), covariance=covariance
    )


def _moved(A: Array) -> Array:
    return A @ STAND_IN_COVARIANCE @ A.T
