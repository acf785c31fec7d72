"""Procedural bowls: hollow bodies of revolution, wide and low, from dip to salad, in real sizes."""

import numpy as np
import trimesh

from neuse.simulation.hollows import sample_body, sample_cavity
from neuse.simulation.solids import Control, to_trimesh

SMOOTH = (9.0, 9.0)
SHARP = (0.01, 0.06)
FOOT = (0.03, 0.2)

# Corners of the outside from the edge of the foot to the rim, see neuse.simulation.hollows.sample_body.
FAMILIES: dict[str, tuple[Control, ...]] = {
    "round": (((0.35, 0.6), (0, 0), FOOT), ((0.82, 0.97), (0.1, 0.35), SMOOTH), ((1, 1), (1, 1), SHARP)),
    "deep": (((0.5, 0.8), (0, 0), FOOT), ((0.93, 1), (0.25, 0.5), SMOOTH), ((0.97, 1), (1, 1), SHARP)),
    "conical": (((0.25, 0.5), (0, 0), FOOT), ((1, 1), (1, 1), SHARP)),
    "flat": (((0.6, 0.8), (0, 0), FOOT), ((0.88, 1), (0.15, 0.4), SMOOTH), ((1, 1), (1, 1), SHARP)),
    "straight": (((0.85, 1), (0, 0), FOOT), ((0.97, 1), (1, 1), SHARP)),
    "footed": (
        ((0.35, 0.55), (0, 0), SHARP), ((0.33, 0.5), (0.08, 0.16), SHARP),
        ((0.85, 0.97), (0.22, 0.45), SMOOTH), ((1, 1), (1, 1), SHARP),
    ),
    "flared": (
        ((0.4, 0.6), (0, 0), FOOT), ((0.65, 0.8), (0.3, 0.5), SMOOTH),
        ((0.75, 0.85), (0.68, 0.85), SMOOTH), ((1, 1), (1, 1), SHARP),
    ),
    "rimmed": (
        ((0.4, 0.6), (0, 0), FOOT), ((0.68, 0.78), (0.3, 0.6), SMOOTH),
        ((0.72, 0.82), (0.8, 0.88), (0.02, 0.08)), ((1, 1), (1, 1), SHARP),
    ),
    "closing": (
        ((0.45, 0.65), (0, 0), FOOT), ((1, 1), (0.3, 0.6), SMOOTH), ((0.8, 0.94), (1, 1), SHARP),
    ),
    "stepped": (
        ((0.5, 0.65), (0, 0), FOOT), ((0.55, 0.7), (0.25, 0.4), SHARP),
        ((0.88, 1), (0.42, 0.55), SHARP), ((0.97, 1), (1, 1), SHARP),
    ),
    "bell": (
        ((0.3, 0.45), (0, 0), FOOT), ((0.6, 0.75), (0.02, 0.1), SMOOTH),
        ((0.62, 0.78), (0.5, 0.7), SMOOTH), ((1, 1), (1, 1), SHARP),
    ),
}  # fmt: skip

HELD_OUT = ("stepped", "bell")


def sample_bowl(rng: np.random.Generator, held_out: bool = False) -> tuple[str, trimesh.Trimesh]:
    """A random bowl and the name of its family, from HELD_OUT only where asked for; z = 0 at its foot."""
    names = [name for name in FAMILIES if (name in HELD_OUT) == held_out]
    name = names[rng.integers(len(names))]
    radius = float(np.exp(rng.uniform(*np.log([0.045, 0.125]))))
    height = max(radius * float(np.exp(rng.uniform(*np.log([0.35, 1.15])))), 0.028)
    wall = float(rng.uniform(0.002, min(0.007, 0.06 * radius)))
    body = sample_body(FAMILIES[name], radius, height, wall, rng)
    return name, to_trimesh(body.solid() - sample_cavity(body, rng))
