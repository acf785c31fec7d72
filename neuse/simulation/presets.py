"""The worlds of the project's experiments: tables, route of the camera, changes and sensors (NeuSE V)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from neuse.geometry import Array
from neuse.params import CheckedParams, param
from neuse.records import Intrinsics
from neuse.simulation.odometry import OdometryNoise, paper_noise, visual_odometry_noise
from neuse.simulation.scene import Table
from neuse.simulation.sensor import SensorFaults, nominal, real
from neuse.simulation.trajectory import Waypoint

VGA = Intrinsics(width=640, height=480, fx=615.0, fy=615.0, cx=319.5, cy=239.5)
CAMERA_HEIGHT_M = 1.2
LOOK_HEIGHT_M = 0.78

Route = tuple[Waypoint, ...]
Position = tuple[float, float]


@dataclass(frozen=True)
class ChangePlan:
    """How many objects are added, removed, moved, and how many pairs swap places, as a traversal begins."""

    traversal: int
    added: int = 0
    removed: int = 0
    moved: int = 0
    swapped_pairs: int = 0


@dataclass(frozen=True)
class WorldPreset(CheckedParams):
    """A family of worlds; a seed picks one. `routes` has the waypoints of each traversal."""

    name: str
    tables: tuple[Table, ...]
    routes: tuple[Route, ...]
    changes: tuple[ChangePlan, ...]
    categories: tuple[str, ...] = param(("mug", "bottle"), "of the objects, by turns")
    objects: int = param(12, "objects at the start", 1, 500)
    twins: int = param(0, "objects whose shape another object has too", 0, 250)
    lying_share: float = param(0.0, "share of objects that lie", 0.0, 1.0)
    frames: int = param(400, "frames of the whole trajectory", 3, 100_000)
    approach_m: float = param(1.0, "each traversal comes this close to an object, if possible", 0.1, 10.0)
    jitter_m: float = param(0.04, "how far a seed moves tables and waypoints", 0.0, 0.3)
    faults: SensorFaults = field(default_factory=nominal)
    odometry: OdometryNoise = field(default_factory=paper_noise)
    intrinsics: Intrinsics = VGA


def _waypoint(x: float, y: float, look_x: float, look_y: float, look_m: float = LOOK_HEIGHT_M) -> Waypoint:
    return Waypoint(np.array([x, y, CAMERA_HEIGHT_M]), np.array([look_x, look_y, look_m]))


def _polar(radius: float, angle_deg: float) -> Position:
    return radius * np.cos(np.deg2rad(angle_deg)), radius * np.sin(np.deg2rad(angle_deg))


def _ring_tables(
    angles_deg: Sequence[float], radius: float, size_m: tuple[float, float]
) -> tuple[Table, ...]:
    """Tables around the origin, their long sides facing it."""
    return tuple(Table(_polar(radius, a), size_m, np.deg2rad(a + 90.0)) for a in angles_deg)


def _circle_route(angles_deg: Sequence[float], table_radius: float, standoff_m: float) -> Route:
    """Around a ring of three tables: looks down at each one, and between two of them across at the third."""
    camera_radius, route = table_radius + standoff_m, []
    for angle in angles_deg:
        near, between = _polar(camera_radius, angle), _polar(camera_radius + 0.1, angle + 60.0)
        route.append(_waypoint(*near, *_polar(table_radius + 0.1, angle), look_m=0.7))
        route.append(_waypoint(*between, 0.0, 0.0, look_m=0.62))
    return tuple(route)


def _lined_up_tables(centers: Sequence[Position], size_m: tuple[float, float]) -> tuple[Table, ...]:
    """Tables in a closed order, their long sides along the way."""
    yaws_rad = [np.arctan2(along[1], along[0]) for along in _ways(centers)]
    return tuple(Table(center, size_m, float(yaw)) for center, yaw in zip(centers, yaws_rad, strict=True))


def _along_route(centers: Sequence[Position], standoff_m: float) -> Route:
    """Past tables in a closed order, at a signed distance to the right of the way.

    The camera looks at a table until it is abreast of it, then turns to the next one, which it nears.
    """
    route = []
    for here, after, along in zip(
        np.array(centers), np.roll(centers, -1, axis=0), _ways(centers), strict=True
    ):
        abreast = here + standoff_m * np.array([along[1], -along[0]])
        route.append(_waypoint(*(abreast - 0.6 * along), *here))
        route.append(_waypoint(*(abreast - 0.1 * along), *here))
        route.append(_waypoint(*(abreast + 0.3 * along), *(0.4 * here + 0.6 * after)))
        route.append(_waypoint(*(abreast + 1.0 * along), *after))
    return tuple(route)


def _ways(centers: Sequence[Position]) -> Array:
    """(n, 2) unit directions in which a closed way through `centers` passes each of them."""
    chords = np.roll(centers, -1, axis=0) - np.roll(centers, 1, axis=0)
    return chords / np.linalg.norm(chords, axis=1, keepdims=True)


TRIANGLE = (-90.0, 30.0, 150.0)
_LOOP = _circle_route(TRIANGLE, table_radius=0.8, standoff_m=0.62)
_TABLETOP = WorldPreset(
    name="tabletop",
    tables=_ring_tables(TRIANGLE, radius=0.8, size_m=(1.0, 0.5)),
    routes=(_LOOP, _LOOP),
    changes=(ChangePlan(traversal=1, added=1, removed=1, moved=1),),
    objects=12,
    frames=400,
    approach_m=0.85,
    odometry=visual_odometry_noise(),
)

_KITCHEN = replace(
    _TABLETOP,
    name="kitchen",
    tables=_ring_tables(TRIANGLE, radius=0.8, size_m=(1.15, 0.6)),
    categories=("mug", "bottle", "bowl", "box"),
)

_RING = ((2, -6), (3.6, -3), (3.6, 0), (3.6, 3), (2, 6), (-2, 6), (-3.6, 3), (-3.6, 0), (-3.6, -3), (-2, -6))
_TEN_TABLES = _lined_up_tables(_RING, size_m=(1.2, 0.6))
_SYNTHETIC_PLANAR = WorldPreset(
    name="synthetic-planar",
    tables=_TEN_TABLES,
    routes=(_along_route(_RING, -0.65), _along_route(_RING, 0.65)),
    changes=(ChangePlan(traversal=1, added=3, removed=3, moved=1, swapped_pairs=1),),
    objects=50,
    twins=5,
    frames=700,
    approach_m=0.9,
)

_REAL_TABLES = (
    Table((-1.15, 0.0), (1.0, 0.6)),
    Table((0.0, 0.0), (1.0, 0.6)),
    Table((1.15, 0.0), (1.0, 0.6)),
    Table((-2.7, 0.0), (1.0, 0.5), np.deg2rad(90.0)),
    Table((2.7, 0.0), (1.0, 0.5), np.deg2rad(90.0)),
)
_ROUND = (
    _waypoint(-1.15, -0.7, -1.15, 0.0),
    _waypoint(0.0, -0.72, 0.0, 0.0),
    _waypoint(1.15, -0.7, 1.15, 0.0),
    _waypoint(2.0, -0.55, 2.7, -0.1),
    _waypoint(2.1, 0.1, 2.6, 1.2),
    _waypoint(1.95, 0.6, 1.3, 0.1),
    _waypoint(1.15, 0.7, 1.0, 0.0),
    _waypoint(0.0, 0.72, 0.0, 0.0),
    _waypoint(-1.15, 0.7, -1.15, 0.0),
    _waypoint(-2.0, 0.55, -2.7, 0.1),
    _waypoint(-2.1, -0.1, -2.6, -1.2),
    _waypoint(-1.95, -0.6, -1.3, -0.1),
)
_FOUR_ROUND = WorldPreset(
    name="four-round",
    tables=_REAL_TABLES,
    routes=(_ROUND,) * 4,
    changes=(ChangePlan(traversal=2, added=3, removed=2, moved=2, swapped_pairs=1),),
    objects=28,
    frames=900,
    approach_m=1.0,
    faults=real(),
)

_INFINITY_TABLES = (
    Table((-1.35, 0.0), (0.9, 0.6)),
    Table((1.35, 0.0), (0.9, 0.6)),
    Table((0.0, 0.95), (1.0, 0.5)),
    Table((0.0, -0.95), (1.0, 0.5)),
    Table((2.75, 0.0), (1.0, 0.5), np.deg2rad(90.0)),
)
_INFINITY = (
    _waypoint(0.0, 0.1, 0.0, 0.95),
    _waypoint(0.6, 0.55, 1.1, 0.15),
    _waypoint(1.35, 0.75, 1.35, 0.0),
    _waypoint(2.05, 0.4, 2.75, 0.0),
    _waypoint(2.15, -0.3, 1.6, -0.1),
    _waypoint(1.35, -0.75, 1.35, 0.0),
    _waypoint(0.65, -0.55, 0.2, -0.95),
    _waypoint(0.0, -0.05, 0.0, -0.95),
    _waypoint(-0.65, 0.55, -0.9, 0.1),
    _waypoint(-1.35, 0.75, -1.35, 0.0),
    _waypoint(-2.1, 0.4, -2.6, -0.6),
    _waypoint(-2.1, -0.4, -1.35, 0.0),
    _waypoint(-1.35, -0.75, -1.2, 0.0),
    _waypoint(-0.65, -0.55, 0.0, 0.95),
)
_TRIPLE_INFINITY = WorldPreset(
    name="triple-infinity",
    tables=_INFINITY_TABLES,
    routes=(_INFINITY,) * 3,
    changes=(ChangePlan(1, added=1, removed=1, moved=1), ChangePlan(2, added=1, removed=1, swapped_pairs=1)),
    objects=28,
    frames=800,
    approach_m=1.0,
    faults=real(),
)

PRESETS = {
    preset.name: preset
    for preset in (
        _TABLETOP,
        _KITCHEN,
        _SYNTHETIC_PLANAR,
        replace(_SYNTHETIC_PLANAR, name="synthetic-nonplanar", lying_share=0.5),
        _FOUR_ROUND,
        _TRIPLE_INFINITY,
    )
}
