"""Edges of an external SLAM: their ends are named by stamps and moved to our keyframes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from neuse.geometry import adjoint, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.checks import is_covariance, is_rigid
from neuse.slam.keyframes import KeyframeLibrary


def attach(
    edges: Sequence[Edge], keyframes: KeyframeLibrary, tolerance_s: float, counters: Counter[str]
) -> list[Edge]:
    """The edges between our keyframes; those that cannot be used are counted and left out."""
    attached = []
    for edge in edges:
        fault = _fault(edge)
        moved = None if fault else _between_keyframes(edge, keyframes, int(tolerance_s * 1e9))
        if moved is None:
            counters[fault or "external_edge_without_frame"] += 1
        else:
            attached.append(moved)
    return attached


def _fault(edge: Edge) -> str | None:
    if not is_rigid(edge.T_from_to):
        return "external_edge_not_rigid"
    return None if is_covariance(edge.covariance) else "external_edge_covariance"


def _between_keyframes(edge: Edge, keyframes: KeyframeLibrary, tolerance_ns: int) -> Edge | None:
    """The same constraint between the keyframes that hold the two frames; None if a frame is unknown."""
    start = keyframes.frame_near(edge.from_stamp_ns, tolerance_ns)
    end = keyframes.frame_near(edge.to_stamp_ns, tolerance_ns)
    if start is None or end is None or start.keyframe_id == end.keyframe_id:
        return None
    A = adjoint(end.T_keyframe_camera)
    return replace(
        edge,
        kind=EdgeKind.EXTERNAL,
        from_id=start.keyframe_id,
        to_id=end.keyframe_id,
        T_from_to=start.T_keyframe_camera @ edge.T_from_to @ inverse(end.T_keyframe_camera),
        covariance=A @ edge.covariance @ A.T,
    )
