"""A map at rest, as records."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from neuse.geometry import Array
from neuse.mapping.views import View
from neuse.records import Intrinsics, ObjectChange


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
