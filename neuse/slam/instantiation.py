"""Which observations are followed, and which become objects of the map (NeuSE appendix).

An object of the map was seen near, large and three times in a row. Until then a track is tentative, but it
constrains poses as well: objects far ahead bridge the way from table to table.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.records import Observation
from neuse.slam.association import GATE_SIGMAS
from neuse.slam.track import Track


@dataclass(frozen=True)
class InstantiationParams(CheckedParams):
    """What it takes to become an object."""

    trackable_sigma_m: float = param(
        0.03, "an observation whose centre is known no better is not followed, metres", 1e-4, 10.0
    )
    max_range_m: float = param(2.0, "no further from the camera, metres (paper: 2)", 0.01, 100.0)
    min_mask_px: int = param(
        500, "no smaller mask, pixels: a vial at 1 m and 640 x 480 (paper: 4000)", 1, 100000000
    )
    min_sightings: int = param(
        3,
        "seen so often in a row, of any size to constrain poses, near and large to be mapped (paper: 3)",
        1,
        1000,
    )
    doubtful_sightings: int = param(
        10, "the same while it may be a known object seen from a drifted pose", 1, 1000
    )
    max_gap_frames: int = param(
        2, "frames that may miss a tentative object without breaking the row", 0, 1000
    )
    allow_border: bool = param(False, "count sightings that touch the border of the image")


def is_trackable(observation: Observation, params: InstantiationParams) -> bool:
    """Whether an unknown object is followed from now on, be it too far, small or cut for the map."""
    return float(np.max(observation.code.sigmas[3:])) <= params.trackable_sigma_m


def is_eligible(observation: Observation, params: InstantiationParams) -> bool:
    """Whether this observation is good enough to count."""
    return (
        observation.range_m <= params.max_range_m
        and observation.mask_px >= params.min_mask_px
        and (params.allow_border or not observation.touches_border)
    )


def expired(tracks: Iterable[Track], frame_index: int, params: InstantiationParams) -> list[Track]:
    """Tentative tracks whose row of sightings is broken."""
    return [
        track
        for track in tracks
        if not track.confirmed and frame_index - track.last_frame > params.max_gap_frames + 1
    ]


def is_due(track: Track, doubtful: bool, params: InstantiationParams) -> bool:
    """Whether a tentative track becomes an object now."""
    needed = max(params.min_sightings, params.doubtful_sightings if doubtful else 0)
    return not track.confirmed and track.n_eligible >= needed


def may_be_known(
    track: Track, shapes: Array, others: Sequence[Track], drift: Array, matched: set[int], delta_prox_m: float
) -> bool:
    """Whether a tentative track may be a known object that drift has moved, so that it should wait.

    Args:
        shapes: (m,) whether each of `others` is alike in shape.    drift: (m, 2), see drift.py.
        matched: keys of tracks that are seen elsewhere in this very frame.
    """
    for m, other in enumerate(others):
        if shapes[m] and other.confirmed and other.key not in matched:
            gate_m = known_gates_m(drift[m], delta_prox_m)
            if np.linalg.norm(other.place[0] - track.place[0]) <= gate_m:
                return True
    return False


def known_gates_m(drift: Array, delta_prox_m: float) -> Array:
    """(...) how far off known objects may be seen after drifts (..., 2), metres."""
    return delta_prox_m + GATE_SIGMAS * np.sqrt(drift[..., 1])
