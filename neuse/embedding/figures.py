"""Errors of codes against the truth: single objects, objects jointly, descriptors, shapes, uncertainties."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from neuse.embedding.code import Code
from neuse.embedding.embedding import Embedding
from neuse.embedding.horn import align_latents
from neuse.embedding.sightings import Sighting
from neuse.embedding.validation import HANDLE_SEEN, equal_error_rate
from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, inverse, log, rotation_angle, transform_points
from neuse.slam.object_frames import SigmaParams, reduce_codes
from neuse.slam.registration import agreed_heights, align


@dataclass(frozen=True)
class PairError:
    """Error of a relative pose from two views of the same objects.

    angle_deg: of the rotation; for a lone bottle of its axis.    shift_m: of the objects' mean true centre.
    view_change_deg: between the directions from which the objects are seen.    nees: over all 6 directions,
    or None.
    """

    angle_deg: float
    shift_m: float
    nees: float | None
    view_change_deg: float
    range_m: float
    visible: float
    handle: float


Pose = tuple[Array, Array | None]  # T_b_a and its covariance, if that is known
Registration = Callable[[Sequence[Code], Sequence[Code]], Pose | None]


def by_frames(codes_a: Sequence[Code], codes_b: Sequence[Code]) -> Pose | None:
    """The relative pose by the frames and sigmas of shipped codes; None where a rotation stays free."""
    try:
        alignment = align(codes_a, codes_b)
    except DegenerateGeometryError:
        return None
    return alignment.T_b_a, alignment.covariance


def by_latents(codes_a: Sequence[Code], codes_b: Sequence[Code]) -> Pose | None:
    """The relative pose as the paper has it: Horn over all latent points."""
    return align_latents(codes_a, codes_b), None


def pair_errors(
    sightings: Sequence[Sighting], n_each: dict[str, int], register: Registration = by_frames
) -> list[PairError]:
    """Errors over all pairs of views of a scene; the first `n_each[category]` common objects jointly."""
    errors = []
    by_view: dict[int, dict[int, Sighting]] = {}
    for sighting in sightings:
        by_view.setdefault(sighting.view, {})[id(sighting.shape)] = sighting
    for a, b in combinations(by_view.values(), 2):
        groups = [
            [(a[key], b[key]) for key in a if key in b and a[key].code.category == category]
            for category in n_each
        ]
        if all(len(group) >= n for group, n in zip(groups, n_each.values(), strict=True)):
            pairs = [pair for group, n in zip(groups, n_each.values(), strict=True) for pair in group[:n]]
            seen_a, seen_b = zip(*pairs, strict=True)
            error = _pair_error(seen_a, seen_b, register)
            errors += [error] if error is not None else []
    return errors


def _pair_error(a: Sequence[Sighting], b: Sequence[Sighting], register: Registration) -> PairError | None:
    T_b_a = b[0].T_camera_object @ inverse(a[0].T_camera_object)
    centers_a, centers_b = (np.stack([s.T_camera_object[:3, 3] for s in side]) for side in (a, b))
    measured = _errors(a, b, T_b_a, register)
    if measured is None:
        return None
    return PairError(
        *measured,
        view_change_deg=_angle(T_b_a[:3, :3] @ centers_a.mean(axis=0), centers_b.mean(axis=0)),
        range_m=max(s.range_m for s in (*a, *b)),
        visible=min(s.visible for s in (*a, *b)),
        handle=min(s.handle for s in (*a, *b)),
    )


def _errors(
    a: Sequence[Sighting], b: Sequence[Sighting], T_b_a: Array, register: Registration
) -> tuple[float, float, float | None] | None:
    """Rotation (deg), translation (m) and NEES; of a lone bottle that of its axis and centre."""
    lone = len(a) == 1 and a[0].code.ambiguous
    codes_a, codes_b = [s.code for s in a], [s.code for s in b]
    if lone and register is by_frames:  # its codes say where the axis is, and no more
        angle_deg = _angle(T_b_a[:3, :3] @ codes_a[0].axes[:, 2], codes_b[0].axes[:, 2])
        frames_a, frames_b = (reduce_codes(codes, SigmaParams(scale=1.0)) for codes in (codes_a, codes_b))
        center_b = frames_b.centers[0] + agreed_heights(frames_a, frames_b)[0][0]
        return angle_deg, float(np.linalg.norm(transform_points(T_b_a, codes_a[0].center) - center_b)), None
    pose = register(codes_a, codes_b)
    if pose is None:
        return None
    found, covariance = pose
    middle = np.mean([s.T_camera_object[:3, 3] for s in a], axis=0)
    shift_m = float(np.linalg.norm(transform_points(found, middle) - transform_points(T_b_a, middle)))
    if lone:
        axis_a, axis_b = (s.T_camera_object[:3, 2] for s in (a[0], b[0]))
        return _angle(found[:3, :3] @ axis_a, axis_b), shift_m, None
    angle_deg = float(np.degrees(rotation_angle(found[:3, :3].T @ T_b_a[:3, :3])))
    if covariance is None:
        return angle_deg, shift_m, None
    xi = log(inverse(found) @ T_b_a)
    return angle_deg, shift_m, float(xi @ np.linalg.solve(covariance, xi))


def frame_figures(sightings: Sequence[Sighting]) -> dict[str, dict[str, float]]:
    """Errors of the object frames of single views: direction of the axis and of seen handles, and centre."""
    seen = [s for s in sightings if s.handle > HANDLE_SEEN]

    def angles(chosen: Sequence[Sighting], axis: int) -> list[float]:
        return [_angle(s.code.T_frame_object[:3, axis], _true_axes(s)[:, axis]) for s in chosen]

    shifts_m = [float(np.linalg.norm(s.code.center - s.T_camera_object[:3, 3])) for s in sightings]
    return {
        "axis_deg": spread(angles(sightings, 2)),
        "handle_deg": spread(angles(seen, 0)),
        "centre_mm": spread([1e3 * shift_m for shift_m in shifts_m]),
    }


def _true_axes(sighting: Sighting) -> Array:
    """(3, 3) axes of the object, camera frame; of those that look alike the ones nearest to the code."""
    equivalent = sighting.T_camera_object[:3, :3] @ sighting.shape.symmetry.turns
    return equivalent[np.einsum("gij,ij->g", equivalent, sighting.code.T_frame_object[:3, :3]).argmax()]


def _angle(a: Array, b: Array) -> float:
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def spread(values: Sequence[float]) -> dict[str, float]:
    """n, median and 90th percentile; NaN of nothing."""
    if len(values) == 0:
        return {"n": 0, "median": float("nan"), "p90": float("nan")}
    return {
        "n": len(values),
        "median": float(np.median(values)),
        "p90": float(np.percentile(values, 90)),
    }


def summarise(
    errors: Sequence[PairError], low_deg: float = 0.0, high_deg: float = 180.0
) -> dict[str, object]:
    """Rotation (deg) and translation (mm) of the pairs whose view changes by this much."""
    chosen = [e for e in errors if low_deg <= e.view_change_deg <= high_deg]
    return {
        "rotation_deg": spread([e.angle_deg for e in chosen]),
        "translation_mm": spread([1e3 * e.shift_m for e in chosen]),
    }


def handle_seen(errors: Sequence[PairError]) -> list[PairError]:
    """Pairs whose mugs show their handles in both views."""
    return [e for e in errors if e.handle > HANDLE_SEEN]


def flip_rate(errors: Sequence[PairError]) -> dict[str, float]:
    """Share of pairs over 45 degrees wrong, under 3.3 m and at least 60 % visible."""
    fair = [e for e in errors if e.range_m < 3.3 and e.visible >= 0.6]
    wrong = sum(e.angle_deg > 45 for e in fair)
    return {"n": len(fair), "rate": wrong / len(fair) if fair else float("nan")}


def nees_by_bin(errors: Sequence[PairError]) -> dict[str, dict[str, float]]:
    """Mean and median NEES per degree of freedom by view change and visibility."""
    bins = {}
    for low, high in ((0, 30), (30, 60), (60, 120), (120, 180)):
        for name, fits in (("visible", lambda v: v >= 0.6), ("occluded", lambda v: v < 0.6)):
            nees = [
                e.nees / 6
                for e in errors
                if e.nees is not None and low <= e.view_change_deg < high and fits(e.visible)
            ]
            mean = float(np.mean(nees)) if nees else float("nan")
            bins[f"{low}-{high} deg, {name}"] = spread(nees) | {"mean": mean}
    return bins


def descriptor_figures(sightings: Sequence[Sighting], rng: np.random.Generator) -> dict[str, float]:
    """Equal error rate over all pairs, and how often the right one of eight shapes is the most alike.

    n counts the views of the retrieval; figures that nothing can be said of are NaN.
    """
    if not sightings:
        return {"n": 0, "eer": float("nan"), "retrieval": float("nan")}
    keys = {key: index for index, key in enumerate(dict.fromkeys(id(s.shape) for s in sightings))}
    shape = np.array([keys[id(s.shape)] for s in sightings])
    descriptor = np.stack([s.code.descriptor for s in sightings])
    hits = []
    for i in range(len(sightings)):
        same = np.flatnonzero((shape == shape[i]) & (np.arange(len(shape)) != i))
        others = np.setdiff1d(np.unique(shape), shape[i])
        if len(same) and len(others) >= 7:
            rivals = [rng.choice(np.flatnonzero(shape == s)) for s in rng.choice(others, 7, replace=False)]
            likeness = descriptor[[rng.choice(same), *rivals]] @ descriptor[i]
            hits.append(bool(likeness.argmax() == 0))
    retrieval = float(np.mean(hits)) if hits else float("nan")
    return {"n": len(hits), "eer": equal_error_rate(descriptor, shape), "retrieval": retrieval}


def shape_figures(
    embedding: Embedding, sightings: Sequence[Sighting], rng: np.random.Generator
) -> dict[str, object]:
    """Reconstructions against true shapes: IoU of the solids and mean surface distance, both ways."""
    ious, distances_mm, failed = [], [], 0
    for sighting in sightings:
        try:
            mesh = embedding.reconstruct(sighting.code)
        except InputError:
            failed += 1
            continue
        true = sighting.shape.mesh.copy().apply_transform(sighting.T_camera_object)
        ious.append(_iou(mesh, true, rng))
        distances_mm.append(1e3 * _surface_distance_m(mesh, true))
    return {"iou": spread(ious), "surface_mm": spread(distances_mm), "failed": failed}


def _iou(a: trimesh.Trimesh, b: trimesh.Trimesh, rng: np.random.Generator) -> float:
    low, high = np.minimum(a.bounds[0], b.bounds[0]), np.maximum(a.bounds[1], b.bounds[1])
    points = rng.uniform(low, high, (8192, 3))
    in_a, in_b = a.contains(points), b.contains(points)
    return float((in_a & in_b).sum() / max((in_a | in_b).sum(), 1))


def _surface_distance_m(a: trimesh.Trimesh, b: trimesh.Trimesh) -> float:
    """Mean of both directions."""
    on_a, on_b = (trimesh.sample.sample_surface(mesh, 4000, seed=0)[0] for mesh in (a, b))
    there, _ = cKDTree(on_b).query(on_a)
    back, _ = cKDTree(on_a).query(on_b)
    return 0.5 * float(there.mean() + back.mean())
