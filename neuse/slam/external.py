"""Edges of an external SLAM: their ends are named by stamps and moved to our keyframes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

from neuse.geometry import adjoint, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.checks import is_covariance, is_rigid
from neuse.slam.keyframe_graph import KeyframeGraph
from neuse.slam.keyframes import KeyframeLibrary
from neuse.slam.odometry import NANOSECONDS, Motion
from neuse.slam.trust import Trust, contradict

WITNESSES = 2  # objects in sight of a keyframe whose pose is known better than others can tell
HONEST = 4.0  # factor on stated variances up to which they are believed where nobody can tell
ENOUGH = 5  # edges that objects have vouched for or not, after which others like them are judged
PATIENCE_S = 30.0  # for that; then those that nobody can vouch for are taken in doubt:
DOUBT = 100.0  # factor on their variances


class ExternalEdges:
    """Takes in edges of an external SLAM, as far as they agree with what is known already.

    Its covariances are often those of a matching that has found the wrong minimum. Where the graph knows the
    two poses, it shows how far they can be trusted elsewhere, too: places without objects are often those
    where nothing else can be matched either, so that nothing is taken there from one who errs where they are.
    Until that is known, edges of such places wait.
    """

    def __init__(self, tolerance_s: float, counters: Counter[str]) -> None:
        self._tolerance_s, self._counters, self._trust = tolerance_s, counters, Trust()
        self._waiting: list[Edge] = []  # as they came
        self._since_ns = 0  # when the first of them came
        self._is_patient = True

    def accept(self, edges: Sequence[Edge], graph: KeyframeGraph) -> list[Edge]:
        """Those that can be used by now, between our keyframes, with covariances that have proved right."""
        accepted = list[Edge]()
        for edge in edges:
            for attached in attach([edge], graph.library, self._tolerance_s, self._counters):
                if _is_witnessed(attached, graph):
                    accepted += self._judged(attached, graph)
                else:
                    self._wait(edge, graph)
        return accepted + self._released(graph)

    def _wait(self, edge: Edge, graph: KeyframeGraph) -> None:
        if not self._waiting:
            self._since_ns = graph.library.records[-1].stamp_ns
        self._waiting.append(edge)
        if self._is_patient:
            self._counters["external_edge_waiting"] += 1

    def _judged(self, edge: Edge, graph: KeyframeGraph) -> list[Edge]:
        """An edge between keyframes that are known, unless they contradict."""
        stated, known = Motion(edge.T_from_to, edge.covariance), graph.motion(edge.from_id, edge.to_id)
        self._trust.learn(stated, known)
        if contradict(self._trust.scaled(stated, 1.0), known):
            self._counters["external_edge_contradicted"] += 1
            return []
        return [self._weighed(edge)]

    def _released(self, graph: KeyframeGraph) -> list[Edge]:
        """Those that have waited, once it is known whether they can be trusted, or it seems never to be."""
        if not self._waiting:
            return []
        is_known = self._trust.heard >= ENOUGH
        waited_s = (graph.library.records[-1].stamp_ns - self._since_ns) * NANOSECONDS
        if self._is_patient and not is_known and waited_s <= PATIENCE_S:
            return []
        self._is_patient = False
        waiting, self._waiting = self._waiting, []
        if is_known and self._trust.factors.max() > HONEST:
            self._counters["external_edge_unwitnessed"] += len(waiting)
            return []
        attached = attach(waiting, graph.library, self._tolerance_s, self._counters)
        return [self._weighed(edge, 1.0 if is_known else DOUBT) for edge in attached]

    def _weighed(self, edge: Edge, least: float = 1.0) -> Edge:
        stated = Motion(edge.T_from_to, edge.covariance)
        return replace(edge, covariance=self._trust.scaled(stated, least).covariance)


def _is_witnessed(edge: Edge, graph: KeyframeGraph) -> bool:
    return all(len(graph.library.records[end].keys) >= WITNESSES for end in (edge.from_id, edge.to_id))


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
