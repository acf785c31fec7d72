"""Shards of views in memory, and batches drawn from them as a pure function of seed and step."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from neuse.embedding.cloud import core
from neuse.embedding.network import UNIT_M
from neuse.embedding.views import POINT_UNIT_M

ONE_FAR_IN = 8  # queries: that one lies outside the object's box, for the decoder to know that it is empty
PER_VIEW = ("points", "partial_center", "T_camera_object", "visible", "handle", "noise_m", "n_points")
PER_SHAPE = ("queries", "occupied", "extents")


class Batch(NamedTuple):
    """Views in network units (0.1 m), relative to each view's partial centre.

    points (B, N, 3); target (B, 3, 4) true centre and scaled axes; shape (B,) index; queries (B, Q, 3),
    occupied (B, Q); view (B,) index in the ViewSet.
    """

    points: Tensor
    target: Tensor
    shape: Tensor
    queries: Tensor
    occupied: Tensor
    view: Tensor


class ViewSet:
    """All views of some shards."""

    def __init__(self, paths: Sequence[Path], ambiguous: bool) -> None:
        shards = [_only_core(dict(np.load(path))) for path in paths]
        offsets = np.cumsum([0] + [len(shard["extents"]) for shard in shards])
        self.ambiguous = ambiguous
        self.shape = np.concatenate([s["shape"] + o for s, o in zip(shards, offsets, strict=False)])
        self.arrays = {name: np.concatenate([s[name] for s in shards]) for name in PER_VIEW + PER_SHAPE}
        self.n_shapes = int(offsets[-1])
        order = np.argsort(self.shape, kind="stable")
        self._views_of = np.split(order, np.cumsum(np.bincount(self.shape, minlength=self.n_shapes))[:-1])

    def __len__(self) -> int:
        return len(self.shape)

    def draw(
        self, rng: np.random.Generator, n_shapes: int, n_views: int, n_points: int, n_queries: int
    ) -> Batch:
        """A random batch of `n_views` views of each of `n_shapes` shapes, randomly stretched."""
        shapes = rng.choice(self.n_shapes, n_shapes, replace=False)
        index = np.concatenate([rng.choice(self._views_of[shape], n_views) for shape in shapes])
        stretch = np.exp(rng.uniform([-0.22, -0.15], [0.22, 0.15], (n_shapes, 2)))
        scales = np.stack([stretch[:, 0], stretch[:, 0], stretch.prod(1)], -1)  # (S, 3) object frame
        return self.batch(index, n_points, n_queries, rng, np.repeat(scales, n_views, axis=0))

    def batch(
        self,
        index: np.ndarray,
        n_points: int,
        n_queries: int,
        rng: np.random.Generator,
        scales: np.ndarray | None = None,
    ) -> Batch:
        """The views `index`, their objects scaled by (B, 3) factors along the axes of the object frame."""
        scales = np.ones((len(index), 3)) if scales is None else scales
        a = self.arrays
        T, extents = a["T_camera_object"][index], a["extents"][self.shape[index]]
        R, center = (
            T[:, :3, :3],
            T[:, :3, 3] - a["partial_center"][index],
        )  # of the object, about the partial centre
        stretch = (R * scales[:, None]) @ R.transpose(0, 2, 1)  # (B, 3, 3) symmetric
        first = rng.integers(0, a["points"].shape[1] - n_points + 1)
        points = a["points"][index, first : first + n_points] * np.float32(POINT_UNIT_M) @ stretch
        center = np.einsum("bij,bj->bi", stretch, center)  # about the stretched partial centre
        axes = R * (extents * scales)[:, None]
        if self.ambiguous:
            axes = axes * [0.0, 0.0, 1.0]
        chosen = rng.integers(0, a["queries"].shape[1], n_queries)
        queries, occupied = (
            a["queries"][self.shape[index]][:, chosen],
            a["occupied"][self.shape[index]][:, chosen],
        )
        n_far = n_queries // ONE_FAR_IN
        queries[:, :n_far] = _far_points(extents, n_far, rng)
        occupied[:, :n_far] = False
        queries = queries * scales[:, None]
        queries = queries @ R.transpose(0, 2, 1) + center[:, None]
        target = np.concatenate([center[..., None], axes], -1)
        return Batch(
            _tensor(points / UNIT_M),
            _tensor(target / UNIT_M),
            torch.from_numpy(self.shape[index].astype(np.int64)),
            _tensor(queries / UNIT_M),
            torch.from_numpy(occupied),
            torch.from_numpy(index),
        )


def _only_core(shard: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Replace background points by core points, as the front end drops them, and recentre."""
    points_m = shard["points"] * np.float32(POINT_UNIT_M)
    kept = core(points_m)
    rank = np.argsort(~kept, axis=1, kind="stable")  # core points first, order kept
    repeated = np.arange(points_m.shape[1])[None] % kept.sum(axis=1)[:, None]
    points_m = np.take_along_axis(points_m, np.take_along_axis(rank, repeated, 1)[..., None], 1)
    shift = points_m.mean(axis=1)
    points = np.round((points_m - shift[:, None]) / POINT_UNIT_M).astype(np.int16)
    return shard | {"points": points, "partial_center": shard["partial_center"] + shift}


def _far_points(extents: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """(B, n, 3) points outside boxes of half sizes (B, 3), up to three times as far, object frame."""
    direction = rng.normal(size=(len(extents), n, 3))
    direction /= np.abs(direction).max(axis=-1, keepdims=True)
    return direction * rng.uniform(1.05, 3.0, (len(extents), n, 1)) * extents[:, None]


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))
