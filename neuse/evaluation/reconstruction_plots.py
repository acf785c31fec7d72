"""Figure of frames with what was decoded from each alone: masks, shapes over the picture, close-ups."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuse.evaluation.reconstructions import ENCLOSED_M, ReconstructedFrame, ReconstructedObject
from neuse.evaluation.render import SUPERSAMPLING, ColoredMesh, render, view_obliquely
from neuse.geometry import Array, inverse, make_transform, transform_points
from neuse.records import Intrinsics, RgbdFrame
from neuse.simulation.camera import NOTHING, DepthCamera, RayScene, Solid, Window

Color = tuple[float, float, float]
COLORS: tuple[Color, ...] = (
    *((0.35, 0.58, 0.88), (0.95, 0.62, 0.25), (0.42, 0.74, 0.45)),
    *((0.80, 0.48, 0.75), (0.78, 0.72, 0.30)),
)
NEAR_COLOR, FAR_COLOR = "black", "red"
MAX_CLOSE_UPS = 3
CLOSE_UP_PX = 260
ELEVATION_RAD, TURN_RAD = np.deg2rad(28.0), np.deg2rad(35.0)
MARGIN_PX = 30
OPACITY = 0.85
GREY_RANGE_M = 3.0
# Optical frame (z forward, y down) turned so that z points up, for the lamp of the renderer.
R_UPRIGHT_CAMERA = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])


@dataclass(frozen=True)
class PinholeView:
    """A window (u0, v0, u1, v1) of the picture that a camera at the origin took; for `render`."""

    intrinsics: Intrinsics
    window: Window
    T_world_camera: Array

    def rays(self) -> tuple[np.ndarray, np.ndarray]:
        """(n, 3) float32 origins and directions, row by row, supersampled."""
        u0, v0, _, _ = self.window
        (height, width), camera = self.shape_px, self.intrinsics
        x = ((np.arange(width) + 0.5) / SUPERSAMPLING - 0.5 + u0 - camera.cx) / camera.fx
        y = ((np.arange(height) + 0.5) / SUPERSAMPLING - 0.5 + v0 - camera.cy) / camera.fy
        rays = np.stack([*np.meshgrid(x, y), np.ones((height, width))], axis=-1).reshape(-1, 3)
        directions = (rays @ self.T_world_camera[:3, :3].T).astype(np.float32)
        return np.zeros_like(directions), directions

    @property
    def shape_px(self) -> tuple[int, int]:
        """(height, width) of the supersampled window."""
        u0, v0, u1, v1 = self.window
        return (v1 - v0) * SUPERSAMPLING, (u1 - u0) * SUPERSAMPLING


def reconstruction_figure(frames: Sequence[ReconstructedFrame]) -> Figure:
    """A row a frame: the picture with the masks, the decoded shapes over it, close-ups of the largest."""
    n_rows, ratios = max(len(frames), 1), [4 / 3, 4 / 3, *[1.0] * MAX_CLOSE_UPS]
    figure = Figure(figsize=(3.2 * sum(ratios), 3.4 * n_rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(n_rows, len(ratios), width_ratios=ratios, squeeze=False)
    for axes in grid.flat:
        axes.set_axis_off()
    for row, frame in zip(grid, frames, strict=False):
        _draw_pictures(row[0], row[1], frame)
        for axes, index in zip(row[2:], _largest(frame), strict=False):
            _draw_close_up(axes, frame.objects[index], _color(index))
    return figure


def _draw_pictures(left: Axes, right: Axes, frame: ReconstructedFrame) -> None:
    """Around the masks: their outlines on the left, the decoded shapes over the picture on the right."""
    u0, v0, u1, v1 = window = _window(frame)
    picture, mask = _picture(frame.frame)[v0:v1, u0:u1], frame.frame.mask[v0:v1, u0:u1]
    left.imshow(picture)
    right.imshow(_with_shapes(picture, frame, window))
    for index, item in enumerate(frame.objects):
        own = mask == item.observation.label
        left.contour(own, levels=[0.5], colors=[_color(index)], linewidths=1.2)
        rows, columns = np.nonzero(own)
        place, name = (columns.mean(), rows.mean()), str(item.observation.label)
        left.annotate(name, place, ha="center", va="center", color="white", fontsize=9)
    left.set_title(f"masks, {frame.frame.stamp_ns / 1e9:.1f} s", fontsize=9)
    right.set_title("shapes decoded from this view alone", fontsize=9)


def _draw_close_up(axes: Axes, item: ReconstructedObject, color: Color) -> None:
    """The shape upright in its own frame, seen from beside the camera, with the points before it."""
    T_object_camera = inverse(item.observation.code.T_frame_object)
    mesh = item.mesh.copy().apply_transform(T_object_camera)
    points, eye = transform_points(T_object_camera, item.points), T_object_camera[:3, 3]
    azimuth_rad = float(np.arctan2(eye[1], eye[0])) + TURN_RAD
    view = view_obliquely(
        np.concatenate([mesh.vertices, points]), azimuth_rad, ELEVATION_RAD, 0.01, CLOSE_UP_PX
    )
    axes.imshow(render([ColoredMesh(mesh, color)], view))
    shown = _is_before(mesh, points, -view.T_world_camera[:3, 2])
    for chosen, shade in ((item.near, NEAR_COLOR), (~item.near, FAR_COLOR)):
        axes.plot(*view.project(points[chosen & shown]).T, ".", color=shade, markersize=0.8)
    seen = item.observation
    axes.set_title(f"{seen.label}: {seen.code.category}, {item.enclosed_share:.0%}", fontsize=9)


def _is_before(mesh: trimesh.Trimesh, points: Array, outward: Array) -> np.ndarray:
    """Which points (n, 3) the mesh does not hide from a viewer far away in the direction `outward`."""
    lifted = points + ENCLOSED_M * outward  # those just behind the surface are shown
    directions = np.broadcast_to(outward.astype(np.float32), lifted.shape)
    return RayScene([Solid(mesh, np.eye(4))]).cast(lifted, directions)["geomID"] == NOTHING


def _largest(frame: ReconstructedFrame) -> list[int]:
    """Indices of the objects with the largest masks, in the order of the frame."""
    order = sorted(range(len(frame.objects)), key=lambda i: -frame.objects[i].observation.mask_px)
    return sorted(order[:MAX_CLOSE_UPS])


def _picture(frame: RgbdFrame) -> np.ndarray:
    """(h, w, 3) uint8: the colour image, or the depth in grey where there is none of its size."""
    if frame.color is not None and frame.color.shape[:2] == frame.depth_m.shape:
        return frame.color
    depth_m = np.nan_to_num(frame.depth_m, posinf=0.0)
    grey = np.where(depth_m > 0, 1.0 - np.clip(depth_m / GREY_RANGE_M, 0.0, 0.9), 0.0)
    return np.repeat((255 * grey).astype(np.uint8)[..., None], 3, axis=2)


def _with_shapes(picture: np.ndarray, frame: ReconstructedFrame, window: Window) -> np.ndarray:
    """The window's picture with the meshes drawn over it."""
    if not frame.objects:
        return picture
    T_upright_camera = make_transform(R_UPRIGHT_CAMERA, np.zeros(3))
    meshes = [item.mesh.copy().apply_transform(T_upright_camera) for item in frame.objects]
    colored = [ColoredMesh(mesh, _color(index)) for index, mesh in enumerate(meshes)]
    shaded = render(colored, PinholeView(frame.frame.intrinsics, window, T_upright_camera))
    scene = RayScene([Solid(mesh, np.eye(4)) for mesh in meshes])
    seen = DepthCamera(frame.frame.intrinsics).render(scene, T_upright_camera, window)
    opacity = OPACITY * (seen.solid != NOTHING)[..., None]
    return (opacity * shaded + (1 - opacity) * picture).astype(np.uint8)


def _window(frame: ReconstructedFrame) -> Window:
    """Box of 4 : 3 around the masks, as large as the image allows."""
    height, width = frame.frame.mask.shape
    rows, columns = np.nonzero(np.isin(frame.frame.mask, [o.observation.label for o in frame.objects]))
    if not len(rows):
        return 0, 0, width, height
    half_v = max(np.ptp(rows), np.ptp(columns) * 3 / 4) / 2 + MARGIN_PX
    u0, u1 = _span((columns.min() + columns.max()) / 2, half_v * 4 / 3, width)
    v0, v1 = _span((rows.min() + rows.max()) / 2, half_v, height)
    return u0, v0, u1, v1


def _span(middle: float, half: float, size: int) -> tuple[int, int]:
    """Interval of length 2 half around `middle`, moved or cut so that it lies in [0, size]."""
    start = max(min(middle - half, size - 2 * half), 0.0)
    return int(start), min(int(start + 2 * half) + 1, size)


def _color(index: int) -> Color:
    return COLORS[index % len(COLORS)]
