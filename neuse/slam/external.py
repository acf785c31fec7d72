"""Edges of an external SLAM: their ends are named by stamps and moved to our keyframes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from neuse.geometry import adjoint, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.checks import is_covariance, is_rigid
from neuse.slam.keyframe_graph import KeyframeGraph
from neuse.slam.keyframes import KeyframeLibrary
from neuse.slam.odometry import Motion
from neuse.slam.trust import Trust, contradict

WITNESSES = 2  # objects in sight of a keyframe whose pose is known better than others can tell
HONEST = 4.0  # factor on stated variances up to which they are believed where nobody can tell


class ExternalEdges:
    """Takes in edges of an external SLAM, as far as they agree with what is known already.

    Its covariances are often those of a matching that has found the wrong minimum. Where the graph knows the
    two poses, it shows how far they can be trusted elsewhere, too: places without objects are often those
    where nothing else can be matched either, so that nothing is taken there from one who errs where they are.
    """

    def __init__(self, tolerance_s: float, counters: Counter[str]) -> None:
        self._tolerance_s, self._counters, self._trust = tolerance_s, counters, Trust()

    def accept(self, edges: Sequence[Edge], graph: KeyframeGraph) -> list[Edge]:
        """Those that can be used, between our keyframes, with covariances that have proved right."""
        attached = attach(edges, graph.library, self._tolerance_s, self._counters)
        return [edge for edge in map(partial(self._judged, graph), attached) if edge is not None]

    def _judged(self, graph: KeyframeGraph, edge: Edge) -> Edge | None:
        stated = Motion(edge.T_from_to, edge.covariance)
        if all(len(graph.library.records[end].keys) >= WITNESSES for end in (edge.from_id, edge.to_id)):
            known = graph.motion(edge.from_id, edge.to_id)
            self._trust.learn(stated, known)
            if contradict(self._trust.scaled(stated, 1.0), known):
                self._counters["external_edge_contradicted"] += 1
                return None
        elif self._trust.factors.max() > HONEST:
            self._counters["external_edge_unwitnessed"] += 1
            return None
        return replace(edge, covariance=self._trust.scaled(stated, 1.0).covariance)


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
