"""Edges between other parts of the robot than its camera: most SLAMs keep the poses of a base or an IMU."""

from dataclasses import replace

from neuse.geometry import Array, adjoint, inverse
from neuse.records import Edge


def moved_to_body(edge: Edge, T_body_camera: Array) -> Edge:
    """The same constraint between the bodies that carry the cameras: p_body = T_body_camera @ p_camera."""
    A = adjoint(T_body_camera)
    return replace(
        edge,
        T_from_to=T_body_camera @ edge.T_from_to @ inverse(T_body_camera),
        covariance=A @ edge.covariance @ A.T,
    )


def moved_to_camera(edge: Edge, T_body_camera: Array) -> Edge:
    """Inverse of `moved_to_body`: a constraint between bodies as neuse/external_edges wants it."""
    return moved_to_body(edge, inverse(T_body_camera))


def reversed_pose(T_from_to: Array, covariance: Array) -> tuple[Array, Array]:
    """T_to_from and its covariance: (T exp(xi))^-1 = T^-1 exp(-adjoint(T) xi)."""
    A = adjoint(T_from_to)
    return inverse(T_from_to), A @ covariance @ A.T
