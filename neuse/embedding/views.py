"""Partial views of a shape among clutter, under the sensor's and the segmenter's faults (NeuSE III-D)."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from neuse.embedding.layouts import Layout
from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.records import Intrinsics
from neuse.simulation.camera import DepthCamera
from neuse.simulation.sensor import SensorFaults, apply_faults
from neuse.simulation.shapes import Shape
from neuse.symmetry import NONE

CAMERA = DepthCamera(Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5))
HALF_CAMERA = DepthCamera(Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5))
HALF_CAMERA_BELOW_M = 0.9  # it sees as many points as are kept, up close
BESIDE_LENS_M = 0.05  # what reaches nearer has an outline of no end
MAX_POINTS = 1024
MIN_POINTS = 40
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


def draw_view(layout: Layout, rng: np.random.Generator, params: ViewParams) -> dict[str, np.ndarray] | None:
    """One view of the principal shape; None when too little of it is seen.

    Returns:
        points (MAX_POINTS, 3) int16 in steps of POINT_UNIT_M about `partial_center`, random order, repeated
        where fewer than that (n_points) were seen; partial_center (3,); T_camera_object (4, 4); visible share
        of the object's outline, hidden by others or cut by the image border alike; handle share of the seen
        points; noise_m.
    """
    T_camera_object, range_m = _draw_pose(layout, rng, params)
    T_world_camera = layout.T_world_object @ inverse(T_camera_object)
    camera = HALF_CAMERA if range_m < HALF_CAMERA_BELOW_M else CAMERA
    vertices = transform_points(T_camera_object, layout.shape.mesh.vertices)
    window = camera.window_around(vertices, margin_px=8)
    if window is None or vertices[:, 2].min() < BESIDE_LENS_M:
        return None
    rendering = camera.render(layout.scene, T_world_camera, window)
    faults = _draw_faults(range_m, rng, params)
    depth_m, mask = apply_faults(rendering.depth_m, rendering.label, faults, rng)
    rays = camera.rays(window)
    cloud = _points(rays, depth_m, (mask == 1) & (depth_m > 0))
    if len(cloud) < MIN_POINTS:
        return None
    surface = _points(rays, rendering.depth_m, rendering.label == 1)
    outline_px = max(camera.silhouette_px(layout.alone, T_world_camera, vertices), 1)
    return _packed(cloud, rng) | {
        "T_camera_object": T_camera_object.astype(np.float32),
        "visible": np.float32(len(surface) / outline_px),
        "handle": np.float32(handle_share(layout.shape, transform_points(inverse(T_camera_object), surface))),
        "noise_m": np.float32(faults.noise_m_at_1m * range_m**2),
    }


def _draw_pose(layout: Layout, rng: np.random.Generator, params: ViewParams) -> tuple[Array, float]:
    """T_camera_object, and the range of the origin of the layout."""
    lowest_deg = max(params.elevation_deg[0], 4.0) if layout.on_table else params.elevation_deg[0]
    elevation = np.radians(rng.triangular(lowest_deg, 20.0, params.elevation_deg[1]))
    range_m = float(np.exp(rng.uniform(*np.log(params.range_m))))
    azimuth = rng.uniform(0, 2 * np.pi)
    if layout.clutter_azimuths and rng.random() < params.behind_clutter:
        azimuth = rng.choice(layout.clutter_azimuths) + rng.uniform(-0.4, 0.4)
    return draw_camera(azimuth, elevation, range_m, rng) @ layout.T_world_object, range_m


def _points(rays: np.ndarray, depth_m: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(n, 3) camera-frame points of the chosen pixels; rays (h, w, 3), depth and choice (h, w)."""
    return rays[chosen] * depth_m[chosen][:, None]


def _packed(cloud: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A cloud as `points`, `n_points` and `partial_center` of `draw_view`."""
    partial_center = cloud.mean(axis=0)
    order = np.resize(rng.permutation(len(cloud)), MAX_POINTS)
    steps = np.clip((cloud[order] - partial_center) / POINT_UNIT_M, -32767, 32767)
    return {
        "points": steps.astype(np.int16),
        "n_points": np.int32(len(cloud)),
        "partial_center": partial_center.astype(np.float32),
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
    if shape.symmetry is not NONE or len(points_object) == 0:
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
