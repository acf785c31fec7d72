"""Taking over the objects of a map made by others."""

from collections.abc import Mapping, Sequence

import numpy as np

from neuse.geometry import Array
from neuse.records import NO_ID
from neuse.slam.association import AssociationParams
from neuse.slam.library import ObjectLibrary, similarity
from neuse.slam.prior_map import PriorMap
from neuse.slam.track import LastSighting, Track


def adopt(
    prior: PriorMap,
    matches: Mapping[int, int],
    library: ObjectLibrary,
    drift: Array,
    params: AssociationParams,
) -> list[Track]:
    """Take over the objects of a map that are not known yet; the tracks that stand for them.

    matches: {track key: object id} of tracks of the library that are such objects.
    drift: the tracker's drift clock.
    """
    here = {track.object_id for track in library.active()}
    left = [(track.object_id, track.place[0]) for track in library.tracks.values() if track.retired]
    own = {object_id: library.tracks[key] for key, object_id in matches.items()}
    adopted = []
    for i, (object_id, code) in enumerate(prior.codes.items()):
        if object_id in own:
            track = own[object_id]
            track.object_id, track.confirmed = object_id, True
            adopted.append(track)
        elif object_id not in here and not _has_left(object_id, code.center, left, params.delta_prox_m):
            # one of its own objects, under another name, may be the one with this code in the map
            near = library.table.at(library.table.near(code.center, params.delta_prox_m))
            named = [track for track in near if track.object_id != NO_ID]
            if (similarity([code], named) >= params.delta_shape).any():
                continue
            frames = prior.frames[[i]]
            last = LastSighting(frames, code.center, np.eye(4))
            adopted.append(library.adopt(object_id, code, frames.vectors[:, 0], last, drift))
    return adopted


def _has_left(object_id: int, center: Array, left: Sequence[tuple[int, Array]], radius_m: float) -> bool:
    """Whether an object was seen to be gone from that place, which the map does not know yet."""
    return any(name == object_id and np.linalg.norm(place - center) <= radius_m for name, place in left)
