"""Figures of the report: path over ground truth, map from above with close-ups, before and after."""

from collections.abc import Sequence
from io import BytesIO

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.cluster.hierarchy import fcluster, linkage

from neuse.evaluation.map_scene import STATUS_COLORS, MapScene
from neuse.evaluation.render import View, render, view_from_above, view_obliquely
from neuse.evaluation.trajectory import Trajectory
from neuse.geometry import Array
from neuse.records import ObjectStatus

CLUSTER_GAP_M = 0.6
MAX_CLOSE_UPS = 12
CLOSE_UP_PX = 520
OVERVIEW_PX = 760
AZIMUTH_RAD, ELEVATION_RAD = np.deg2rad(-65.0), np.deg2rad(42.0)
MARGIN_M = 0.08


def trajectory_figure(path: Trajectory, truth: Trajectory | None, ate_m: Array | None) -> Figure:
    """The path from above, z up, over ground truth and coloured by its position error where that is known.

    ate_m: (n,) metres, one for each pose of `path`.
    """
    figure, axes = _figure(8, 6.5)
    if truth is not None:
        axes.plot(*truth.positions[:, :2].T, "k--", linewidth=0.9, zorder=3, label="ground truth")
    if ate_m is None:
        axes.plot(*path.positions[:, :2].T, color="tab:blue", linewidth=1.5, label="estimate")
    else:
        _add_colored_path(figure, axes, path.positions[:, :2], ate_m)
    axes.plot(*path.positions[:1, :2].T, "k^", markersize=7, label="start")
    _finish(axes, f"camera path, {path.length_m:.1f} m, {len(path)} frames")
    return figure


def map_figure(scene: MapScene, path: Trajectory) -> Figure:
    """Top view with ids and the camera's path, and a close-up of every group of objects."""
    present = _present(scene)
    groups = _groups(present)[:MAX_CLOSE_UPS]
    columns = 1 if len(groups) <= 3 else 2 if len(groups) <= 8 else 3
    rows = max(1, -(-len(groups) // columns))
    figure = _canvas(Figure(figsize=(7 + 4.6 * columns, max(6.0, 2.9 * rows)), layout="constrained"))
    grid = figure.add_gridspec(rows, columns + 1, width_ratios=[1.5, *[1.0] * columns])
    _draw_overview(figure.add_subplot(grid[:, 0]), scene, path)
    for index, group in enumerate(groups):
        axes = figure.add_subplot(grid[index % rows, 1 + index // rows])
        members = present.subset(group)
        _draw_close_up(axes, members, _close_up_view([members]), members.plane_z())
    return figure


def change_figure(before: MapScene, after: MapScene, places: Sequence[Array], title: str) -> Figure:
    """Close-ups of the map around one change, before and after it, in one view.

    places: (3,) points, picture frame, that both pictures must show.
    """
    figure = _canvas(Figure(figsize=(10, 4.2), layout="constrained"))
    scenes = [_near(_present(scene), places) for scene in (before, after)]
    view = _close_up_view(scenes, places)
    plane_z = min((scene.plane_z() for scene in scenes if scene.meshes), default=None)
    for axes, scene, name in zip(figure.subplots(1, 2), scenes, ("before", "after"), strict=True):
        _draw_close_up(axes, scene, view, plane_z)
        axes.set_title(name)
    figure.suptitle(title)
    return figure


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    stream = BytesIO()
    figure.savefig(stream, format="png", dpi=110)
    return stream.getvalue()


def _draw_overview(axes: Axes, scene: MapScene, path: Trajectory) -> None:
    """The map from above, in metres; removed objects as red crosses."""
    points = np.concatenate([path.positions, scene.centers()])
    bounds = np.stack([points.min(axis=0), points.max(axis=0)])
    extent_m = float(np.ptp(bounds[:, :2], axis=0).max()) + 0.6
    view = view_from_above(bounds, 0.3, OVERVIEW_PX / extent_m)
    (x, y), (width, height) = bounds.mean(axis=0)[:2], view.size_m
    extent = (x - width / 2, x + width / 2, y - height / 2, y + height / 2)
    axes.imshow(render(_present(scene).colored(), view, scene.plane_z()), extent=extent)
    axes.plot(*path.positions[:, :2].T, color="0.35", linewidth=0.8)
    for item, center in zip(scene.objects, scene.centers(), strict=True):
        _label_object(axes, item.object_id, center, item.status == ObjectStatus.REMOVED)
    patches = [Patch(color=color, label=status.name.lower()) for status, color in STATUS_COLORS.items()]
    axes.legend(handles=patches, loc="lower left", fontsize=8)
    _finish(axes, f"object map, {len(_present(scene).objects)} objects", legend=False)


def _label_object(axes: Axes, object_id: int, center: Array, removed: bool) -> None:
    if removed:
        color = STATUS_COLORS[ObjectStatus.REMOVED]
        axes.plot(*center[:2], "x", color=color, markersize=9, markeredgewidth=2)
    place = (center[0], center[1])
    axes.annotate(str(object_id), place, xytext=(5, 5), textcoords="offset points", fontsize=7)


def _close_up_view(scenes: Sequence[MapScene], places: Sequence[Array] = ()) -> View:
    """From the side and above, so that all objects and places fill the picture."""
    points = [mesh.bounds for scene in scenes for mesh in scene.meshes] + [np.reshape(places, (-1, 3))]
    return view_obliquely(np.concatenate(points), AZIMUTH_RAD, ELEVATION_RAD, MARGIN_M, CLOSE_UP_PX)


def _draw_close_up(axes: Axes, scene: MapScene, view: View, plane_z: float | None) -> None:
    axes.imshow(render(scene.colored(), view, plane_z))
    for item, pixel in zip(scene.objects, view.project(scene.tops()), strict=True):
        place = (pixel[0], pixel[1])
        axes.annotate(str(item.object_id), place, xytext=(0, 3), textcoords="offset points", fontsize=8)
    axes.set_axis_off()


def _groups(scene: MapScene) -> list[list[int]]:
    """Indices of objects by group (single linkage), the largest group first."""
    if len(scene.objects) < 2:
        return [[i] for i in range(len(scene.objects))]
    labels = fcluster(linkage(scene.centers()[:, :2], "single"), CLUSTER_GAP_M, criterion="distance")
    groups = [np.flatnonzero(labels == label).tolist() for label in np.unique(labels)]
    return sorted(groups, key=len, reverse=True)


def _present(scene: MapScene) -> MapScene:
    return scene.subset([i for i, o in enumerate(scene.objects) if o.status != ObjectStatus.REMOVED])


def _near(scene: MapScene, places: Sequence[Array]) -> MapScene:
    centers = scene.centers()
    near = [np.linalg.norm(centers - place, axis=1) < CLUSTER_GAP_M for place in places]
    return scene.subset(np.flatnonzero(np.any(near, axis=0)).tolist() if near else [])


def _add_colored_path(figure: Figure, axes: Axes, points: Array, values_m: Array) -> None:
    segments = np.stack([points[:-1], points[1:]], axis=1)
    between_m = (values_m[:-1] + values_m[1:]) / 2
    lines = LineCollection(list(segments), array=between_m, cmap="viridis", linewidth=2.5)
    axes.add_collection(lines)
    axes.autoscale_view()
    figure.colorbar(lines, ax=axes, label="absolute trajectory error (m)")


def _figure(width_in: float, height_in: float) -> tuple[Figure, Axes]:
    figure = _canvas(Figure(figsize=(width_in, height_in), layout="constrained"))
    return figure, figure.subplots()


def _canvas(figure: Figure) -> Figure:
    FigureCanvasAgg(figure)
    return figure


def _finish(axes: Axes, title: str, legend: bool = True) -> None:
    axes.set(title=title, xlabel="x (m)", ylabel="y (m)", aspect="equal")
    if legend:
        axes.legend(loc="best", fontsize=8)
