"""Shards of views in memory, and batches drawn from them as a pure function of the random generator."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neuse.embedding.cloud import core
from neuse.embedding.network import UNIT_M
from neuse.embedding.views import POINT_UNIT_M
from neuse.errors import InputError
from neuse.geometry import Array
from neuse.symmetry import BOX, Symmetry

ONE_FAR_IN = 8  # queries: that one lies outside the object's box, for the decoder to know that it is empty
SURFACE_POINTS = 512  # of a shard's, which are kept
PER_VIEW = ("points", "partial_center", "T_camera_object", "visible", "handle", "noise_m")
PER_SHAPE = ("queries", "occupied", "surface", "extents")


class Batch(NamedTuple):
    """Views in network units (0.1 m), relative to each view's partial centre.

    points (B, N, 3); target (B, 3, 4) true centre and scaled axes; shape (B,) index; queries (B, Q, 3),
    occupied (B, Q); surface (B, S, 3) points of the whole object; view (B,) index in the ViewSet.
    """

    points: Tensor
    target: Tensor
    shape: Tensor
    queries: Tensor
    occupied: Tensor
    surface: Tensor
    view: Tensor

    def to(self, device: torch.device) -> "Batch":
        """The batch on another device."""
        return Batch(*(tensor.to(device, non_blocking=True) for tensor in self))


class ViewSet:
    """All views of some shards."""

    def __init__(self, paths: Sequence[Path], symmetry: Symmetry) -> None:
        shards = [_read(path) for path in paths]
        offsets = np.cumsum([0] + [len(shard["extents"]) for shard in shards])
        self.symmetry = symmetry
        self.shape = np.concatenate([s["shape"] + o for s, o in zip(shards, offsets, strict=False)])
        self.arrays = {name: np.concatenate([s[name] for s in shards]) for name in PER_VIEW + PER_SHAPE}
        order = np.argsort(self.shape, kind="stable")
        _, starts = np.unique(self.shape[order], return_index=True)
        self._views_of = np.split(order, starts[1:])  # of every shape that has any

    def __len__(self) -> int:
        return len(self.shape)

    @property
    def n_shapes(self) -> int:
        """Shapes that have views."""
        return len(self._views_of)

    def draw(
        self,
        rng: np.random.Generator,
        n_shapes: int,
        n_views: int,
        n_points: int,
        n_queries: int,
        n_surface: int = 0,
    ) -> Batch:
        """A random batch of `n_views` views of each of `n_shapes` shapes, randomly stretched.

        Raises:
            InputError: there are fewer shapes.
        """
        if n_shapes > self.n_shapes:
            raise InputError("few_shapes", f"{n_shapes} shapes a batch asked of {self.n_shapes}; add shards")
        shapes = rng.choice(self.n_shapes, n_shapes, replace=False)
        views_of = [self._views_of[shape] for shape in shapes]
        index = np.concatenate([rng.choice(views, n_views, len(views) < n_views) for views in views_of])
        scales = np.repeat(self._draw_scales(n_shapes, rng), n_views, axis=0)
        return self.batch(index, n_points, n_queries, rng, scales, n_surface)

    def batch(
        self,
        index: np.ndarray,
        n_points: int,
        n_queries: int,
        rng: np.random.Generator,
        scales: np.ndarray | None = None,
        n_surface: int = 0,
    ) -> Batch:
        """The views `index`, their objects scaled by (B, 3) factors along the axes of the object frame."""
        scales = np.ones((len(index), 3)) if scales is None else scales
        a, shape = self.arrays, self.shape[index]
        R = a["T_camera_object"][index][:, :3, :3]
        stretch = (R * scales[:, None]) @ R.transpose(0, 2, 1)  # (B, 3, 3) symmetric, camera axes
        offset = a["T_camera_object"][index][:, :3, 3] - a["partial_center"][index]
        center = np.einsum("bij,bj->bi", stretch, offset)  # about the stretched partial centre
        first = rng.integers(0, a["points"].shape[1] - n_points + 1)
        points = a["points"][index, first : first + n_points] * np.float32(POINT_UNIT_M) @ stretch
        axes = R * (a["extents"][shape] * scales)[:, None]
        if self.symmetry.ambiguous:
            axes = axes * [0.0, 0.0, 1.0]
        queries, occupied = self._queries(shape, n_queries, rng)
        surface = a["surface"][shape[:, None], rng.integers(0, a["surface"].shape[1], n_surface)]

        def seen(points_object: Array) -> Tensor:
            return _tensor(points_object * scales[:, None] @ R.transpose(0, 2, 1) + center[:, None])

        return Batch(
            _tensor(points),
            _tensor(np.concatenate([center[..., None], axes], -1)),
            torch.from_numpy(shape.astype(np.int64)),
            seen(queries),
            torch.from_numpy(occupied),
            seen(surface),
            torch.from_numpy(index),
        )

    def _draw_scales(self, n: int, rng: np.random.Generator) -> np.ndarray:
        """(n, 3) factors along the axes of the object frame, such that the symmetry stays."""
        if self.symmetry is BOX:
            return np.exp(rng.uniform(-0.22, 0.22, (n, 3)))
        stretch = np.exp(rng.uniform([-0.22, -0.15], [0.22, 0.15], (n, 2)))
        return np.stack([stretch[:, 0], stretch[:, 0], stretch.prod(1)], -1)

    def _queries(self, shape: np.ndarray, n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """(B, n, 3) points of the object frame, some of them far, and whether they are inside."""
        a = self.arrays
        chosen = rng.integers(0, a["queries"].shape[1], n)
        queries, occupied = (a[name][shape[:, None], chosen] for name in ("queries", "occupied"))
        n_far = n // ONE_FAR_IN
        queries[:, :n_far] = _far_points(a["extents"][shape], n_far, rng)
        occupied[:, :n_far] = False
        return queries, occupied


def _read(path: Path) -> dict[str, np.ndarray]:
    """A shard without background points, which the front end drops, recentred."""
    with np.load(path) as file:
        shard = {name: file[name] for name in (*PER_VIEW, *PER_SHAPE, "shape")}
    points_m = shard["points"] * np.float32(POINT_UNIT_M)
    kept = core(points_m)
    rank = np.argsort(~kept, axis=1, kind="stable")  # core points first, order kept
    repeated = np.arange(points_m.shape[1])[None] % kept.sum(axis=1)[:, None]
    points_m = np.take_along_axis(points_m, np.take_along_axis(rank, repeated, 1)[..., None], 1)
    shift = points_m.mean(axis=1)
    points = np.round((points_m - shift[:, None]) / POINT_UNIT_M).astype(np.int16)
    center, surface = shard["partial_center"] + shift, shard["surface"][:, :SURFACE_POINTS]
    return shard | {"points": points, "partial_center": center, "surface": surface}


def _far_points(extents: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """(B, n, 3) points outside boxes of half sizes (B, 3), up to three times as far, object frame."""
    direction = rng.normal(size=(len(extents), n, 3))
    direction /= np.abs(direction).max(axis=-1, keepdims=True)
    return direction * rng.uniform(1.05, 3.0, (len(extents), n, 1)) * extents[:, None]


def _tensor(metres: np.ndarray) -> Tensor:
    """In network units."""
    return torch.from_numpy(np.ascontiguousarray(metres / UNIT_M, dtype=np.float32))
