"""Maps as an earlier session would have left them, in frames of their own."""

from collections.abc import Sequence

import numpy as np

from neuse.geometry import Array, exp, make_transform
from neuse.records import MapObject, ObjectMap, ObjectStatus

from .synthetic import Thing, make_code

SIGMAS = np.array([0.01, 0.01, 0.05, 0.002, 0.002, 0.002])
HERE = np.eye(4)
ELSEWHERE = make_transform(exp([0.0, 0.0, 2.0, 0.0, 0.0, 0.0])[:3, :3], [3.0, -1.0, 0.2])
FIRST_ID = 20


def map_of(
    things: Sequence[Thing],
    T_map_world: Array = HERE,
    first_id: int = FIRST_ID,
    status: ObjectStatus = ObjectStatus.UNCHANGED,
) -> ObjectMap:
    """The perfect map of some things, which are called `first_id` + their own names."""
    objects = tuple(
        MapObject(
            first_id + thing.name, thing.category, status, T_map_world @ thing.T_world_object, np.zeros(3),
            np.ones(3), make_code(thing, T_map_world @ thing.T_world_object, SIGMAS), 0, 1, 5,
        )
        for thing in things
    )  # fmt: skip
    return ObjectMap(1, objects)
