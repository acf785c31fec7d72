"""Symmetries of categories: which turns leave an object the same, and what its code then cannot tell."""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from neuse.errors import InputError
from neuse.geometry import Array


@dataclass(frozen=True, eq=False)  # compared and hashed by identity
class Symmetry:
    """What objects of a category have in common with themselves, turned.

    turns: (g, 3, 3) rotations S of the object frame; of scaled axes E the frames E @ S are equivalent.
    ambiguous: any turn about z does not change the object.    untold: rotations about x, y and z (0, 1, 2)
        that a code does not tell, because they depend on which of the equivalent frames the encoder chose.
    meaning: for people.
    """

    name: str
    meaning: str
    turns: Array
    ambiguous: bool = False
    untold: tuple[int, ...] = ()


def symmetry_named(name: str) -> Symmetry:
    """One of SYMMETRIES.

    Raises:
        InputError: there is none of this name.
    """
    if name not in SYMMETRIES:
        raise InputError("symmetry", f"unknown symmetry {name!r}; choose one of {', '.join(SYMMETRIES)}")
    return SYMMETRIES[name]


def _turns_about_z(n: int) -> Array:
    angle = np.arange(n) * (2 * np.pi / n)
    cos, sin, zero = np.cos(angle), np.sin(angle), np.zeros(n)
    rows = [[cos, -sin, zero], [sin, cos, zero], [zero, zero, zero + 1]]
    return np.round(np.array(rows).transpose(2, 0, 1), 12)


def _turns_of_a_cube() -> Array:
    """(24, 3, 3): axes renamed and reversed, right-handed."""
    named = [np.eye(3)[list(order)] * signs for order in permutations(range(3)) for signs in SIGNS]
    return np.array([turn for turn in named if np.linalg.det(turn) > 0])


SIGNS = [np.array(signs) for signs in product((1.0, -1.0), repeat=3)]
NONE = Symmetry("none", "every turn shows, as for a mug", np.eye(3)[None])
AXIAL = Symmetry("axial", "no turn about the axis shows, as for a bottle", np.eye(3)[None], True, (2,))
HALF_TURN = Symmetry("half-turn", "half a turn about the axis does not show", _turns_about_z(2), untold=(2,))
QUARTER_TURN = Symmetry("quarter-turn", "nor a quarter of one", _turns_about_z(4), untold=(2,))
BOX = Symmetry("box", "its three axes have neither names nor signs", _turns_of_a_cube(), untold=(0, 1, 2))
SYMMETRIES = {symmetry.name: symmetry for symmetry in (NONE, AXIAL, HALF_TURN, QUARTER_TURN, BOX)}
