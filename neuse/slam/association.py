"""Data association: which known object is each observation (NeuSE IV-B, by consistency of the whole frame).

The paper matches one object at a time, and for a lone mug its test is nearly vacuous: the transform that is
tested comes from the very pair (see nearest.py). Here all objects of a frame vote together: pairs of
observation and track that agree in shape and lie within the place gate are vertices of a graph, edges join
pairs with equal mutual distance and direction, and the heaviest clique is the answer. The gate opens with the
drift since an object was seen; the wider it is, the more objects must agree. Without any prior pose, three
must, and more where drift cannot explain how far that moves the camera.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from neuse.errors import DegenerateGeometryError
from neuse.geometry import Array, inverse, rotation_angle
from neuse.params import CheckedParams, param
from neuse.slam.checks import check_choice
from neuse.slam.clique import LIKENESS, match_weights, max_weight_clique
from neuse.slam.layout import Pairs, View, same_directions, same_layout
from neuse.slam.library import alike_in_place, similarity
from neuse.slam.localization import Belief, to_camera
from neuse.slam.object_frames import frames_at
from neuse.slam.registration import align_frames
from neuse.slam.track import Track, heights_of, places_of

GATE_SIGMAS = 3.0
PLACE_GATE_SIGMAS = 4.0  # in three dimensions one in a thousand lies further off, and 3 in a hundred beyond 3
JOINT_GATE_SIGMAS = 6.0  # several objects that agree may lie further off than one alone
LEAST_APART = 2  # objects that show that a part of the map has drifted
PLACE_SIGMAS = np.array(
    [0.02, 0.02, 0.1, 0.005, 0.005, 0.005]
)  # of the library's objects, as ObjectFrames.sigmas


@dataclass(frozen=True)
class AssociationParams(CheckedParams):
    """When an observation is a known object."""

    method: str = param(
        "clique", "clique: all objects of a frame together; nearest: the paper's rule, one by one"
    )
    delta_shape: float = param(0.95, "least cosine of descriptors of one object (paper: 0.95)", -1.0, 1.0)
    max_unlikeness: float = param(
        7.0, "1 - cosine of descriptors that an object at its place may show, in units of its noise", 0.1, 1e6
    )
    delta_prox_m: float = param(
        0.03, "place gate for a perfectly known camera pose, metres (paper: 0.03)", 0.001, 1.0
    )
    max_gate_m: float = param(1.0, "the place gate opens no wider, metres", 0.01, 100.0)
    alone_gate_m: float = param(0.25, "up to this gate one object may match alone, metres", 0.0, 100.0)
    open_gate_m: float = param(
        0.1, "an object that drift may have moved further does not match by its nearness, metres", 0.0, 100.0
    )
    pair_gate_m: float = param(0.8, "up to this gate two objects may match together, metres", 0.0, 100.0)
    clique_tolerance_m: float = param(0.02, "two distances are equal within this, metres", 0.001, 1.0)
    clique_tolerance_rad: float = param(
        0.35, "two angles between axes are equal within this, rad", 0.01, 3.15
    )
    max_rms_m: float = param(0.015, "residual of a match without prior pose, metres", 0.001, 1.0)
    certain_objects: int = param(
        5, "so many objects that agree without prior pose are believed, however far they move it", 3, 1000
    )
    max_candidates: int = param(
        20, "most similar tracks considered per observation without prior pose", 1, 1000
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("method", self.method, ("clique", "nearest"))


@dataclass(frozen=True)
class Association:
    """tracks: the match of every observation, or None.    T_map_camera: set where it was found anew.

    apart: matches that agree with each other, but lie off those: drift has shifted this part of the map.
    """

    tracks: tuple[Track | None, ...]
    T_map_camera: Array | None = None
    apart: tuple[Track | None, ...] = ()


def associate(
    view: View,
    tracks: Sequence[Track],
    drift: Array,
    prediction: Belief,
    params: AssociationParams,
    frame_index: int,
) -> Association:
    """Match the observations of a frame jointly.

    Args:
        drift: (m, 2) variances (rad^2, m^2) of the camera relative to each track (see drift.py).
        prediction: the expected camera pose; its uncertainty is in `drift`.
    """
    places, shapes = places_of(tracks), similarity(view.codes, tracks)
    alike = alike_in_place(view.codes, view.rivals, tracks, params.max_unlikeness, frame_index)
    pairs = _tracked_pairs(view, places, shapes, alike, drift, prediction.T_map_camera, params)
    matches = _heaviest_tracked(view, places, pairs, drift, prediction.T_map_camera, params)
    free = [i for i in range(len(view)) if i not in matches or not tracks[matches[i]].confirmed]
    found, T_map_camera = _relocalize(view, tracks, places, shapes, free, matches, params)
    if T_map_camera is not None and _is_plausible(
        T_map_camera, prediction.T_map_camera, drift, found, params
    ):
        return Association(_as_tuple(matches | found, tracks, len(view)), T_map_camera)
    rest = ~np.isin(pairs.rows, list(matches)) & ~np.isin(pairs.columns, list(matches.values()))
    old = np.array([tracks[m].confirmed for m in pairs.columns], dtype=bool)
    second = _heaviest_tracked(view, places, pairs.only(rest & old), drift, prediction.T_map_camera, params)
    second = second if len(second) >= LEAST_APART else {}
    return Association(_as_tuple(matches, tracks, len(view)), None, _as_tuple(second, tracks, len(view)))


def _as_tuple(matches: dict[int, int], tracks: Sequence[Track], n: int) -> tuple[Track | None, ...]:
    return tuple(tracks[matches[i]] if i in matches else None for i in range(n))


def square_ranges(view: View) -> Array:
    """(n,) squared distances of the observations from the camera, m^2."""
    return (view.frames.centers**2).sum(axis=1)


def _tracked_pairs(
    view: View,
    places: Array,
    shapes: Array,
    alike: np.ndarray,
    drift: Array,
    T_map_camera: Array,
    params: AssociationParams,
) -> Pairs:
    """Pairs alike in shape and within the place gate that the drift since the last sight opens.

    Not too far beyond that gate objects may match in company; their gate is infinite.
    """
    seen = to_camera(T_map_camera, places)[0]
    offsets_m = np.linalg.norm(view.frames.centers[:, None] - seen[None], axis=-1)
    square_range = square_ranges(view)[:, None]
    variances = drift[None, :, 1] + drift[None, :, 0] * square_range + view.frames.variances[0][:, None]
    wide_m = np.minimum(params.delta_prox_m + JOINT_GATE_SIGMAS * np.sqrt(variances), params.max_gate_m)
    gates_m = np.minimum(params.delta_prox_m + PLACE_GATE_SIGMAS * np.sqrt(variances), params.max_gate_m)
    gates_m = np.where(offsets_m <= gates_m, gates_m, np.inf)
    pair = rows, columns = np.nonzero(alike & (offsets_m <= wide_m))
    nearness = 1.0 - offsets_m[pair] / wide_m[pair]
    weights = match_weights(shapes[pair]) + LIKENESS * nearness
    return Pairs(rows, columns, gates_m[pair], weights)


def _heaviest_tracked(
    view: View, places: Array, pairs: Pairs, drift: Array, T_map_camera: Array, params: AssociationParams
) -> dict[int, int]:
    """{row: column} of the heaviest clique, empty where too few objects agree for so wide a gate."""
    consistent = same_layout(view, places, pairs, params.clique_tolerance_m, params.clique_tolerance_rad)
    turns_rad = GATE_SIGMAS * np.sqrt(drift[pairs.columns, 0])
    consistent &= same_directions(view, places, pairs, T_map_camera, turns_rad, params.clique_tolerance_m)
    for usable in (np.arange(len(pairs.rows)), np.flatnonzero(np.isfinite(pairs.gates_m))):
        found = max_weight_clique(
            consistent[np.ix_(usable, usable)], pairs.weights[usable], pairs.rows[usable]
        )
        clique = usable[found]
        if len(clique) and _is_enough(clique, pairs, params):
            return {int(pairs.rows[v]): int(pairs.columns[v]) for v in clique}
    return {}


def _is_enough(clique: np.ndarray, pairs: Pairs, params: AssociationParams) -> bool:
    """Whether so many objects are evidence; a lone object with two possible places is none."""
    places = (pairs.rows == pairs.rows[clique[0]]) & np.isfinite(pairs.gates_m)
    if len(clique) == 1 and places.sum() > 1:
        return False
    return len(clique) >= _needed(float(pairs.gates_m[clique].min()), params)


def _needed(gate_m: float, params: AssociationParams) -> int:
    """How many objects must agree."""
    if gate_m <= params.alone_gate_m:
        return 1
    return 2 if gate_m <= params.pair_gate_m else 3


def _relocalize(
    view: View,
    tracks: Sequence[Track],
    places: Array,
    shapes: Array,
    free: list[int],
    matches: dict[int, int],
    params: AssociationParams,
) -> tuple[dict[int, int], Array | None]:
    """Match observations that no expected place explains by their layout alone; three must agree."""
    if len(free) < 3:
        return {}, None
    pairs = _shape_pairs(tracks, shapes, free, set(matches.values()), params)
    consistent = same_layout(view, places, pairs, params.clique_tolerance_m, params.clique_tolerance_rad)
    clique = max_weight_clique(consistent, pairs.weights, pairs.rows)
    if len(clique) < 3 or _has_rival(clique, consistent, pairs):
        return {}, None
    T_map_camera = _verified_pose(view, tracks, pairs.rows[clique], pairs.columns[clique], params)
    found = {int(pairs.rows[v]): int(pairs.columns[v]) for v in clique}
    return (found, T_map_camera) if T_map_camera is not None else ({}, None)


def _shape_pairs(
    tracks: Sequence[Track], shapes: Array, free: list[int], taken: set[int], params: AssociationParams
) -> Pairs:
    usable = np.array([track.confirmed and m not in taken for m, track in enumerate(tracks)], dtype=bool)
    rows: list[int] = []
    columns: list[int] = []
    for i in free:
        alike = np.flatnonzero(usable & (shapes[i] >= params.delta_shape))
        best = alike[np.argsort(-shapes[i, alike], kind="stable")][: params.max_candidates]
        rows += [i] * len(best)
        columns += best.tolist()
    pair = np.array(rows, dtype=np.intp), np.array(columns, dtype=np.intp)
    return Pairs(*pair, np.full(len(rows), np.inf), match_weights(shapes[pair]))


def _has_rival(clique: list[int], consistent: np.ndarray, pairs: Pairs) -> bool:
    """Whether an equally large clique matches all of these observations differently."""
    rest = np.setdiff1d(np.arange(len(pairs.rows)), clique)
    rival = max_weight_clique(consistent[np.ix_(rest, rest)], pairs.weights[rest], pairs.rows[rest])
    return len(rival) >= len(clique)


def _verified_pose(
    view: View, tracks: Sequence[Track], rows: np.ndarray, columns: np.ndarray, params: AssociationParams
) -> Array | None:
    """T_map_camera that maps the observations onto the places of the tracks, None unless all fit."""
    seen, matched = view.frames[rows], [tracks[m] for m in columns.tolist()]
    known = frames_at(places_of(matched), PLACE_SIGMAS, seen.ambiguous, heights_of(matched)[0])
    try:
        alignment = align_frames(seen, known)
    except DegenerateGeometryError:
        return None
    fits = alignment.residual_m <= params.max_rms_m and alignment.inliers.all()
    return alignment.T_b_a if fits else None


def _is_plausible(
    T_map_camera: Array, T_predicted: Array, drift: Array, found: dict[int, int], params: AssociationParams
) -> bool:
    """Whether drift can explain the correction, or more objects than chance could lay out ask for it."""
    if len(found) >= params.certain_objects:
        return True
    correction = inverse(T_predicted) @ T_map_camera
    turn_rad, shift_m = GATE_SIGMAS * np.sqrt(drift[list(found.values())].max(axis=0))
    return bool(
        rotation_angle(correction[:3, :3]) <= params.clique_tolerance_rad + turn_rad
        and np.linalg.norm(correction[:3, 3]) <= params.max_gate_m + shift_m
    )
