"""The records of a map file as a few long arrays, and back."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.mapping.flat_arrays import (
    Arrays,
    checked,
    floats,
    integer,
    integers,
    joined,
    names,
    rigid,
    split,
)
from neuse.mapping.stored_map import StoredKeyframe, StoredMap, StoredObject
from neuse.mapping.views import View
from neuse.records import ChangeKind, Intrinsics, ObjectChange, ObjectStatus
from neuse.slam.object_frames import is_usable

Header = dict[str, Any]
MIN_POINTS = 4  # of a latent code


_OBJECT_NUMBERS = (
    "object_id", "status", "first_seen_ns", "last_seen_ns", "n_observations", "since_tick", "last_tick",
)  # fmt: skip
_INTRINSICS = ("width", "height", "fx", "fy", "cx", "cy")


def to_arrays(stored: StoredMap) -> tuple[Header, Arrays]:
    """The header (for JSON) and the arrays of a map."""
    header = {
        "stamp_ns": stored.stamp_ns,
        "categories": [known.category for known in stored.objects],
        "change_categories": [change.category for change in stored.changes],
    }
    return header, {
        "objects": integers([[getattr(o, name) for name in _OBJECT_NUMBERS] for o in stored.objects], 7),
        **_views_to_arrays(stored.objects),
        **_keyframes_to_arrays(stored.keyframes),
        **_changes_to_arrays(stored.changes),
    }


def from_arrays(header: Header, arrays: Arrays) -> StoredMap:
    """The map that a header and arrays stand for.

    Raises:
        KeyError, IndexError, TypeError, ValueError: something is missing, or not what it should be.
    """
    keyframes = _keyframes_from_arrays(arrays)
    objects = _objects_from_arrays(header["categories"], arrays, len(keyframes))
    changes = _changes_from_arrays(header["change_categories"], arrays)
    return StoredMap(integer(header["stamp_ns"]), objects, keyframes, changes)


def _views_to_arrays(objects: Sequence[StoredObject]) -> Arrays:
    index = [(i, keyframe) for i, known in enumerate(objects) for keyframe in known.views]
    views = [objects[i].views[keyframe] for i, keyframe in index]
    numbers = [[*view.code.sigmas, view.code.height_correlation, view.weight] for view in views]
    ambiguous = [[view.code.ambiguous] for view in views]
    return {
        "views": np.hstack([integers(index, 2), integers(ambiguous, 1)]),
        "view_numbers": floats(numbers, 8),
        **joined("view_z", [view.code.z for view in views], 3),
        **joined("view_points", [view.points for view in views], 3),
        **joined("view_descriptors", [view.code.descriptor[:, None] for view in views], 1),
    }


def _objects_from_arrays(named: Any, arrays: Arrays, n_keyframes: int) -> tuple[StoredObject, ...]:
    numbers = checked(arrays["objects"], (-1, 7), np.int64)
    categories = names(named, len(numbers))
    if len(np.unique(numbers[:, 0])) != len(numbers):
        raise ValueError("two objects have one id")
    views = _views_from_arrays(categories, arrays, n_keyframes)
    return tuple(
        _object(dict(zip(_OBJECT_NUMBERS, row, strict=True)), categories[i], views[i])
        for i, row in enumerate(numbers.tolist())
    )


def _object(numbers: dict[str, int], category: str, views: dict[int, View]) -> StoredObject:
    ObjectStatus(numbers["status"])
    in_past = max(numbers["since_tick"], numbers["last_tick"]) <= 0
    if numbers["object_id"] < 0 or numbers["n_observations"] < 0 or not in_past or not views:
        raise ValueError(f"object {numbers} with {len(views)} views is none")
    return StoredObject(**numbers, category=category, views=views)


def _views_from_arrays(categories: Sequence[str], arrays: Arrays, n_keyframes: int) -> list[dict[int, View]]:
    """The views of each object."""
    index = checked(arrays["views"], (-1, 3), np.int64)
    numbers = checked(arrays["view_numbers"], (len(index), 8), np.float64)
    z, points, descriptors = (
        split(name, arrays, len(index), width)
        for name, width in (("view_z", 3), ("view_points", 3), ("view_descriptors", 1))
    )
    if len(index) and not (index.min() >= 0 and index[:, 1].max() < n_keyframes):
        raise ValueError("a view is from a keyframe that is not there")
    if not (numbers[:, 7] > 0).all():
        raise ValueError("a view has no weight")
    views: list[dict[int, View]] = [{} for _ in categories]
    for row, (i, keyframe, ambiguous) in enumerate(index.tolist()):
        *sigmas, correlation, weight = numbers[row].tolist()
        code = _code(categories[i], bool(ambiguous), z[row], descriptors[row][:, 0], sigmas, correlation)
        views[i][keyframe] = View(code, points[row], weight)
    return views


def _code(
    category: str, ambiguous: bool, z: Array, descriptor: Array, sigmas: Sequence[float], correlation: float
) -> Code:
    code = Code(category, ambiguous, z, descriptor, np.array(sigmas), correlation)
    if not is_usable(code) or len(z) < MIN_POINTS or len(z) % 2 or len(descriptor) != len(z):
        raise ValueError(f"a code of {len(z)} points and a descriptor of {len(descriptor)} numbers is none")
    return code


def _keyframes_to_arrays(keyframes: Sequence[StoredKeyframe]) -> Arrays:
    depths = [np.zeros((0, 0), np.uint16) if k.depth_mm is None else k.depth_mm for k in keyframes]
    seen = [(i, object_id) for i, k in enumerate(keyframes) for object_id in k.centers]
    return {
        "ticks": integers([[k.tick] for k in keyframes], 1),
        "poses": floats([k.T_map_camera.ravel() for k in keyframes], 16),
        "intrinsics": floats([[getattr(k.intrinsics, name) for name in _INTRINSICS] for k in keyframes], 6),
        "depth_shapes": integers([depth.shape for depth in depths], 2),
        "depths": np.concatenate([depth.ravel() for depth in depths] or [np.zeros(0, np.uint16)]),
        "seen": integers(seen, 2),
        "seen_centers": floats([center for k in keyframes for center in k.centers.values()], 3),
    }


def _keyframes_from_arrays(arrays: Arrays) -> tuple[StoredKeyframe, ...]:
    ticks = checked(arrays["ticks"], (-1, 1), np.int64)[:, 0]
    poses = rigid(checked(arrays["poses"], (len(ticks), 16), np.float64))
    intrinsics = checked(arrays["intrinsics"], (len(ticks), 6), np.float64)
    if not ((intrinsics[:, :4] > 0).all() and (intrinsics[:, :2] < 1e5).all() and (ticks <= 0).all()):
        raise ValueError("a keyframe has a camera or a tick that is none")
    depths = _depths(arrays, len(ticks))
    centers: list[dict[int, Array]] = [{} for _ in ticks]
    seen = checked(arrays["seen"], (-1, 2), np.int64)
    if len(seen) and seen.min() < 0:
        raise ValueError("a keyframe has seen an object that is none")
    places = checked(arrays["seen_centers"], (len(seen), 3), np.float64)
    for (i, object_id), center in zip(seen.tolist(), places, strict=True):
        centers[i][object_id] = center
    return tuple(
        StoredKeyframe(tick, poses[i], Intrinsics(int(w), int(h), *rest), depths[i], centers[i])
        for i, (tick, (w, h, *rest)) in enumerate(zip(ticks.tolist(), intrinsics.tolist(), strict=True))
    )


def _depths(arrays: Arrays, n: int) -> list[np.ndarray | None]:
    shapes = checked(arrays["depth_shapes"], (n, 2), np.int64)
    flat = checked(arrays["depths"], (-1,), np.uint16)
    sizes = shapes.prod(axis=1)
    if (shapes < 0).any() or (shapes > 1e4).any() or sizes.sum() != len(flat):
        raise ValueError("depth images of other sizes than it says")
    parts = np.split(flat, np.cumsum(sizes)[:-1]) if n else []
    return [
        part.reshape(shape) if size else None for part, shape, size in zip(parts, shapes, sizes, strict=True)
    ]


def _changes_to_arrays(changes: Sequence[ObjectChange]) -> Arrays:
    numbers = [
        [c.stamp_ns, c.kind, c.object_id, c.merged_id, c.T_map_before is not None, c.T_map_after is not None]
        for c in changes
    ]
    poses = [
        np.concatenate([(np.eye(4) if T is None else T).ravel() for T in (c.T_map_before, c.T_map_after)])
        for c in changes
    ]
    return {"changes": integers(numbers, 6), "change_poses": floats(poses, 32)}


def _changes_from_arrays(named: Any, arrays: Arrays) -> tuple[ObjectChange, ...]:
    numbers = checked(arrays["changes"], (-1, 6), np.int64)
    categories = names(named, len(numbers))
    poses = checked(arrays["change_poses"], (len(numbers), 32), np.float64)
    before, after = rigid(poses[:, :16]), rigid(poses[:, 16:])
    return tuple(
        ObjectChange(
            stamp_ns, ChangeKind(kind), object_id, category,
            before[i] if was_there else None, after[i] if is_there else None, merged_id,
        )
        for i, (category, (stamp_ns, kind, object_id, merged_id, was_there, is_there)) in enumerate(
            zip(categories, numbers.tolist(), strict=True)
        )
    )  # fmt: skip
