"""Procedural mugs: a hollow body of revolution and a handle, in real sizes.

A body is a family of profiles, a handle a family of centre lines. The handle is joined to the solid body
before the body is hollowed, so that it never shows inside.
"""

import numpy as np
import trimesh

from neuse.simulation.handles import HANDLES, HELD_OUT_HANDLES, sample_handle
from neuse.simulation.hollows import Body, sample_body, sample_cavity
from neuse.simulation.solids import Control, to_trimesh

SMOOTH = (9.0, 9.0)
SHARP = (0.02, 0.08)

# Corners of the outside from the edge of the foot to the rim: ranges of radius / largest radius, of height /
# whole height, and of rounding / largest radius.
BODIES: dict[str, tuple[Control, ...]] = {
    "straight": (((0.95, 1.0), (0, 0), (0.03, 0.2)), ((0.97, 1.0), (1, 1), SHARP)),
    "tapered": (((0.55, 0.9), (0, 0), (0.03, 0.25)), ((1, 1), (1, 1), SHARP)),
    "conical": (((1, 1), (0, 0), (0.03, 0.15)), ((0.65, 0.92), (1, 1), SHARP)),
    "bellied": (
        ((0.55, 0.8), (0, 0), (0.03, 0.15)), ((1, 1), (0.15, 0.3), SMOOTH),
        ((1, 1), (0.5, 0.7), SMOOTH), ((0.65, 0.92), (1, 1), SHARP),
    ),
    "waisted": (
        ((0.8, 1), (0, 0), (0.03, 0.15)), ((0.55, 0.75), (0.35, 0.6), SMOOTH), ((0.85, 1), (1, 1), SHARP),
    ),
    "round_bottom": (
        ((0.25, 0.5), (0, 0), (0.02, 0.1)), ((0.8, 1), (0.03, 0.12), SMOOTH),
        ((1, 1), (0.35, 0.6), SMOOTH), ((0.95, 1.1), (1, 1), SHARP),
    ),
    "flared": (
        ((0.7, 0.9), (0, 0), (0.03, 0.2)), ((0.7, 0.85), (0.55, 0.85), SMOOTH), ((1, 1), (1, 1), SHARP),
    ),
    "footed": (
        ((0.5, 0.75), (0, 0), SHARP), ((0.45, 0.7), (0.05, 0.1), SHARP),
        ((0.9, 1), (0.12, 0.3), SMOOTH), ((0.9, 1), (1, 1), SHARP),
    ),
    "barrel": (
        ((0.8, 0.9), (0, 0), (0.03, 0.1)), ((1, 1), (0.35, 0.5), SMOOTH), ((0.8, 0.92), (1, 1), SHARP),
    ),
    "tulip": (
        ((0.5, 0.7), (0, 0), (0.03, 0.15)), ((1, 1.1), (0.1, 0.35), SMOOTH),
        ((0.7, 0.85), (0.65, 0.8), SMOOTH), ((0.9, 1.1), (1, 1), SHARP),
    ),
    "stepped": (
        ((0.7, 0.85), (0, 0), (0.03, 0.1)), ((0.7, 0.85), (0.3, 0.6), SHARP),
        ((1, 1), (0.35, 0.68), SHARP), ((0.97, 1), (1, 1), SHARP),
    ),
    "octagonal": (((0.8, 1.0), (0, 0), SHARP), ((0.97, 1.0), (1, 1), SHARP)),
}  # fmt: skip

HELD_OUT_BODIES = ("stepped", "octagonal")


def sample_mug(rng: np.random.Generator, held_out: bool = False) -> tuple[str, trimesh.Trimesh]:
    """A random mug and the name of its family; z = 0 at its foot, handle on +x.

    Held-out families (HELD_OUT_BODIES, HELD_OUT_HANDLES) come only where asked for, and then in the body, in
    the handle, or in both.
    """
    new_body, new_handle = rng.permutation([True, rng.random() < 0.4]) if held_out else (False, False)
    body_name = _choose(tuple(BODIES), HELD_OUT_BODIES, bool(new_body), rng)
    handle_name = _choose(HANDLES, HELD_OUT_HANDLES, bool(new_handle), rng)
    body = _sample_body(body_name, rng)
    solid = body.solid() + sample_handle(handle_name, body.radius, body.height, rng)
    return f"{body_name}_{handle_name}", to_trimesh(solid - sample_cavity(body, rng))


def _choose(names: tuple[str, ...], held_out: tuple[str, ...], wanted: bool, rng: np.random.Generator) -> str:
    """One of the held-out names where wanted, else one of the others."""
    candidates = [name for name in names if (name in held_out) == wanted]
    return candidates[rng.integers(len(candidates))]


def _sample_body(name: str, rng: np.random.Generator) -> Body:
    radius = float(np.exp(rng.uniform(np.log(0.025), np.log(0.065))))
    height = float(np.exp(rng.uniform(np.log(max(0.045, 1.2 * radius)), np.log(min(0.14, 3.2 * radius)))))
    wall = float(rng.uniform(0.002, min(0.007, 0.16 * radius)))
    return sample_body(BODIES[name], radius, height, wall, rng, sides=8 if name == "octagonal" else 0)
