"""Known objects in whose places others stand now: two bottles that traded places must not pass as the same.

A poor view cannot tell like shapes apart, so that it may match whatever stands in a known place. Clear views
can; when enough of them contradict, the known object is taken to have left.
"""

from collections import Counter
from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array
from neuse.slam.association import AssociationParams
from neuse.slam.layout import View
from neuse.slam.library import alike_in_place
from neuse.slam.localization import to_map
from neuse.slam.track import CLEAR_SHAPE_NOISE, Track, places_of, shape_noise


class DisplacementWatch:
    """Counts clear views that show another shape in a track's place; a clear match starts the count anew."""

    def __init__(self, params: AssociationParams, enough: int) -> None:
        self._params, self._enough = params, enough
        self._contradictions: Counter[int] = Counter()

    def displaced(
        self,
        view: View,
        matched: Sequence[Track | None],
        tracks: Sequence[Track],
        T_map_camera: Array,
        frame_index: int,
    ) -> list[Track]:
        """Those of the tracks that have been contradicted often enough by now."""
        clear = [i for i, code in enumerate(view.codes) if shape_noise(code) <= CLEAR_SHAPE_NOISE]
        for i in clear:
            if (track := matched[i]) is not None:
                self._contradictions.pop(track.key, None)
        missing = [t for t in tracks if t.confirmed and t not in matched]
        if not clear or not missing:
            return []
        standing = _standing(view, matched, clear, T_map_camera)
        taken = self._taken(view, clear, standing, missing, frame_index)
        self._contradictions.update(track.key for track in taken)
        return [track for track in taken if self._contradictions[track.key] >= self._enough]

    def _taken(
        self, view: View, clear: Sequence[int], standing: Array, missing: Sequence[Track], frame_index: int
    ) -> list[Track]:
        """Tracks in whose places something stands that looks otherwise."""
        offsets_m = np.linalg.norm(standing[:, None] - places_of(missing)[0][None], axis=-1)
        codes, rivals = [view.codes[i] for i in clear], [view.rivals[i] for i in clear]
        alike = alike_in_place(codes, rivals, missing, self._params.max_unlikeness, frame_index)
        taken = (~alike & (offsets_m <= self._params.delta_prox_m)).any(axis=0)
        return [track for track, is_taken in zip(missing, taken, strict=True) if is_taken]


def _standing(
    view: View, matched: Sequence[Track | None], chosen: Sequence[int], T_map_camera: Array
) -> Array:
    """(n, 3) where chosen observations stand in the map; matched ones, however drift shows them, by track."""
    seen = to_map(T_map_camera, view.frames.vectors)[0]
    known = [(matched[i], seen[i]) for i in chosen]
    return np.array([center if track is None else track.place[0] for track, center in known])
