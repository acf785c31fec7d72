"""Pictures of a training run: curves, and reconstructions beside what was seen and what is true."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from neuse.embedding.dataset import ViewSet
from neuse.embedding.embedding import Embedding
from neuse.embedding.network import UNIT_M, Network
from neuse.errors import InputError
from neuse.geometry import Array, inverse, transform_points

LOSSES = ("frame", "transform", "occupancy", "shape", "sigma")
N_VIEWS = 6
RESOLUTION_M = 0.006
R_PICTURE_OBJECT = np.array([[0.9, -0.44, 0.0], [0.15, 0.31, 0.94]])  # from the side, a little from above


def save_curves(history: Sequence[dict[str, float]], path: Path) -> None:
    """One panel a loss or figure over the steps."""
    names = [name for name in history[0] if name != "step"]
    figure = Figure(figsize=(12, 7))
    figure.subplots_adjust(0.04, 0.05, 0.99, 0.95, hspace=0.35)
    rows = -(-len(names) // 4)
    for axes, name in zip(figure.subplots(rows, 4, squeeze=False).flat, names, strict=False):
        axes.plot([row["step"] for row in history], [row.get(name, np.nan) for row in history], marker=".")
        axes.set_title(f"{name} (loss)" if name in LOSSES else name)
    for axes in figure.axes[len(names) :]:
        axes.set_axis_off()
    FigureCanvasAgg(figure).print_png(path)


def save_reconstructions(network: Network, views: ViewSet, path: Path) -> None:
    """What was seen, what it decodes to, and the true shape, of a few held-out views in the object frame."""
    figure = Figure(figsize=(2.2 * N_VIEWS, 7), layout="constrained")
    panels = figure.subplots(3, N_VIEWS)
    index = np.linspace(0, len(views) - 1, N_VIEWS).astype(int)
    batch = views.batch(index, network.config.n_points, 1, np.random.default_rng(0), n_surface=512)
    poses = views.arrays["T_camera_object"][index].astype(np.float64)
    poses[:, :3, 3] = batch.target[..., 0].numpy() * UNIT_M  # about the partial centre
    for column, T_view_object in enumerate(poses):
        seen, true = (tensor[column].double().numpy() * UNIT_M for tensor in (batch.points, batch.surface))
        T_object_view = inverse(T_view_object)
        reach_m = 1.1 * float(np.abs(transform_points(T_object_view, true)).max())
        rows = {"seen": seen, "decoded": _decoded(network, seen), "true": true}
        for axes, (title, points) in zip(panels[:, column], rows.items(), strict=True):
            _draw_points(axes, transform_points(T_object_view, points), reach_m)
            axes.set_title(title, fontsize=9)
    FigureCanvasAgg(figure).print_png(path)


def _decoded(network: Network, points: Array) -> Array:
    """(n, 3) surface points of the reconstruction, none where there is nothing."""
    embedding = Embedding(network)
    try:
        mesh = embedding.reconstruct(embedding.encode([points])[0], RESOLUTION_M)
    except InputError:
        return np.empty((0, 3))
    return np.asarray(trimesh.sample.sample_surface(mesh, 2048, seed=0)[0])


def _draw_points(axes: Axes, points_object: Array, reach_m: float) -> None:
    """Points of the object frame, the nearer the darker."""
    x, y = points_object @ R_PICTURE_OBJECT.T[:, 0], points_object @ R_PICTURE_OBJECT.T[:, 1]
    towards = points_object @ np.cross(*R_PICTURE_OBJECT)
    order = np.argsort(towards)
    axes.scatter(x[order], y[order], c=towards[order], s=2, cmap="viridis_r")
    axes.set(xlim=(-reach_m, reach_m), ylim=(-reach_m, reach_m), aspect="equal", xticks=[], yticks=[])
