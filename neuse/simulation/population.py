"""Which shapes a world holds, and whether each stands or lies."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import count

import numpy as np

from neuse.errors import DegenerateGeometryError
from neuse.simulation.poses import place
from neuse.simulation.shapes import Shape, sample_shape

Item = tuple[Shape, str]  # a shape and its kind of pose, "upright" or "lying"


def population(
    categories: Sequence[str],
    objects: int,
    twins: int,
    lying_share: float,
    own: Mapping[str, Sequence[Shape]],
    rng: np.random.Generator,
) -> Iterator[Item]:
    """Endless items, the categories by turns.

    Args:
        objects: how many the world has at first; the last `twins` of them repeat shapes of the others.
        own: shapes by category to take in place of procedural ones; they return once all have been taken.
    """
    drawn: dict[str, list[Shape]] = {category: [] for category in categories}
    for index in count():
        category = categories[index % len(categories)]
        earlier = drawn[category]
        if objects - twins <= index < objects:
            shape = earlier[(objects - index) // len(categories)]
        elif own.get(category):
            shape = own[category][len(earlier) % len(own[category])]
        else:
            shape = sample_shape(category, rng, split="test")
        earlier.append(shape)
        lies = rng.random() < lying_share and _can_lie(shape)
        yield shape, "lying" if lies else "upright"


def _can_lie(shape: Shape) -> bool:
    try:
        place(shape, "lying", 0.0, (0.0, 0.0))
    except DegenerateGeometryError:
        return False
    return True
