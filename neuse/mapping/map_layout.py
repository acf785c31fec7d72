"""What a map file holds, as records, and these records as a few long arrays and back.

Lists of arrays of several lengths are laid end to end, with their lengths beside them.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from neuse.embedding.code import Code
from neuse.geometry import Array
from neuse.mapping.views import View
from neuse.records import ChangeKind, Intrinsics, ObjectChange, ObjectStatus
from neuse.slam.object_frames import is_usable

Arrays = dict[str, np.ndarray]
Header = dict[str, Any]
MIN_POINTS = 4  # of a latent code


@dataclass(frozen=True)
class StoredObject:
    """An object at rest. views: by index of the keyframe that they are seen from.

    Ticks are steps before the map was saved, so zero or negative.
    """

    object_id: int
    category: str
    status: int
    first_seen_ns: int
    last_seen_ns: int
    n_observations: int
    since_tick: int
    last_tick: int
    views: Mapping[int, View]


@dataclass(frozen=True)
class StoredKeyframe:
    """A keyframe at rest. depth_mm: (h', w') uint16 that it saw, None if it is not kept.

    centers: object id -> (3,) observed centre, camera frame.
    """

    tick: int
    T_map_camera: Array
    intrinsics: Intrinsics
    depth_mm: np.ndarray | None
    centers: Mapping[int, Array]


@dataclass(frozen=True)
class StoredMap:
    """What a map file holds. changes: all that the map has ever reported, oldest first."""

    stamp_ns: int
    objects: tuple[StoredObject, ...] = field(default=())
    keyframes: tuple[StoredKeyframe, ...] = field(default=())
    changes: tuple[ObjectChange, ...] = field(default=())


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
        "objects": _integers([[getattr(o, name) for name in _OBJECT_NUMBERS] for o in stored.objects], 7),
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
    return StoredMap(_integer(header["stamp_ns"]), objects, keyframes, changes)


def _views_to_arrays(objects: Sequence[StoredObject]) -> Arrays:
    index = [(i, keyframe) for i, known in enumerate(objects) for keyframe in known.views]
    views = [objects[i].views[keyframe] for i, keyframe in index]
    numbers = [[*view.code.sigmas, view.code.height_correlation, view.weight] for view in views]
    ambiguous = [[view.code.ambiguous] for view in views]
    return {
        "views": np.hstack([_integers(index, 2), _integers(ambiguous, 1)]),
        "view_numbers": _floats(numbers, 8),
        **_joined("view_z", [view.code.z for view in views], 3),
        **_joined("view_points", [view.points for view in views], 3),
        **_joined("view_descriptors", [view.code.descriptor[:, None] for view in views], 1),
    }


def _objects_from_arrays(named: Any, arrays: Arrays, n_keyframes: int) -> tuple[StoredObject, ...]:
    numbers = _checked(arrays["objects"], (-1, 7), np.int64)
    categories = _categories(named, len(numbers))
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
    index = _checked(arrays["views"], (-1, 3), np.int64)
    numbers = _checked(arrays["view_numbers"], (len(index), 8), np.float64)
    z, points, descriptors = (
        _split(name, arrays, len(index), width)
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
        "ticks": _integers([[k.tick] for k in keyframes], 1),
        "poses": _floats([k.T_map_camera.ravel() for k in keyframes], 16),
        "intrinsics": _floats([[getattr(k.intrinsics, name) for name in _INTRINSICS] for k in keyframes], 6),
        "depth_shapes": _integers([depth.shape for depth in depths], 2),
        "depths": np.concatenate([depth.ravel() for depth in depths] or [np.zeros(0, np.uint16)]),
        "seen": _integers(seen, 2),
        "seen_centers": _floats([center for k in keyframes for center in k.centers.values()], 3),
    }


def _keyframes_from_arrays(arrays: Arrays) -> tuple[StoredKeyframe, ...]:
    ticks = _checked(arrays["ticks"], (-1, 1), np.int64)[:, 0]
    poses = _rigid(_checked(arrays["poses"], (len(ticks), 16), np.float64))
    intrinsics = _checked(arrays["intrinsics"], (len(ticks), 6), np.float64)
    if not ((intrinsics[:, :4] > 0).all() and (intrinsics[:, :2] < 1e5).all() and (ticks <= 0).all()):
        raise ValueError("a keyframe has a camera or a tick that is none")
    depths = _depths(arrays, len(ticks))
    centers: list[dict[int, Array]] = [{} for _ in ticks]
    seen = _checked(arrays["seen"], (-1, 2), np.int64)
    if len(seen) and seen.min() < 0:
        raise ValueError("a keyframe has seen an object that is none")
    places = _checked(arrays["seen_centers"], (len(seen), 3), np.float64)
    for (i, object_id), center in zip(seen.tolist(), places, strict=True):
        centers[i][object_id] = center
    return tuple(
        StoredKeyframe(tick, poses[i], Intrinsics(int(w), int(h), *rest), depths[i], centers[i])
        for i, (tick, (w, h, *rest)) in enumerate(zip(ticks.tolist(), intrinsics.tolist(), strict=True))
    )


def _depths(arrays: Arrays, n: int) -> list[np.ndarray | None]:
    shapes = _checked(arrays["depth_shapes"], (n, 2), np.int64)
    flat = _checked(arrays["depths"], (-1,), np.uint16)
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
    return {"changes": _integers(numbers, 6), "change_poses": _floats(poses, 32)}


def _changes_from_arrays(named: Any, arrays: Arrays) -> tuple[ObjectChange, ...]:
    numbers = _checked(arrays["changes"], (-1, 6), np.int64)
    categories = _categories(named, len(numbers))
    poses = _checked(arrays["change_poses"], (len(numbers), 32), np.float64)
    before, after = _rigid(poses[:, :16]), _rigid(poses[:, 16:])
    return tuple(
        ObjectChange(
            stamp_ns, ChangeKind(kind), object_id, category,
            before[i] if was_there else None, after[i] if is_there else None, merged_id,
        )
        for i, (category, (stamp_ns, kind, object_id, merged_id, was_there, is_there)) in enumerate(
            zip(categories, numbers.tolist(), strict=True)
        )
    )  # fmt: skip


def _joined(name: str, parts: Sequence[np.ndarray], width: int) -> Arrays:
    """Arrays (n_i, width) end to end, and their lengths."""
    flat = np.concatenate([np.zeros((0, width)), *parts])
    return {name: flat, f"{name}_lengths": np.array([len(part) for part in parts], dtype=np.int64)}


def _split(name: str, arrays: Arrays, n: int, width: int) -> list[Array]:
    """What `_joined` has joined, n parts."""
    flat = _checked(arrays[name], (-1, width), np.float64)
    lengths = _checked(arrays[f"{name}_lengths"], (n,), np.int64)
    if (lengths < 1).any() or lengths.sum() != len(flat):
        raise ValueError(f"{name} has other lengths than it says")
    return np.split(flat, np.cumsum(lengths)[:-1]) if n else []


def _integers(rows: Iterable[Sequence[Any]], width: int) -> np.ndarray:
    return np.array(list(rows), dtype=np.int64).reshape(-1, width)


def _floats(rows: Iterable[Any], width: int) -> Array:
    return np.array(list(rows), dtype=np.float64).reshape(-1, width)


def _categories(named: Any, n: int) -> list[str]:
    """The names of n categories."""
    if (
        not isinstance(named, list)
        or len(named) != n
        or not all(isinstance(name, str) and name for name in named)
    ):
        raise ValueError(f"{n} categories are needed, not {str(named)[:80]}")
    return named


def _integer(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
        raise ValueError(f"{value!r} is no integer")
    return value


def _rigid(rows: Array) -> Array:
    """(n, 4, 4) transforms of (n, 16) numbers."""
    T = rows.reshape(-1, 4, 4)
    square = T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1)
    if not (np.allclose(square, np.eye(3), atol=1e-6) and np.allclose(T[:, 3], [0, 0, 0, 1])):
        raise ValueError("a pose is none")
    return T


def _checked(array: np.ndarray, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """The array, if it is of this type and shape (-1: any length) and finite."""
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != dtype or not np.isfinite(array).all():
        raise ValueError(f"{array.dtype} of shape {array.shape} instead of {shape}, or not finite")
    return array
