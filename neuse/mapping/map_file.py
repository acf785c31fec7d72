"""Map files: objects and evidence of free space in one .npz, without pickle, written whole or not at all."""

import json
import math
import os
import zipfile
import zlib
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from neuse.embedding.code import Code
from neuse.errors import MapFileError
from neuse.geometry import Array
from neuse.mapping.archive import read_arrays
from neuse.mapping.keyframe_memory import KeyframeMemory, SeenKeyframe
from neuse.mapping.object_library import ObjectLibrary, ObjectRecord, View
from neuse.records import NO_ID, Intrinsics, ObjectStatus
from neuse.slam.checks import is_rigid
from neuse.slam.object_frames import is_usable

FORMAT = "neuse-map"
VERSION = 2
_UNREADABLE = (
    OSError, EOFError, ValueError, KeyError, AttributeError, RuntimeError, SyntaxError,
    zipfile.BadZipFile, zlib.error,
)  # fmt: skip


@dataclass(frozen=True)
class StoredObject:
    """An object at rest. code, points (n, 3): map frame.    weight: of all its views together.

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
    weight: float
    code: Code
    points: Array


@dataclass(frozen=True)
class StoredKeyframe:
    """A keyframe at rest, with the depth it saw."""

    tick: int
    T_map_camera: Array
    intrinsics: Intrinsics
    depth_mm: np.ndarray
    centers: dict[int, Array]


@dataclass(frozen=True)
class StoredMap:
    """What a map file holds."""

    stamp_ns: int
    objects: tuple[StoredObject, ...] = field(default=())
    keyframes: tuple[StoredKeyframe, ...] = field(default=())


def snapshot(library: ObjectLibrary, memory: KeyframeMemory, tick: int, stamp_ns: int) -> StoredMap:
    """The map as it is at a step."""
    objects = tuple(_stored_object(record, tick) for record in library)
    keyframes = tuple(
        StoredKeyframe(k.tick - tick, memory.poses[k.keyframe_id], k.intrinsics, k.depth_mm,
                       {library.resolve(i): center for i, center in k.centers.items()})
        for k in memory.seen.values() if k.depth_mm is not None
    )  # fmt: skip
    return StoredMap(stamp_ns, objects, keyframes)


def restore(stored: StoredMap, library: ObjectLibrary, memory: KeyframeMemory) -> None:
    """Fill an empty library and memory. Stored keyframes get ids below NO_ID: no new estimate moves them."""
    for i, keyframe in enumerate(stored.keyframes):
        keyframe_id = NO_ID - 1 - i
        memory.poses[keyframe_id] = keyframe.T_map_camera
        memory.seen[keyframe_id] = SeenKeyframe(
            keyframe_id, keyframe.tick, keyframe.intrinsics, keyframe.depth_mm, dict(keyframe.centers)
        )
    for known in stored.objects:
        library.records[known.object_id] = ObjectRecord(
            known.object_id, known.category, memory.poses, known.first_seen_ns, known.last_seen_ns,
            known.since_tick, known.last_tick, known.n_observations, ObjectStatus(known.status),
            {NO_ID: View(known.code, known.points, known.weight)},
        )  # fmt: skip


def save_map(path: Path, stored: StoredMap) -> None:
    """Write a map file.

    Raises:
        MapFileError: the place cannot be written.
    """
    header, arrays = _to_arrays(stored)
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    if not path.name or (path.exists() and not path.is_file()):
        raise MapFileError(f"cannot write the map to {str(path)!r}: no name of a file")
    unfinished = path.with_name(path.name + ".part")
    try:
        with open(unfinished, "wb") as file:
            np.savez_compressed(file, **arrays)  # type: ignore[arg-type]
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except (OSError, ValueError) as error:  # the second for names that the system does not take
        with suppress(OSError, ValueError):
            unfinished.unlink(missing_ok=True)
        raise MapFileError(f"cannot write the map to {path}: {error}") from error


def load_map(path: Path) -> StoredMap:
    """Read a map file.

    Raises:
        MapFileError: the file is missing, damaged, not a map, or of another version.
    """
    try:
        arrays = read_arrays(path)
        header = json.loads(arrays.pop("header").tobytes())
    except FileNotFoundError as error:
        raise MapFileError(f"there is no map file {path}") from error
    except _UNREADABLE as error:
        raise MapFileError(f"{path} is damaged or no map file: {error}") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise MapFileError(f"{path} is no map file of this program")
    if header.get("version") != VERSION:
        raise MapFileError(
            f"{path} is a map of version {header.get('version')}; this program reads {VERSION}"
        )
    try:
        return _from_arrays(header, arrays)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise MapFileError(f"{path} is damaged: {error!r}") from error


_SCALARS = (
    "object_id", "category", "status", "first_seen_ns", "last_seen_ns", "n_observations", "since_tick",
    "last_tick", "weight",
)  # fmt: skip


def _to_arrays(stored: StoredMap) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    header: dict[str, Any] = {
        "format": FORMAT,
        "version": VERSION,
        "stamp_ns": stored.stamp_ns,
        "objects": [],
    }
    arrays: dict[str, np.ndarray] = {}
    for i, known in enumerate(stored.objects):
        scalars = {name: getattr(known, name) for name in _SCALARS}
        scalars |= {name: getattr(known.code, name) for name in ("ambiguous", "height_correlation")}
        header["objects"].append(scalars)
        arrays |= {f"z_{i}": known.code.z, f"descriptor_{i}": known.code.descriptor}
        arrays |= {f"sigmas_{i}": known.code.sigmas, f"points_{i}": known.points}
    header["keyframes"] = [{"tick": k.tick, "intrinsics": asdict(k.intrinsics)} for k in stored.keyframes]
    for i, keyframe in enumerate(stored.keyframes):
        arrays |= {f"pose_{i}": keyframe.T_map_camera, f"depth_{i}": keyframe.depth_mm}
        arrays[f"seen_ids_{i}"] = np.array(list(keyframe.centers), dtype=np.int64)
        arrays[f"seen_centers_{i}"] = np.array(list(keyframe.centers.values())).reshape(-1, 3)
    return header, arrays


def _from_arrays(header: dict[str, Any], arrays: dict[str, np.ndarray]) -> StoredMap:
    _check_whole(header, ["stamp_ns"])
    objects = tuple(_read_object(entry, i, arrays) for i, entry in enumerate(header["objects"]))
    keyframes = tuple(_read_keyframe(entry, i, arrays) for i, entry in enumerate(header["keyframes"]))
    return StoredMap(header["stamp_ns"], objects, keyframes)


def _read_object(entry: dict[str, Any], i: int, arrays: dict[str, np.ndarray]) -> StoredObject:
    z, points = _checked(arrays[f"z_{i}"], (-1, 3)), _checked(arrays[f"points_{i}"], (-1, 3))
    descriptor, sigmas = _checked(arrays[f"descriptor_{i}"], (-1,)), _checked(arrays[f"sigmas_{i}"], (6,))
    ObjectStatus(entry["status"])
    correlation, weight = float(entry["height_correlation"]), float(entry["weight"])
    code = Code(_text(entry["category"]), bool(entry["ambiguous"]), z, descriptor, sigmas, correlation)
    if not is_usable(code) or len(z) != len(descriptor) or len(z) < 4 or len(z) % 2:
        raise ValueError(f"code of object {i} is none")
    if not 0.0 < weight < math.inf or not len(points):
        raise ValueError(f"object {i} has weight {weight} and {len(points)} points")
    _check_whole(entry, [name for name in _SCALARS if name not in ("category", "weight")])
    return StoredObject(**{name: entry[name] for name in _SCALARS}, code=code, points=points)


def _read_keyframe(entry: dict[str, Any], i: int, arrays: dict[str, np.ndarray]) -> StoredKeyframe:
    ids, centers = arrays[f"seen_ids_{i}"], _checked(arrays[f"seen_centers_{i}"], (-1, 3))
    seen = {int(object_id): center for object_id, center in zip(ids, centers, strict=True)}
    pose, depth_mm = _checked(arrays[f"pose_{i}"], (4, 4)), arrays[f"depth_{i}"]
    if depth_mm.ndim != 2 or depth_mm.dtype != np.uint16 or not depth_mm.size:
        raise ValueError(f"depth_{i} is {depth_mm.dtype} of shape {depth_mm.shape}")
    _check_whole(entry, ["tick"])
    intrinsics = Intrinsics(**entry["intrinsics"])
    if not is_rigid(pose) or not intrinsics.is_sound:
        raise ValueError(f"pose_{i} or its camera is none")
    return StoredKeyframe(entry["tick"], pose, intrinsics, depth_mm, seen)


def _text(value: Any) -> str:
    if not isinstance(value, str) or not value:
        raise ValueError(f"category {value!r}")
    return value


def _check_whole(entry: dict[str, Any], names: Sequence[str]) -> None:
    """Raises ValueError where an entry is no whole number, or none that a message can hold."""
    for name in names:
        value = entry[name]
        if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
            raise ValueError(f"{name} is {str(value)[:50]!r}")


def _checked(array: np.ndarray, shape: tuple[int, ...]) -> Array:
    """The array as float64, if it is finite and of the shape (-1: any length)."""
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or not np.isfinite(array).all():
        raise ValueError(f"array of shape {array.shape} instead of {shape}, or not finite")
    return array.astype(np.float64)


def _stored_object(record: ObjectRecord, tick: int) -> StoredObject:
    weight = float(sum(view.weight for view in record.views.values()))
    return StoredObject(
        record.object_id, record.category, int(record.status), record.first_seen_ns, record.last_seen_ns,
        record.n_observations, record.since_tick - tick, record.last_tick - tick, weight,
        record.code, record.points,
    )  # fmt: skip
