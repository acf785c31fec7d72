"""Relative poses between keyframes from the objects that both see: short range and loop closure (NeuSE IV-C)."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.errors import DegenerateGeometryError
from neuse.params import CheckedParams, param
from neuse.records import Edge, EdgeKind
from neuse.slam.keyframes import KeyframeRecord
from neuse.slam.library import Track
from neuse.slam.registration import Alignment, align_frames


@dataclass(frozen=True)
class EdgeParams(CheckedParams):
    """Between which keyframes edges are built, and which are good enough."""

    window: int = param(10, "keyframes in the sliding window (paper: K = 10)", 2, 1000)
    max_residual_m: float = param(0.015, "an edge with a larger residual is refused, metres", 0.0001, 10.0)
    max_sigma_rad: float = param(
        0.1, "an edge with a larger predicted rotation sigma is refused, rad", 1e-4, 3.2
    )
    max_sigma_m: float = param(
        0.3, "an edge with a larger predicted translation sigma is refused, m", 1e-4, 100.0
    )
    period_gap: int = param(10, "keyframes without an object that end a period of sight", 1, 1000)
    max_closures: int = param(5, "earlier keyframes tried for loop closure by one keyframe", 0, 1000)


class EdgeBuilder:
    """Builds edges; `rejected` counts the candidates that the gates refused."""

    def __init__(self, params: EdgeParams | None = None) -> None:
        self.params = params or EdgeParams()
        self.rejected = 0
        self._closed: set[tuple[int, int, int]] = (
            set()
        )  # (track, its period, target keyframe) that have an edge

    def short_range(
        self, new: KeyframeRecord, records: Sequence[KeyframeRecord], tracks: dict[int, Track]
    ) -> list[Edge]:
        """Edges to the keyframes before `new` in the window."""
        window = [
            r for r in records[-self.params.window :] if r.keyframe_id > new.keyframe_id - self.params.window
        ]
        edges = (self._edge(old, new, EdgeKind.SHORT_RANGE, tracks) for old in window if old is not new)
        return [edge for edge in edges if edge is not None]

    def loop_closures(
        self, new: KeyframeRecord, records: Sequence[KeyframeRecord], tracks: dict[int, Track]
    ) -> list[Edge]:
        """Edges to the first keyframe of every earlier period of sight of the objects seen again."""
        edges = []
        for target, keys in self._targets(new, tracks):
            edge = self._edge(records[target], new, EdgeKind.LOOP_CLOSURE, tracks)
            if edge is not None:
                edges.append(edge)
                self._closed |= {(key, tracks[key].periods[-1], target) for key in keys}
        return edges

    def _targets(self, new: KeyframeRecord, tracks: dict[int, Track]) -> list[tuple[int, list[int]]]:
        """(keyframe, tracks that ask for it), the most asked for first; tried anew until a period is a window old."""
        asking: dict[int, list[int]] = {}
        for key in new.keys.tolist():
            *earlier, current = tracks[key].periods
            if tracks[key].confirmed and new.keyframe_id - current < self.params.window:
                for target in earlier:
                    if (key, current, target) not in self._closed:
                        asking.setdefault(target, []).append(key)
        count = Counter({target: len(keys) for target, keys in asking.items()})
        ordered = sorted(count, key=lambda target: (-count[target], target))
        return [(target, asking[target]) for target in ordered[: self.params.max_closures]]

    def _edge(
        self, old: KeyframeRecord, new: KeyframeRecord, kind: EdgeKind, tracks: dict[int, Track]
    ) -> Edge | None:
        keys, at_new, at_old = np.intersect1d(new.keys, old.keys, assume_unique=True, return_indices=True)
        known = np.array([tracks[key].confirmed for key in keys.tolist()], dtype=bool)
        if not known.any():
            return None
        alignment = self._aligned(new, at_new[known], old, at_old[known])
        if alignment is None:
            self.rejected += 1
            return None
        object_ids = tuple(tracks[key].object_id for key in keys[known][alignment.inliers].tolist())
        return Edge(
            old.keyframe_id,
            new.keyframe_id,
            old.stamp_ns,
            new.stamp_ns,
            kind,
            alignment.T_b_a,
            alignment.covariance,
            object_ids,
            alignment.residual_m,
        )

    def _aligned(
        self, new: KeyframeRecord, at_new: np.ndarray, old: KeyframeRecord, at_old: np.ndarray
    ) -> Alignment | None:
        """T_old_new, None unless it passes the gates."""
        try:
            alignment = align_frames(new.frames[at_new], old.frames[at_old])
        except DegenerateGeometryError:
            return None
        good = (
            alignment.residual_m <= self.params.max_residual_m
            and alignment.sigma_rotation_rad <= self.params.max_sigma_rad
            and alignment.sigma_translation_m <= self.params.max_sigma_m
            and 2 * alignment.n_objects > len(at_new)
        )
        return alignment if good else None
