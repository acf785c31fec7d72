"""Where a session stands in a map that it did not make: by the layout of the objects it sees (NeuSE IV-B).

Pairs of a track of the session and an object of the map that are alike in shape are vertices of a graph;
edges join pairs whose mutual distance, axes and offsets agree, and the largest clique is the answer. Unlike
within a session there is no expectation of the pose, so that chance has to be ruled out: a layout counts only
if so few would agree so well by chance in this very map (an a-contrario test), if no other one rivals it, and
if more objects are in their places than are not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import comb

import numpy as np
from scipy.spatial.distance import cdist

from neuse.errors import DegenerateGeometryError
from neuse.geometry import Array, transform_points
from neuse.params import CheckedParams, param
from neuse.slam.clique import match_weights, max_weight_clique
from neuse.slam.layout import angles_between
from neuse.slam.library import similarity
from neuse.slam.object_frames import HIDDEN_HANDLE_RAD, ObjectFrames, frames_at
from neuse.slam.prior_map import PriorMap
from neuse.slam.registration import Alignment, align_frames
from neuse.slam.track import Track, heights_of, places_of, sigmas_of

TRACK_SIGMAS = np.array([0.03, 0.03, 0.15, 0.005, 0.005, 0.005])  # of places, as ObjectFrames.sigmas
LEAN = 0.1  # of axes, as a share of the distance to another object
NEIGHBOURHOOD_M = 0.3  # in which objects stand as densely as they do where there are any
FITTED = (
    2.0  # a pose fitted to objects has them that much nearer to their places than another object would be
)
PRECISION_M = 0.005  # two that agree better than this do so by chance


@dataclass(frozen=True)
class RelocalizationParams(CheckedParams):
    """When a session is believed to stand in a known map."""

    min_sightings: int = param(3, "an object of the session counts when it was seen so often", 1, 1000)
    max_objects: int = param(12, "objects of the session that are looked at, the last seen first", 3, 100)
    max_drift_m: float = param(
        0.05, "objects that drift may have moved further within the session do not count, metres", 0.0, 10.0
    )
    similarity_min: float = param(0.9, "least cosine of descriptors of one object", -1.0, 1.0)
    max_candidates: int = param(10, "most similar objects of the map that are tried for each", 1, 1000)
    tolerance_m: float = param(0.02, "distances and heights are equal within this, metres", 0.001, 1.0)
    tolerance_rad: float = param(0.3, "angles between axes are equal within this, rad", 0.01, 3.15)
    tolerance_handle_rad: float = param(
        0.5, "the bearing of others, seen from a handle, is equal within this, rad", 0.01, 3.15
    )
    max_rms_m: float = param(0.015, "residual of the whole layout, metres", 0.001, 1.0)
    max_false_alarms: float = param(
        0.003, "so many layouts like this may be expected to agree by chance", 0.0, 1.0
    )
    confirmations: int = param(3, "times in a row that the same place must be found", 1, 100)
    max_sigma_m: float = param(0.04, "the camera's position there is known within this, metres", 1e-3, 10.0)
    max_sigma_rad: float = param(0.03, "and its rotation within this, rad", 1e-3, 3.15)


@dataclass(frozen=True)
class Place:
    """Where a session stands: p_map = T_map_session @ p_session.

    covariance: (6, 6) of it as in neuse.geometry.    matches: {track key: object id of the map}.
    false_alarms: how many layouts as good as this one are to be expected by chance.
    """

    T_map_session: Array
    covariance: Array
    matches: dict[int, int]
    false_alarms: float


def find_place(tracks: Sequence[Track], prior: PriorMap, params: RelocalizationParams) -> Place | None:
    """The place where most objects of a session agree with the map; None if there is none or a doubt."""
    tracks = tracks[: params.max_objects]
    if len(tracks) < 3 or len(prior) < 3:
        return None
    seen, shapes = _frames_of(tracks), similarity(tracks, list(prior.codes.values()))
    rows, columns = _candidates(shapes, seen, prior.frames, params)
    agree = same_arrangement(seen[rows], prior.frames[columns], params)
    agree &= (rows[:, None] != rows) & (columns[:, None] != columns)
    weights = match_weights(shapes[rows, columns])
    clique = np.array(max_weight_clique(agree, weights, rows), dtype=np.intp)
    if len(clique) < 3 or _has_rival(clique, agree, weights, rows):
        return None
    alignment = _alignment(seen[rows[clique]], prior.frames[columns[clique]], params)
    if alignment is None:
        return None
    placed = transform_points(alignment.T_b_a, seen.centers)
    matches = _explained(placed, prior, shapes, params)
    off_m = float(np.linalg.norm(placed[rows[clique]] - prior.centers[columns[clique]], axis=1).max())
    within_m = min(max(FITTED * off_m, PRECISION_M), params.tolerance_m)
    false_alarms = _false_alarms(len(clique), agree, rows, len(tracks), prior, within_m)
    contradicting = _n_contradicting(tracks, prior, placed, matches)
    if false_alarms > params.max_false_alarms or len(matches) <= contradicting:
        return None
    named = {tracks[row].key: prior.ids[column] for row, column in matches.items()}
    return Place(alignment.T_b_a, alignment.covariance, named, false_alarms)


def same_arrangement(here: ObjectFrames, there: ObjectFrames, params: RelocalizationParams) -> np.ndarray:
    """(p, p) bool, whether two of p pairs (object here, object there) lie alike to each other.

    Their distance, the angle of their axes, the height of one above the other along its axis, and the bearing
    of one as seen from the other's handle; of what tells no axis the distance alone.
    """
    offsets_here, offsets_there = _offsets(here), _offsets(there)
    distances_m = np.linalg.norm(offsets_here, axis=-1)
    agree = np.abs(distances_m - np.linalg.norm(offsets_there, axis=-1)) <= params.tolerance_m
    told = here.tell_axes & there.tell_axes
    turns_rad = np.abs(angles_between(here.axes) - angles_between(there.axes))
    agree &= (turns_rad <= params.tolerance_rad) | ~(told[:, None] & told)
    rises = offsets_here[..., 2] - offsets_there[..., 2]
    alike = np.abs(rises) <= params.tolerance_m + LEAN * distances_m
    sideways_m = np.linalg.norm((offsets_here - offsets_there)[..., :2], axis=-1)
    turned = sideways_m > params.tolerance_m + params.tolerance_handle_rad * distances_m
    handles = (here.variances[2] <= HIDDEN_HANDLE_RAD**2) & (there.variances[2] <= HIDDEN_HANDLE_RAD**2)
    alike &= ~(turned & handles[:, None])
    alike |= ~told[:, None]
    return agree & alike & alike.T


def _offsets(frames: ObjectFrames) -> Array:
    """(p, p, 3) centres of all objects as seen from each object's own frame (handle, side, axis)."""
    between = frames.centers[None] - frames.centers[:, None]
    handles = frames.vectors[2]
    R = np.stack([handles, np.cross(frames.axes, handles), frames.axes], axis=1)  # (p, 3, 3), rows are axes
    return between @ R.transpose(0, 2, 1)


def _frames_of(tracks: Sequence[Track]) -> ObjectFrames:
    """Where a session's objects stand, frame `session`."""
    ambiguous = np.array([track.ambiguous for track in tracks], dtype=bool)
    sigmas = sigmas_of(tracks, TRACK_SIGMAS)
    frames = frames_at(places_of(tracks), sigmas, ambiguous, heights_of(tracks)[0])
    weights = np.array([track.place_weights[2] for track in tracks])
    frames.variances[2] = np.maximum(frames.variances[2], 1.0 / np.maximum(weights, 1e-12))
    return frames


def _candidates(
    shapes: Array, seen: ObjectFrames, known: ObjectFrames, params: RelocalizationParams
) -> tuple[np.ndarray, np.ndarray]:
    """(p,) rows and (p,) columns of pairs alike in shape and height, the most similar of each row."""
    heights = np.abs(seen.half_heights[:, None] - known.half_heights) <= params.tolerance_m
    heights |= ~(seen.tell_axes[:, None] & known.tell_axes)
    alike = np.where(heights & (shapes >= params.similarity_min), shapes, -np.inf)
    order = np.argsort(-alike, axis=1, kind="stable")[:, : params.max_candidates]
    rows = np.repeat(np.arange(len(seen)), order.shape[1])
    columns = order.ravel()
    chosen = np.isfinite(alike[rows, columns])
    return rows[chosen], columns[chosen]


def _has_rival(clique: np.ndarray, agree: np.ndarray, weights: Array, rows: np.ndarray) -> bool:
    """Whether another layout that shares no pair with this one is as large, or nearly so and large enough."""
    rest = np.setdiff1d(np.arange(len(rows)), clique)
    rival = max_weight_clique(agree[np.ix_(rest, rest)], weights[rest], rows[rest])
    return len(rival) >= min(len(clique), max(len(clique) - 1, 4))


def _alignment(seen: ObjectFrames, known: ObjectFrames, params: RelocalizationParams) -> Alignment | None:
    """T_map_session that puts objects in their places in the map, None unless all fit."""
    at_places = frames_at(known.vectors, TRACK_SIGMAS, known.ambiguous, known.half_heights)
    try:
        alignment = align_frames(seen, at_places)
    except DegenerateGeometryError:
        return None
    fits = alignment.residual_m <= params.max_rms_m and 2 * alignment.n_objects > len(seen)
    return alignment if fits else None


def _explained(placed: Array, prior: PriorMap, shapes: Array, params: RelocalizationParams) -> dict[int, int]:
    """{row: column} of what stands in the place of an object of the map and is like it, nearest first.

    placed: (n, 3) centres of the session's objects, metres, frame `map`.
    """
    distances_m = np.linalg.norm(placed[:, None] - prior.centers[None], axis=-1)
    near = (distances_m <= 2 * params.tolerance_m) & (shapes >= params.similarity_min)
    matches: dict[int, int] = {}
    for row, column in sorted(np.argwhere(near).tolist(), key=lambda pair: distances_m[pair[0], pair[1]]):
        if row not in matches and column not in matches.values():
            matches[row] = column
    return matches


def _n_contradicting(
    tracks: Sequence[Track], prior: PriorMap, placed: Array, matches: Mapping[int, int]
) -> int:
    """How many objects are not where the other of map and session has them.

    Either may be young and lack what its camera has not seen yet. So what one of them has alone speaks
    against a place only as far as the other one, too, has objects alone there.
    """
    new = sum(track.confirmed and row not in matches for row, track in enumerate(tracks))
    near = (cdist(prior.centers, placed) <= NEIGHBOURHOOD_M).any(axis=1)
    return min(new, int(near.sum()) - len(matches))


def _false_alarms(
    n: int, agree: np.ndarray, rows: np.ndarray, n_tracks: int, prior: PriorMap, within_m: float
) -> float:
    """Layouts of n objects, all within so much of their places, to be expected if this were another place.

    Two pairs that agree give a pose, right or wrong. Under a wrong one a further object of the session finds
    one of its candidates where it looks for it as often as there is one in so small a part of a table.
    """
    poses = agree.sum() / 2
    density = (1.0 + prior.neighbours(NEIGHBOURHOOD_M)) / NEIGHBOURHOOD_M**2  # objects in pi m^2
    share = len(rows) / n_tracks / len(prior)  # of the objects that are candidates of one of the session
    chance = min(share * density * within_m**2, 1.0)
    return float(poses * comb(n_tracks - 2, n - 2) * chance ** (n - 2))
