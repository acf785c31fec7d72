"""The paper's data association, one object at a time (NeuSE IV-B). Kept for comparison; see association.py.

A candidate must be alike in shape; the transform to the frame that saw it last maps the observation's partial
centre there, and the nearest candidate within delta_prox is the match. Unambiguous objects bring their own
transform, ambiguous ones use that of the matched unambiguous ones, or else of the best pair of them.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from neuse.errors import DegenerateGeometryError
from neuse.geometry import Array, inverse, transform_points
from neuse.slam.association import Association, AssociationParams
from neuse.slam.layout import View
from neuse.slam.library import similarity
from neuse.slam.object_frames import ObjectFrames, join_frames
from neuse.slam.registration import align_frames
from neuse.slam.track import LastSighting, Track


def associate_nearest(view: View, tracks: Sequence[Track], params: AssociationParams) -> Association:
    """Match the observations of a frame one at a time, unambiguous objects first."""
    search = _Search(view, tracks, similarity(view.codes, tracks) >= params.delta_shape, params.delta_prox_m)
    search.match_unambiguous()
    if search.T_map_camera is None:
        search.match_pair_of_ambiguous()
    if search.T_map_camera is not None:
        search.match_ambiguous(search.T_map_camera)
    return Association(tuple(search.matches.get(i) for i in range(len(view))))


@dataclass(frozen=True)
class _Hypothesis:
    """Observations matched with tracks, and the distance of the projected partial centres."""

    distance_m: float
    pairs: tuple[tuple[int, Track], ...]
    T_map_camera: Array


class _Search:
    def __init__(self, view: View, tracks: Sequence[Track], alike: np.ndarray, delta_prox_m: float) -> None:
        self.view, self.tracks, self.alike, self.delta_prox_m = view, tracks, alike, delta_prox_m
        self.matches: dict[int, Track] = {}
        self.T_map_camera: Array | None = None

    def match_unambiguous(self) -> None:
        """Every unambiguous observation with the candidate that its own transform brings it nearest to."""
        for i in np.flatnonzero(~self.view.frames.ambiguous).tolist():
            tried = [self._hypothesis([(i, track)]) for track in self._candidates(i)]
            self._accept([hypothesis for hypothesis in tried if hypothesis is not None])

    def match_ambiguous(self, T_map_camera: Array) -> None:
        """Every ambiguous observation with the candidate nearest under a known camera pose."""
        for i in np.flatnonzero(self.view.frames.ambiguous).tolist():
            tried = []
            for track in self._candidates(i):
                T_last_camera = inverse(track.last.T_map_camera) @ T_map_camera
                tried.append(
                    _Hypothesis(self._distance_m(i, track.last, T_last_camera), ((i, track),), T_map_camera)
                )
            self._accept(tried)

    def match_pair_of_ambiguous(self) -> None:
        """The best of all pairs of ambiguous observations and pairs of candidates last seen together."""
        tried = [self._hypothesis(pairs) for pairs in self._candidate_pairs()]
        self._accept([hypothesis for hypothesis in tried if hypothesis is not None])

    def _candidates(self, i: int) -> list[Track]:
        taken = {track.key for track in self.matches.values()}
        return [
            t for t, alike in zip(self.tracks, self.alike[i], strict=True) if alike and t.key not in taken
        ]

    def _candidate_pairs(self) -> Iterator[list[tuple[int, Track]]]:
        for i, j in combinations(np.flatnonzero(self.view.frames.ambiguous).tolist(), 2):
            for a in self._candidates(i):
                for b in self._candidates(j):
                    if a is not b and a.last_frame == b.last_frame:
                        yield [(i, a), (j, b)]

    def _hypothesis(self, pairs: Sequence[tuple[int, Track]]) -> _Hypothesis | None:
        """The transform from these pairs alone, None if they leave it open."""
        rows, last = [i for i, _ in pairs], pairs[0][1].last
        there: ObjectFrames = join_frames([track.last.frames for _, track in pairs])
        try:
            T_last_camera = align_frames(self.view.frames[rows], there).T_b_a
        except DegenerateGeometryError:
            return None
        distance_m = max(self._distance_m(i, track.last, T_last_camera) for i, track in pairs)
        return _Hypothesis(distance_m, tuple(pairs), last.T_map_camera @ T_last_camera)

    def _distance_m(self, i: int, last: LastSighting, T_last_camera: Array) -> float:
        projected = transform_points(T_last_camera, self.view.partial_centers[i])
        return float(np.linalg.norm(projected - last.partial_center))

    def _accept(self, tried: Sequence[_Hypothesis]) -> None:
        """Keep the nearest hypothesis if it is near enough and what it matches is still free."""
        best = min(tried, key=lambda h: h.distance_m, default=None)
        if best is None or best.distance_m >= self.delta_prox_m:
            return
        taken = {track.key for track in self.matches.values()}
        if any(i in self.matches or track.key in taken for i, track in best.pairs):
            return
        self.matches |= dict(best.pairs)
        if self.T_map_camera is None:
            self.T_map_camera = best.T_map_camera
