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
from neuse.slam.localization import to_camera
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
        free = [i for i in clear if matched[i] is None]
        taken = self._taken(view, free, missing, T_map_camera, frame_index)
        self._contradictions.update(track.key for track in taken)
        return [track for track in taken if self._contradictions[track.key] >= self._enough]

    def _taken(
        self,
        view: View,
        free: Sequence[int],
        missing: Sequence[Track],
        T_map_camera: Array,
        frame_index: int,
    ) -> list[Track]:
        """Tracks in whose places these observations show something else."""
        if not free or not missing:
            return []
        seen = to_camera(T_map_camera, places_of(missing))[0]
        offsets_m = np.linalg.norm(view.frames.centers[free][:, None] - seen[None], axis=-1)
        codes = [view.codes[i] for i in free]
        alike = alike_in_place(codes, missing, self._params.max_unlikeness, frame_index)
        taken = (~alike & (offsets_m <= self._params.delta_prox_m)).any(axis=0)
        return [track for track, is_taken in zip(missing, taken, strict=True) if is_taken]
