"""Relative poses between keyframes from objects that both see: short range and loop closure (NeuSE IV-C)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from scipy.spatial.transform import Rotation

from neuse.geometry import Array, inverse
from neuse.params import CheckedParams, param
from neuse.records import Edge, EdgeKind
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.registration import Alignment, align_each
from neuse.slam.track import Track

TRACKED_SIGMAS = np.array([0.03, 0.03, 0.03, 0.05, 0.05, 0.05])  # of tracked motions in the window, rad and m
SOLVED_SIGMAS = np.array([0.005, 0.005, 0.005, 0.01, 0.01, 0.01])  # of motions in the solved graph, rad and m


@dataclass(frozen=True)
class EdgeParams(CheckedParams):
    """Between which keyframes edges are built, and which are good enough."""

    sigma_factor: float = param(
        0.5,
        "factor on sigmas: sigmas.scale expects many views that share one error, an edge has two",
        0.01,
        100.0,
    )
    window: int = param(10, "keyframes in the sliding window (paper: K = 10)", 2, 1000)
    max_residual_m: float = param(0.015, "an edge with a larger residual is refused, metres", 0.0001, 10.0)
    max_sigma_rad: float = param(
        0.1, "an edge with a larger predicted rotation sigma is refused, rad", 1e-4, 3.2
    )
    max_sigma_m: float = param(
        0.3, "an edge with a larger predicted translation sigma is refused, m", 1e-4, 100.0
    )
    max_closure_sigma_rad: float = param(0.03, "the same for loop closures, rad", 1e-4, 3.2)
    max_closure_sigma_m: float = param(0.02, "the same for loop closures, metres", 1e-4, 100.0)
    max_disagreement: float = param(
        5.0,
        "an edge this many sigmas from the motion as tracked, or for loop closures as solved, is refused",
        1.0,
        1e6,
    )
    period_gap: int = param(10, "keyframes without an object that end a period of sight", 1, 1000)
    period_sigma_m: float = param(
        0.015, "a period of sight begins when the centre is known this well, metres", 1e-4, 10.0
    )
    closure_spacing: int = param(
        10,
        "keyframes between two that loops are closed from or to; views that are near share one error",
        1,
        1000,
    )
    max_closures: int = param(5, "earlier keyframes tried for loop closure by one keyframe", 0, 1000)


class EdgeBuilder:
    """Builds edges; `rejected` counts the candidates that the gates refused."""

    def __init__(self, params: EdgeParams | None = None) -> None:
        self.params = params or EdgeParams()
        self.rejected = 0
        self._tried: dict[int, tuple[int, set[int]]] = {}  # by track: its last noted keyframe, its targets

    def short_range(
        self,
        new: KeyframeRecord,
        records: Sequence[KeyframeRecord],
        tracks: dict[int, Track],
        T_olds_new: Array,
    ) -> list[Edge]:
        """Edges to the keyframes before `new` in the window.

        T_olds_new: (n, 4, 4) of `new` relative to each of the last n records, as tracked.
        """
        window = [old for old in records[-self.params.window :] if self._in_window(old, new)]
        built = self._build(window, new, EdgeKind.SHORT_RANGE, tracks)
        edges = [edge for edge in built if edge is not None]
        motions = T_olds_new[[edge.from_id - edge.to_id for edge in edges]]
        return self._agreeing(edges, motions, TRACKED_SIGMAS)

    def borne_out(self, closures: Sequence[Edge], T_from_to: Array) -> list[Edge]:
        """Those that the solved graph does not contradict, in which their motions are (n, 4, 4)."""
        return self._agreeing(closures, T_from_to, SOLVED_SIGMAS)

    def _agreeing(self, edges: Sequence[Edge], T_from_to: Array, sigmas: Array) -> list[Edge]:
        agree = _disagreements(edges, T_from_to, sigmas) <= self.params.max_disagreement
        self.rejected += int((~agree).sum())
        return [edge for edge, agrees in zip(edges, agree, strict=True) if agrees]

    def _in_window(self, old: KeyframeRecord, new: KeyframeRecord) -> bool:
        return new.keyframe_id - self.params.window < old.keyframe_id < new.keyframe_id

    def loop_closures(
        self, new: KeyframeRecord, records: Sequence[KeyframeRecord], tracks: dict[int, Track]
    ) -> list[Edge]:
        """Edges to keyframes of every earlier period of sight of the objects seen again: to the first, as in
        the paper, and to later ones, whose views from nearer by tell more.
        """
        targets = self._targets(new, tracks)
        built = self._build([records[target] for target, _ in targets], new, EdgeKind.LOOP_CLOSURE, tracks)
        for target, keys in targets:
            for key in keys:
                self._tried_by(tracks[key]).add(target)
        return [edge for edge in built if edge is not None]

    def _targets(self, new: KeyframeRecord, tracks: dict[int, Track]) -> list[tuple[int, list[int]]]:
        """(keyframe, tracks that ask for it), the most asked for first; each once every so often."""
        asking: dict[int, list[int]] = {}
        for key in new.keys.tolist():
            if not (tracks[key].confirmed and tracks[key].periods):
                continue
            tried = self._tried_by(tracks[key])
            for target in chain.from_iterable(tracks[key].periods[:-1]):
                if target not in tried:
                    asking.setdefault(target, []).append(key)
        count = Counter({target: len(keys) for target, keys in asking.items()})
        ordered = sorted(count, key=lambda target: (-count[target], target))
        return [(target, asking[target]) for target in ordered[: self.params.max_closures]]

    def _tried_by(self, track: Track) -> set[int]:
        """Keyframes to which it has asked for a loop closure since it was noted last."""
        noted, tried = self._tried.get(track.key, (track.last_noted, set[int]()))
        self._tried[track.key] = track.last_noted, tried if noted == track.last_noted else set()
        return self._tried[track.key][1]

    def _build(
        self, olds: Sequence[KeyframeRecord], new: KeyframeRecord, kind: EdgeKind, tracks: dict[int, Track]
    ) -> list[Edge | None]:
        """For each old keyframe its edge to the new one, None if they share too little or a gate refuses."""
        known = np.array([tracks[key].in_graph for key in new.keys.tolist()], dtype=bool)
        shared = [np.intersect1d(new.keys[known], old.keys) for old in olds]
        common = [(old, keys) for old, keys in zip(olds, shared, strict=True) if len(keys)]
        factor = self.params.sigma_factor
        views = [(_rows(new, keys), old.frames[_rows(old, keys)].scaled(factor)) for old, keys in common]
        alignments = iter(align_each(new.frames.scaled(factor), views))
        return [
            self._edge(old, new, kind, keys, next(alignments), tracks) if len(keys) else None
            for old, keys in zip(olds, shared, strict=True)
        ]

    def _edge(
        self,
        old: KeyframeRecord,
        new: KeyframeRecord,
        kind: EdgeKind,
        keys: np.ndarray,
        alignment: Alignment | None,
        tracks: dict[int, Track],
    ) -> Edge | None:
        if alignment is None or not self._is_good(alignment, kind):
            self.rejected += 1
            return None
        return Edge(
            old.keyframe_id,
            new.keyframe_id,
            old.stamp_ns,
            new.stamp_ns,
            kind,
            alignment.T_b_a,
            alignment.covariance,
            tuple(tracks[key].object_id for key in keys[alignment.inliers].tolist()),
            alignment.residual_m,
        )

    def _is_good(self, alignment: Alignment, kind: EdgeKind) -> bool:
        """Whether it passes the gates: small residual, most objects agree, and well determined.

        A lone mug passes only with its handle in view, since else its rotation is not well determined.
        """
        params = self.params
        most_rad, most_m = params.max_sigma_rad, params.max_sigma_m
        if kind == EdgeKind.LOOP_CLOSURE:
            most_rad, most_m = params.max_closure_sigma_rad, params.max_closure_sigma_m
        return (
            alignment.residual_m <= params.max_residual_m
            and 2 * alignment.n_objects > len(alignment.inliers)
            and alignment.sigma_rotation_rad <= most_rad
            and alignment.sigma_translation_m <= most_m
        )


def _disagreements(edges: Sequence[Edge], T_from_to: Array, sigmas: Array) -> Array:
    """(n,) how many sigmas the edges are from motions (n, 4, 4) that are known to `sigmas` (6,)."""
    if not edges:
        return np.zeros(0)
    differences = inverse(np.stack([edge.T_from_to for edge in edges])) @ T_from_to
    turns = Rotation.from_matrix(differences[:, :3, :3]).as_rotvec()
    xi = np.concatenate([turns, differences[:, :3, 3]], axis=1)  # (n, 6)
    covariances = np.stack([edge.covariance for edge in edges]) + np.diag(sigmas**2)
    return np.sqrt((xi * np.linalg.solve(covariances, xi[..., None])[..., 0]).sum(axis=1))


def _rows(record: KeyframeRecord, keys: np.ndarray) -> np.ndarray:
    """Where the record has these keys."""
    order = np.argsort(record.keys)
    return order[np.searchsorted(record.keys, keys, sorter=order)]
