"""Data association once the pose is known: what contradicts goes, and what stands in its place is taken."""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array
from neuse.slam.association import GATE_SIGMAS, AssociationParams, square_ranges
from neuse.slam.drift import drift_from
from neuse.slam.layout import View
from neuse.slam.library import alike_in_place
from neuse.slam.localization import Belief, to_camera
from neuse.slam.track import Track, places_of


def complete(
    view: View,
    matched: Sequence[Track | None],
    tracks: Sequence[Track],
    drift: Array,
    belief: Belief,
    params: AssociationParams,
    frame_index: int,
) -> tuple[Track | None, ...]:
    """Matches once the pose is known: contradicting ones go, free observations take what stands there.

    Unambiguous objects choose first, then the nearest (NeuSE IV-B). Where drift leaves open how a track
    lies to those that have told the pose, nearness proves nothing; such a track waits for a joint match.

    Args:
        drift: (m, 2) as in `associate`, of the frame before.
    """
    anchors = [track for track in matched if track is not None]
    if anchors:
        drift = drift_from(anchors, tracks)
    offsets_m, gates_m = _offsets_and_gates(view, tracks, belief, params)
    alike = alike_in_place(view.codes, view.rivals, tracks, params.max_unlikeness, frame_index)
    columns = {track.key: m for m, track in enumerate(tracks)}
    result = [
        track if track is not None and offsets_m[i, columns[track.key]] <= 2 * gates_m[i] else None
        for i, track in enumerate(matched)
    ]
    open_m = GATE_SIGMAS * np.sqrt(drift[None, :, 1] + drift[None, :, 0] * square_ranges(view)[:, None])
    possible = (offsets_m <= gates_m[:, None]) & alike & (open_m <= params.open_gate_m)
    taken = {track.key for track in result if track is not None}
    order = sorted(
        zip(*np.nonzero(possible), strict=True),
        key=lambda pair: (view.frames.ambiguous[pair[0]], offsets_m[pair], pair),
    )
    for i, m in order:
        if result[i] is None and tracks[m].key not in taken:
            result[i] = tracks[m]
            taken.add(tracks[m].key)
    return tuple(result)


def _offsets_and_gates(
    view: View, tracks: Sequence[Track], belief: Belief, params: AssociationParams
) -> tuple[Array, Array]:
    """(n, m) distances between observations and places, (n,) gates of the observations; metres."""
    seen = to_camera(belief.T_map_camera, places_of(tracks))[0]
    offsets_m = np.linalg.norm(view.frames.centers[:, None] - seen[None], axis=-1)
    turn, shift = (
        np.linalg.eigvalsh(belief.covariance[:3, :3])[-1],
        np.linalg.eigvalsh(belief.covariance[3:, 3:])[-1],
    )
    square_range = square_ranges(view)
    sigmas = np.sqrt(shift + turn * square_range + view.frames.variances[0])
    return offsets_m, np.minimum(params.delta_prox_m + GATE_SIGMAS * sigmas, params.max_gate_m)
