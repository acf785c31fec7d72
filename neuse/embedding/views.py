"""Training data: partial views of shapes among clutter, under the sensor's and the segmenter's faults (NeuSE
III-D).

A shard holds the views of a few shapes as plain arrays (npz without pickles), so that a run can be stopped
and resumed and several processes can fill one folder. Shards of a split are fixed by category, split and
seed alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.records import Intrinsics
from neuse.simulation.camera import DepthCamera, RayScene, Solid
from neuse.simulation.sensor import SensorFaults, apply_faults
from neuse.simulation.shapes import Shape, categories, sample_shape

CAMERA = DepthCamera(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
HALF_CAMERA = DepthCamera(Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5))
HALF_CAMERA_BELOW_M = 0.9  # it sees as many points as are kept, up close
SPLIT_SEEDS = {"train": 1, "validation": 2, "test": 3}
MAX_POINTS = 1024
MIN_POINTS = 40
CLUTTER_SHAPES = 10  # of each category, shared by the layouts of a shard
POINT_UNIT_M = 5e-5  # stored as int16 steps: 1.6 m to either side of the partial centre


@dataclass(frozen=True)
class ViewParams:
    """How views are drawn. Ranges are uniform unless said otherwise."""

    views_per_shape: int = 16
    shapes_per_shard: int = 25
    range_m: tuple[float, float] = (0.3, 5.0)  # log-uniform
    elevation_deg: tuple[float, float] = (-15.0, 85.0)  # triangular about 20
    clutter: tuple[int, int] = (1, 5)
    fixed_noise_m: float | None = None  # for evaluation: this depth noise at any range, no other faults
    mask_faults: bool = True
    behind_clutter: float = 0.35  # share of the views with some other object before the principal one


@dataclass(frozen=True)
class Layout:
    """A principal shape (label 1) among clutter in a room; on a table at z = 0 of the world or in the air."""

    shape: Shape
    T_world_object: Array
    on_table: bool
    clutter_azimuths: tuple[float, ...]
    scene: RayScene
    alone: RayScene


def ensure_shards(folder: Path, category: str, split: str, n_shards: int, params: ViewParams) -> list[Path]:
    """The first `n_shards` shards of a split, generating those that are missing."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{category}_{split}_{index:04d}.npz" for index in range(n_shards)]
    missing = [index for index, path in enumerate(paths) if not path.exists()]
    for index in tqdm(missing, desc=f"views of {category} ({split})", unit="shard", disable=not missing):
        generate_shard(paths[index], category, split, index, params)
    return paths


def generate_shard(
    path: Path, category: str, split: str, index: int, params: ViewParams, seed: int = 0
) -> None:
    """Draw the shapes and views of one shard and write them to `path` (atomically)."""
    rng = np.random.default_rng([SPLIT_SEEDS[split], seed, index, *category.encode()])
    shapes = [sample_shape(category, rng, split) for _ in range(params.shapes_per_shard)]
    others = [sample_shape(other, rng, split) for other in categories() for _ in range(CLUTTER_SHAPES)]
    write_shard(path, shapes, others, params, rng)


def write_shard(
    path: Path,
    shapes: Sequence[Shape],
    others: Sequence[Shape],
    params: ViewParams,
    rng: np.random.Generator,
) -> None:
    """Views of `shapes` among `others`, and occupancy samples, as one npz.

    The fields are those of `draw_view` a view, of `sample_occupancy` a shape, the view's `shape` index and
    `extents`.
    """
    views: list[dict[str, np.ndarray]] = []
    for shape_index, shape in enumerate(shapes):
        layout = draw_layout(shape, others, rng, params)
        tries = (draw_view(layout, rng, params) for _ in range(4 * params.views_per_shape))
        seen = islice((view for view in tries if view is not None), params.views_per_shape)
        views += [view | {"shape": np.int32(shape_index)} for view in seen]
    arrays = {name: np.stack([view[name] for view in views]) for name in views[0]}
    occupancy = [sample_occupancy(shape.mesh, rng) for shape in shapes]
    arrays |= {name: np.stack([sample[name] for sample in occupancy]) for name in occupancy[0]}
    arrays["extents"] = np.stack([shape.extents for shape in shapes]).astype(np.float32)
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, **arrays)  # type: ignore[arg-type]
    partial.rename(path)


def draw_layout(
    shape: Shape, others: Sequence[Shape], rng: np.random.Generator, params: ViewParams
) -> Layout:
    """The shape and its clutter, each upright, lying or (the shape alone, at times) in any pose."""
    T_world_object = rest(shape, rng, anyhow=0.2)
    solids = [Solid(shape.mesh, T_world_object, 1)]
    reach = reach_m(shape, T_world_object)
    azimuths = []
    for label in range(2, 2 + rng.integers(params.clutter[0], params.clutter[1] + 1)):
        other = others[int(rng.integers(len(others)))]
        T_world_other = rest(other, rng, anyhow=0.0)
        distance = reach + reach_m(other, T_world_other) + rng.uniform(0.003, 0.08)
        azimuths.append(float(rng.uniform(0, 2 * np.pi)))
        T_world_other[:2, 3] = distance * np.array([np.cos(azimuths[-1]), np.sin(azimuths[-1])])
        solids.append(Solid(other.mesh, T_world_other, label))
    on_table = bool(rng.random() < 0.6)
    scene = RayScene([*solids, *room(rng, on_table)])
    return Layout(shape, T_world_object, on_table, tuple(azimuths), scene, RayScene(solids[:1]))


def rest(shape: Shape, rng: np.random.Generator, anyhow: float) -> Array:
    """T_world_object with the axis of the object through the origin and its lowest point on z = 0."""
    choice = rng.random()
    if choice < anyhow:
        R = Rotation.random(random_state=rng)
    else:
        tilt = 90.0 if choice > 0.65 else 0.0
        R = Rotation.from_euler("zxz", [rng.uniform(0, 360), tilt, rng.uniform(0, 360)], degrees=True)
    T = make_transform(R.as_matrix(), np.zeros(3))
    T[2, 3] = -transform_points(T, shape.mesh.vertices)[:, 2].min()
    return T


def reach_m(shape: Shape, T_world_object: Array) -> float:
    """Radius about the world's z axis of a shape at its place."""
    return float(np.linalg.norm((shape.mesh.vertices @ T_world_object[:3, :3].T)[:, :2], axis=1).max())


def room(rng: np.random.Generator, on_table: bool) -> list[Solid]:
    """Floor and walls, and perhaps a table top: what flying pixels and swollen masks catch."""
    top = trimesh.creation.box([rng.uniform(0.5, 1.5), rng.uniform(0.5, 1.5), 0.03])
    walls = trimesh.creation.box([rng.uniform(3, 12), rng.uniform(3, 12), 3.0])
    walls.invert()
    shift = rng.uniform(-0.15, 0.15, 2)
    room = [Solid(walls, make_transform(np.eye(3), [0, 0, 0.75]))]
    return [*room, Solid(top, make_transform(np.eye(3), [*shift, -0.0151]))] if on_table else room


def draw_view(layout: Layout, rng: np.random.Generator, params: ViewParams) -> dict[str, np.ndarray] | None:
    """One view of the principal shape; None when too little of it is seen.

    Returns:
        points (MAX_POINTS, 3) int16 in steps of POINT_UNIT_M about `partial_center`, random order, repeated
        where fewer were seen; n_points; partial_center (3,); T_camera_object (4, 4); visible share of the
        object's outline, hidden by others or cut by the image border alike; handle share of the seen points;
        noise_m.
    """
    lowest_deg = max(params.elevation_deg[0], 4.0) if layout.on_table else params.elevation_deg[0]
    elevation = np.radians(rng.triangular(lowest_deg, 20.0, params.elevation_deg[1]))
    range_m = float(np.exp(rng.uniform(*np.log(params.range_m))))
    azimuth = rng.uniform(0, 2 * np.pi)
    if rng.random() < params.behind_clutter:
        azimuth = rng.choice(layout.clutter_azimuths) + rng.uniform(-0.4, 0.4)
    T_camera_object = draw_camera(azimuth, elevation, range_m, rng) @ layout.T_world_object
    camera = HALF_CAMERA if range_m < HALF_CAMERA_BELOW_M else CAMERA
    vertices = transform_points(T_camera_object, layout.shape.mesh.vertices)
    window = camera.window_around(vertices, margin_px=8)
    if window is None:
        return None
    T_world_camera = layout.T_world_object @ inverse(T_camera_object)
    rendering = camera.render(layout.scene, T_world_camera, window)
    faults = _draw_faults(range_m, rng, params)
    depth_m, mask = apply_faults(rendering.depth_m, rendering.label, faults, rng)
    seen = (mask == 1) & (depth_m > 0)
    n_points = int(seen.sum())
    if n_points < MIN_POINTS:
        return None
    cloud = camera.rays(window)[seen] * depth_m[seen][:, None]
    partial_center = cloud.mean(axis=0)
    order = np.resize(rng.permutation(n_points), MAX_POINTS)
    steps = np.clip((cloud[order] - partial_center) / POINT_UNIT_M, -32767, 32767)
    true_surface = (
        camera.rays(window)[rendering.label == 1] * rendering.depth_m[rendering.label == 1][:, None]
    )
    return {
        "points": steps.astype(np.int16),
        "n_points": np.int32(n_points),
        "partial_center": partial_center.astype(np.float32),
        "T_camera_object": T_camera_object.astype(np.float32),
        "visible": np.float32(
            len(true_surface) / max(camera.silhouette_px(layout.alone, T_world_camera, vertices), 1)
        ),
        "handle": np.float32(
            handle_share(layout.shape, transform_points(inverse(T_camera_object), true_surface))
        ),
        "noise_m": np.float32(faults.noise_m_at_1m * range_m**2),
    }


def draw_camera(azimuth: float, elevation: float, range_m: float, rng: np.random.Generator) -> Array:
    """T_camera_world seen from the world's origin in this direction; the origin is somewhere in the image."""
    roll = rng.uniform(-0.3, 0.3)
    aim = Rotation.from_euler("yx", rng.uniform([-0.35, -0.25], [0.35, 0.25]))  # origin off the image centre
    look = Rotation.from_euler("ZX", [azimuth + np.pi / 2, -np.pi / 2 - elevation])  # optical z to the origin
    R_camera_world = aim * Rotation.from_euler("z", roll) * look.inv()
    return make_transform(R_camera_world.as_matrix(), aim.apply([0, 0, range_m]))


def handle_share(shape: Shape, points_object: Array) -> float:
    """Share of surface points that are on a handle: beyond the body's radius on the +x side."""
    if shape.ambiguous or len(points_object) == 0:
        return 0.0
    return float(np.mean(points_object[:, 0] > 1.05 * shape.extents[1]))


def _draw_faults(range_m: float, rng: np.random.Generator, params: ViewParams) -> SensorFaults:
    """Noise constant or growing with range squared, at times smooth; a third of the views has all others."""
    if params.fixed_noise_m is not None:
        noise = SensorFaults(noise_m_at_1m=min(params.fixed_noise_m / range_m**2, 0.1))
        faulty = replace(noise, erosion_px=2, dilation_px=1, cut_rate=0.2, merge_rate=0.1)
        return faulty if params.mask_faults else noise
    at_1m = rng.uniform(0, 0.0025) if rng.random() < 0.6 else rng.uniform(0, 0.0035) / range_m**2
    smooth = int(rng.choice([1, 3], p=[0.7, 0.3]))
    if rng.random() > 0.35 or not params.mask_faults:
        return SensorFaults(noise_m_at_1m=at_1m, noise_grain_px=smooth)
    return SensorFaults(
        noise_m_at_1m=at_1m,
        noise_grain_px=smooth,
        quantisation_m=0.001,
        baseline_px_m=30.0 if rng.random() < 0.5 else 0.0,
        hole_rate=rng.uniform(0, 3),
        hole_radius_px=6.0,
        flying_rate=rng.uniform(0, 0.4),
        edge_hole_rate=rng.uniform(0, 0.3),
        erosion_px=3,
        dilation_px=2,
        cut_rate=0.15,
        merge_rate=0.05,
    )


def sample_occupancy(mesh: trimesh.Trimesh, rng: np.random.Generator, n: int = 4096) -> dict[str, np.ndarray]:
    """Query points about a shape, object frame, and whether they are inside; drawn by place, not by answer.

    Half of them lie within 2 mm and a quarter within 10 mm (standard deviations) of the surface, a quarter
    in the enlarged box. Also 2048 points of the surface.
    """
    surface, _ = trimesh.sample.sample_surface(mesh, 3 * n // 4, seed=int(rng.integers(2**31)))
    spread = np.repeat([0.002, 0.010], [n // 2, n // 4])[:, None]
    near = surface + rng.normal(size=surface.shape) * spread
    low, high = mesh.bounds
    margin = 0.25 * (high - low) + 0.01
    queries = np.concatenate([near, rng.uniform(low - margin, high + margin, (n - len(near), 3))])
    order = rng.permutation(n)
    return {
        "queries": queries[order].astype(np.float32),
        "occupied": mesh.contains(queries)[order],
        "surface": surface[rng.permutation(len(surface))[:2048]].astype(np.float32),
    }
