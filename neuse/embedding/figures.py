"""Errors of codes against the truth: single objects, objects jointly, descriptors, shapes, uncertainties."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import trimesh
from scipy.spatial import cKDTree

from neuse.embedding.embedding import Embedding
from neuse.embedding.sightings import Sighting
from neuse.embedding.validation import HANDLE_SEEN, equal_error_rate
from neuse.errors import DegenerateGeometryError, InputError
from neuse.geometry import Array, inverse, log, rotation_angle, transform_points
from neuse.slam.registration import align


@dataclass(frozen=True)
class PairError:
    """Error of a relative pose from two views of the same objects.

    angle_deg: of the rotation; for a lone bottle of its axis.    shift_m: of the objects' mean true centre.
    view_change_deg: between the directions from which the objects are seen.    nees: over all 6 directions,
    or None.
    """

    angle_deg: float
    shift_m: float
    view_change_deg: float
    nees: float | None
    range_m: float
    visible: float
    handle: float


def pair_errors(sightings: Sequence[Sighting], n_each: dict[str, int]) -> list[PairError]:
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
            error = _pair_error(*zip(*pairs, strict=True))
            errors += [error] if error is not None else []
    return errors


def _pair_error(a: Sequence[Sighting], b: Sequence[Sighting]) -> PairError | None:
    T_b_a = b[0].T_camera_object @ inverse(a[0].T_camera_object)
    centers_a = np.stack([s.T_camera_object[:3, 3] for s in a])
    centers_b = np.stack([s.T_camera_object[:3, 3] for s in b])
    view_change = _angle(T_b_a[:3, :3] @ centers_a.mean(axis=0), centers_b.mean(axis=0))
    if len(a) == 1 and a[0].code.ambiguous:
        angle = _angle(T_b_a[:3, :3] @ a[0].code.axes[:, 2], b[0].code.axes[:, 2])
        shift = float(np.linalg.norm(transform_points(T_b_a, a[0].code.center) - b[0].code.center))
        nees = None
    else:
        try:
            alignment = align([s.code for s in a], [s.code for s in b])
        except DegenerateGeometryError:
            return None
        angle = float(np.degrees(rotation_angle(alignment.T_b_a[:3, :3].T @ T_b_a[:3, :3])))
        middle = centers_a.mean(axis=0)
        shift = float(
            np.linalg.norm(transform_points(alignment.T_b_a, middle) - transform_points(T_b_a, middle))
        )
        xi = log(inverse(alignment.T_b_a) @ T_b_a)
        nees = float(xi @ np.linalg.solve(alignment.covariance, xi))
    both = [*a, *b]
    return PairError(
        angle,
        shift,
        view_change,
        nees,
        max(s.range_m for s in both),
        min(s.visible for s in both),
        min(s.handle for s in both),
    )


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
    """Equal error rate over all pairs, and how often the right one of eight shapes is the most alike."""
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
    return {"n": len(hits), "eer": equal_error_rate(descriptor, shape), "retrieval": float(np.mean(hits))}


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
        low = np.minimum(mesh.bounds[0], true.bounds[0])
        high = np.maximum(mesh.bounds[1], true.bounds[1])
        points = rng.uniform(low, high, (8192, 3))
        inside, inside_true = mesh.contains(points), true.contains(points)
        ious.append(float((inside & inside_true).sum() / max((inside | inside_true).sum(), 1)))
        surfaces = [trimesh.sample.sample_surface(m, 4000, seed=0)[0] for m in (mesh, true)]
        there, _ = cKDTree(surfaces[1]).query(surfaces[0])
        back, _ = cKDTree(surfaces[0]).query(surfaces[1])
        distances_mm.append(1e3 * 0.5 * float(there.mean() + back.mean()))
    return {"iou": spread(ious), "surface_mm": spread(distances_mm), "failed": failed}
