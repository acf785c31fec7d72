"""Shards: files of training views, each fixed by category, split, index and what it was drawn from alone.

A shard holds the views of a few shapes as plain arrays (npz without pickles), so that a run can be stopped
and resumed and several processes can fill one folder. It records how it was drawn, and is refused by a run
that asks for something else.
"""

import json
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict
from itertools import islice
from pathlib import Path

import numpy as np
import trimesh
from tqdm import tqdm

from neuse.embedding.layouts import draw_layout
from neuse.embedding.views import ViewParams, draw_view
from neuse.errors import InputError, MeshError
from neuse.simulation.meshes import load_category
from neuse.simulation.shapes import Shape, make_shape, sample_shape, symmetry_of
from neuse.symmetry import Symmetry

SPLIT_SEEDS = {"train": 1, "validation": 2, "test": 3}
CLUTTER = ("mug", "bottle")  # beside shapes of the category itself
CLUTTER_SHAPES = 10  # of each category, shared by the layouts of a shard
LAYOUTS_PER_SHAPE = 5  # tried until the shape is seen at all
ONE_HELD_OUT_IN = 5  # meshes of the user's own: that one is for validation
STRETCH = (0.22, 0.15)  # of the user's own meshes: log-uniform, of the whole and of the height


class ShapeSource:
    """Where the shapes of a category come from: the families of the simulator, or a folder of meshes."""

    def __init__(self, category: str, meshes: Path | None = None, symmetry: Symmetry | None = None) -> None:
        """`symmetry` is that of the meshes; see `load_meshes` for what it is where it is not told.

        Raises:
            MeshError: fewer than two meshes, one to train on and one to validate, or one that is of no use.
        """
        self.category = category
        self._meshes = load_category(meshes, category, symmetry) if meshes is not None else []
        if meshes is not None and len(self._meshes) < 2:
            raise MeshError(f"{meshes} holds {len(self._meshes)} meshes of {category}; training needs two")
        self.symmetry = self._meshes[0].symmetry if self._meshes else symmetry_of(category)

    def draw(self, n: int, split: str, rng: np.random.Generator) -> list[Shape]:
        """Shapes of a split; meshes are held out by name and stretched, each time another shape."""
        if not self._meshes:
            return [sample_shape(self.category, rng, split) for _ in range(n)]
        held_out = self._meshes[::ONE_HELD_OUT_IN]
        own = [mesh for mesh in self._meshes if (mesh in held_out) == (split != "train")]
        return [_stretched(own[i], rng) for i in np.resize(rng.permutation(len(own)), n)]

    @property
    def record(self) -> str:
        """Names the meshes by a checksum of their vertices, and a symmetry that their category's is not."""
        crcs = [zlib.crc32(np.round(shape.mesh.vertices, 6).tobytes()) for shape in self._meshes]
        shapes = f"meshes {zlib.crc32(repr(crcs).encode()):08x}" if crcs else "simulated"
        usual = self.symmetry is symmetry_of(self.category)
        return shapes if usual else f"{shapes}, symmetry {self.symmetry.name}"


def _stretched(shape: Shape, rng: np.random.Generator) -> Shape:
    whole, height = np.exp(rng.uniform(-1.0, 1.0, 2) * STRETCH)
    mesh = shape.mesh.copy().apply_scale([whole, whole, whole * height])
    return make_shape(shape.name, shape.category, mesh, shape.texture, shape.symmetry)


def ensure_shards(
    folder: Path, source: ShapeSource, split: str, n_shards: int, params: ViewParams
) -> list[Path]:
    """The first `n_shards` shards of a split, generating those that are missing.

    Raises:
        InputError: a shard in the folder was drawn from other shapes or with other parameters.
    """
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"{source.category}_{split}_{index:04d}.npz" for index in range(n_shards)]
    record = _record(source, params)
    missing = []
    for index, path in enumerate(paths):
        if path.exists():
            _check_record(path, record)
        else:
            missing.append(index)
    title = f"views of {source.category} ({split})"
    for index in tqdm(missing, desc=title, unit="shard", disable=not missing):
        generate_shard(paths[index], source, split, index, params)
    return paths


def _record(source: ShapeSource, params: ViewParams) -> str:
    return json.dumps({"shapes": source.record} | asdict(params))


def _check_record(path: Path, record: str) -> None:
    """Shards of before records were kept are taken as they are."""
    try:
        with np.load(path) as shard:
            found = str(shard["record"]) if "record" in shard else record
    except (OSError, EOFError, ValueError, zipfile.BadZipFile) as error:
        raise InputError("shard", f"{path} is no shard ({error}); delete it") from error
    if found != record:
        raise InputError(
            "shard",
            f"{path} was drawn with {found}, this run asks for {record}; "
            "delete the shards or give another --data",
        )


def generate_shard(path: Path, source: ShapeSource, split: str, index: int, params: ViewParams) -> None:
    """Draw the shapes and views of one shard and write them to `path` (atomically)."""
    rng = np.random.default_rng([SPLIT_SEEDS[split], 0, index, *source.category.encode()])
    shapes = source.draw(params.shapes_per_shard, split, rng)
    others = [sample_shape(other, rng, split) for other in CLUTTER for _ in range(CLUTTER_SHAPES)]
    if source.category not in CLUTTER:
        others += shapes[:CLUTTER_SHAPES]
    write_shard(path, shapes, others, params, rng, _record(source, params))


def write_shard(
    path: Path,
    shapes: Sequence[Shape],
    others: Sequence[Shape],
    params: ViewParams,
    rng: np.random.Generator,
    record: str = "",
) -> None:
    """Views of `shapes` among `others`, and occupancy samples, as one npz.

    The fields are those of `draw_view` a view, of `sample_occupancy` a shape, the view's `shape` index, the
    shape's `extents`, and the record.
    """
    views: list[dict[str, np.ndarray]] = []
    for shape_index, shape in enumerate(shapes):
        seen = _draw_views(shape, others, params, rng)
        views += [view | {"shape": np.int32(shape_index)} for view in seen]
    arrays = {name: np.stack([view[name] for view in views]) for name in views[0]}
    occupancy = [sample_occupancy(shape.mesh, rng) for shape in shapes]
    arrays |= {name: np.stack([sample[name] for sample in occupancy]) for name in occupancy[0]}
    arrays["extents"] = np.stack([shape.extents for shape in shapes]).astype(np.float32)
    arrays |= {"record": np.array(record)} if record else {}
    partial = path.with_suffix(".partial.npz")
    np.savez(partial, **arrays)  # type: ignore[arg-type]
    partial.rename(path)


def _draw_views(
    shape: Shape, others: Sequence[Shape], params: ViewParams, rng: np.random.Generator
) -> list[dict[str, np.ndarray]]:
    """Up to `views_per_shape` views in one layout, the first that shows the shape at all."""
    for _ in range(LAYOUTS_PER_SHAPE):
        layout = draw_layout(shape, others, rng, params.clutter)
        tries = (draw_view(layout, rng, params) for _ in range(4 * params.views_per_shape))
        seen = list(islice((view for view in tries if view is not None), params.views_per_shape))
        if seen:
            return seen
    raise InputError("unseen_shape", f"no view shows {shape.name}; is it too small for {params.range_m} m?")


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
