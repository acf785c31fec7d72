"""Procedural bottles: closed solids of revolution, or nearly, from vial to magnum, in real sizes.

Every family is narrower at the top than at the foot: of a body with two like ends nobody could tell which is
up.
"""

from dataclasses import dataclass

import numpy as np
import trimesh

from neuse.geometry import Array
from neuse.simulation.solids import (
    Control,
    Range,
    lathe,
    rounded_polyline,
    sample_controls,
    sweep,
    to_trimesh,
)

SMOOTH = (9.0, 9.0)
SOFT = (0.3, 1.2)
EDGE = (0.05, 0.2)
TIGHT = (0.0, 0.06)
PUMP_HEAD = 0.055


@dataclass(frozen=True)
class Family:
    """Ranges of one family of bottles.

    height_m: whole height.    slenderness: largest radius / height.
    corners: of the outline upwards, ranges of radius / largest radius, of height / whole height, and of
        rounding / largest radius.
    aspect: x radius / y radius of the body; the neck stays round.    ridges: share of bottles that have them.
    pump: with a small spout to +x.
    """

    height_m: Range
    slenderness: Range
    corners: tuple[Control, ...]
    aspect: Range = (1.0, 1.0)
    ridges: float = 0.0
    pump: bool = False


def _body(
    top: Range, bottom: Range = (0.92, 1.0), edge: Range = EDGE, shoulder: Range = SOFT
) -> tuple[Control, ...]:
    """Corners of a nearly straight body up to the relative height `top`."""
    return ((bottom, (0, 0), edge), ((1, 1), top, shoulder))


def _cap(bottom: float, radius: Range) -> tuple[Control, ...]:
    """Corners of a cap between the relative height `bottom` and the top."""
    return ((radius, (bottom, bottom), TIGHT), (radius, (1, 1), EDGE))


FAMILIES: dict[str, Family] = {
    "wine": Family((0.24, 0.38), (0.11, 0.16), (
        *_body((0.5, 0.66)), ((0.3, 0.42), (0.68, 0.78), SOFT), ((0.28, 0.4), (0.92, 0.92), TIGHT),
        *_cap(0.93, (0.33, 0.45)),
    )),
    "beer": Family((0.18, 0.28), (0.12, 0.16), (
        *_body((0.45, 0.6)), ((0.45, 0.6), (0.68, 0.75), SOFT), ((0.36, 0.42), (0.94, 0.94), SOFT),
        *_cap(0.95, (0.4, 0.5)),
    )),
    "water": Family((0.15, 0.34), (0.11, 0.19), (
        *_body((0.6, 0.75)), ((0.35, 0.5), (0.85, 0.88), SOFT), ((0.35, 0.42), (0.92, 0.92), TIGHT),
        *_cap(0.93, (0.38, 0.5)),
    ), ridges=0.6),
    "sauce": Family((0.12, 0.26), (0.12, 0.2), (
        *_body((0.4, 0.6), bottom=(0.8, 1)), ((0.35, 0.5), (0.75, 0.85), SOFT),
        ((0.35, 0.45), (0.86, 0.88), TIGHT), *_cap(0.89, (0.4, 0.6)),
    ), aspect=(1, 1.2)),
    "squeeze": Family((0.13, 0.26), (0.13, 0.22), (
        *_body((0.55, 0.72), bottom=(0.85, 1)), ((0.5, 0.7), (0.76, 0.8), EDGE),
        ((0.45, 0.65), (0.8, 0.81), TIGHT), ((0.4, 0.6), (0.82, 0.86), EDGE), ((0.08, 0.2), (1, 1), TIGHT),
    ), aspect=(1, 1.35)),
    "shampoo": Family((0.14, 0.28), (0.13, 0.2), (
        *_body((0.6, 0.78), bottom=(0.75, 1)), ((0.4, 0.6), (0.8, 0.84), EDGE), *_cap(0.85, (0.4, 0.65)),
    ), aspect=(1.1, 1.35)),
    "jar": Family((0.06, 0.2), (0.28, 0.5), (
        *_body((0.6, 0.72), shoulder=EDGE), ((0.65, 0.85), (0.76, 0.78), EDGE), *_cap(0.8, (0.68, 0.88)),
    )),
    "flask": Family((0.12, 0.28), (0.22, 0.33), (
        ((0.4, 0.6), (0, 0), EDGE), ((1.2, 1.2), (0.04, 0.12), SMOOTH), ((1.2, 1.2), (0.45, 0.55), SMOOTH),
        ((0.22, 0.36), (0.55, 0.68), SOFT), ((0.22, 0.34), (0.92, 0.92), TIGHT), *_cap(0.94, (0.3, 0.42)),
    ), aspect=(1, 1.15)),
    "vial": Family((0.045, 0.11), (0.14, 0.28), (
        *_body((0.64, 0.78), shoulder=EDGE), ((0.5, 0.75), (0.78, 0.8), TIGHT), *_cap(0.82, (0.6, 0.9)),
    )),
    "pump": Family((0.14, 0.26), (0.14, 0.22), (
        *_body((0.55, 0.66), shoulder=EDGE), ((0.4, 0.55), (0.66, 0.72), EDGE),
        ((0.4, 0.55), (0.8, 0.82), TIGHT), ((0.14, 0.2), (0.83, 0.85), TIGHT),
        ((0.14, 0.2), (0.94, 0.94), TIGHT), *_cap(1 - PUMP_HEAD, (0.22, 0.32)),
    ), aspect=(1, 1.25), pump=True),
    "jug": Family((0.18, 0.34), (0.2, 0.34), (
        ((0.55, 0.75), (0, 0), EDGE), ((1, 1), (0.15, 0.45), SMOOTH), ((0.75, 1), (0.55, 0.65), SMOOTH),
        ((0.35, 0.6), (0.75, 0.85), SOFT), ((0.4, 0.65), (1, 1), TIGHT),
    )),
    "magnum": Family((0.3, 0.39), (0.12, 0.17), (
        *_body((0.36, 0.5)), ((0.5, 0.65), (0.55, 0.65), SMOOTH), ((0.26, 0.34), (0.78, 0.84), SOFT),
        ((0.26, 0.32), (0.93, 0.93), TIGHT), *_cap(0.94, (0.34, 0.45)),
    )),
    "gourd": Family((0.14, 0.3), (0.14, 0.24), (
        ((0.6, 0.8), (0, 0), EDGE), ((1.1, 1.2), (0.15, 0.3), SMOOTH), ((0.45, 0.6), (0.45, 0.55), SMOOTH),
        ((0.75, 0.9), (0.65, 0.75), SMOOTH), ((0.3, 0.45), (0.85, 0.88), SOFT), *_cap(0.9, (0.32, 0.48)),
    )),
    "cone": Family((0.1, 0.26), (0.17, 0.32), (
        ((0.95, 1), (0, 0), EDGE), ((0.9, 1), (0.06, 0.12), EDGE), ((0.25, 0.4), (0.72, 0.82), SOFT),
        ((0.25, 0.36), (0.93, 0.93), TIGHT), *_cap(0.94, (0.3, 0.42)),
    )),
    "amphora": Family((0.14, 0.3), (0.15, 0.25), (
        ((0.4, 0.55), (0, 0), EDGE), ((1, 1), (0.5, 0.65), SMOOTH), ((0.9, 1), (0.68, 0.75), SMOOTH),
        ((0.32, 0.45), (0.8, 0.84), SOFT), *_cap(0.88, (0.36, 0.5)),
    )),
}  # fmt: skip

HELD_OUT = ("gourd", "cone", "amphora")


def sample_bottle(rng: np.random.Generator, held_out: bool = False) -> tuple[str, trimesh.Trimesh]:
    """A random bottle and the name of its family, from HELD_OUT only where asked for; z = 0 at its foot."""
    names = [name for name in FAMILIES if (name in HELD_OUT) == held_out]
    name = names[rng.integers(len(names))]
    family = FAMILIES[name]
    profile = _sample_profile(family, rng)
    if rng.random() < family.ridges:
        profile = _ridged(profile, rng)
    solid = lathe(profile, aspect=_aspect(profile, rng.uniform(*family.aspect)))
    if family.pump:
        solid += sweep(*_nozzle(profile, rng), squareness=3.0)
    return name, to_trimesh(solid)


def _sample_profile(family: Family, rng: np.random.Generator) -> Array:
    """Outline (n, 2), radius and height, metres."""
    height = float(np.exp(rng.uniform(*np.log(family.height_m))))
    radius = height * rng.uniform(*family.slenderness)
    corners, rounding = sample_controls(family.corners, rng)
    corners[:, 1] = np.maximum.accumulate(corners[:, 1])
    corners, rounding = np.vstack([[0, 0], corners, [0, 1]]), np.concatenate([[0], rounding, [0]])
    profile = rounded_polyline(corners * [radius, height], rounding * radius)[1:-1]
    profile[:, 0] *= radius / profile[:, 0].max()
    return profile


def _ridged(profile: Array, rng: np.random.Generator) -> Array:
    """The outline with rings pressed into its straight part."""
    radius, z = profile[:, 0].max(), profile[:, 1]
    straight = z[profile[:, 0] > 0.97 * radius]
    low, high = straight.min(), straight.max()
    period, depth = rng.uniform(0.08, 0.2) * (high - low), rng.uniform(0.01, 0.04) * radius
    rows = np.linspace(low, high, 60)
    wave = 0.5 * depth * (1 - np.cos(2 * np.pi * (rows - low) / period))
    rings = np.stack([np.interp(rows, z, profile[:, 0]) - wave, rows], axis=1)
    return np.vstack([profile[z < low], rings, profile[z > high]])


def _aspect(profile: Array, body_aspect: float) -> Array:
    """x radius / y radius at each point of the outline: that of the body where it is wide, 1 at the neck."""
    narrow, wide = profile[-1, 0], profile[:, 0].max()
    share = np.clip((profile[:, 0] - narrow) / max(wide - narrow, 1e-6), 0, 1)
    return 1 + (body_aspect - 1) * share


def _nozzle(profile: Array, rng: np.random.Generator) -> tuple[Array, Array]:
    """Path and half sizes of a small spout to one side of a pump's head."""
    z = profile[-1, 1]
    head = profile[profile[:, 1] > (1 - PUMP_HEAD) * z, 0].max()
    half, length = 0.4 * PUMP_HEAD * z, rng.uniform(1.6, 2.6) * head
    middle = z - 1.25 * half
    return np.array([[0.0, middle], [length, middle]]), np.array([half, min(1.5 * half, 0.6 * head)])
