"""What viewers draw: meshes, labels and change arrows, as plain data that a node converts to messages."""

import colorsys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum

import numpy as np
import trimesh

from neuse.errors import NeuseError
from neuse.geometry import Array, make_transform
from neuse.records import ChangeKind, MapObject, ObjectChange, ObjectMap, ObjectStatus

Color = tuple[float, float, float, float]

_LABEL_COLORS: dict[ObjectStatus, Color] = {
    ObjectStatus.UNCHANGED: (1.0, 1.0, 1.0, 1.0),
    ObjectStatus.ADDED: (0.3, 0.9, 0.3, 1.0),
    ObjectStatus.MOVED: (1.0, 0.8, 0.2, 1.0),
    ObjectStatus.REMOVED: (1.0, 0.3, 0.3, 1.0),
}
_LABEL_HEIGHT_M = 0.03
_ARROW_WIDTH_M = 0.01
_GOLDEN_RATIO = 0.618033988749895


class MarkerKind(Enum):
    """MESH: points are triangle corners, three by three.    TEXT: one point.    ARROW: tail and tip."""

    MESH = "mesh"
    TEXT = "text"
    ARROW = "arrow"
    DELETE_ALL = "delete_all"


@dataclass(frozen=True)
class Marker:
    """A drawing, unique by namespace and marker_id.

    points: (n, 3) map frame, metres.    color: RGBA in [0, 1].
    scale_m: height of a text, width of an arrow.
    """

    namespace: str
    marker_id: int
    kind: MarkerKind
    points: Array
    color: Color = (1.0, 1.0, 1.0, 1.0)
    scale_m: float = 1.0
    text: str = ""


CLEAN_SHEET = Marker("", 0, MarkerKind.DELETE_ALL, np.zeros((0, 3)))
Meshes = Callable[[int], trimesh.Trimesh]


def scene_markers(object_map: ObjectMap, mesh: Meshes, changes: Sequence[ObjectChange]) -> list[Marker]:
    """A clean sheet, a mesh for each object that is there, a label for each, an arrow for its latest move.

    Whole each time: a viewer that joins late, or that missed a drawing, has all of the map and nothing else.

    Args:
        mesh: gives an object's shape in the map frame, by its id.
    """
    present = [known for known in object_map.objects if known.status != ObjectStatus.REMOVED]
    meshes = [_mesh_marker(known, mesh) for known in present]
    labels = [_label(known) for known in object_map.objects]
    listed = {known.object_id for known in present}
    moves = {c.object_id: c for c in changes if c.kind == ChangeKind.MOVED and c.object_id in listed}
    return [CLEAN_SHEET, *meshes, *labels, *map(_arrow, moves.values())]


def map_points(object_map: ObjectMap, mesh: Meshes) -> tuple[Array, Array]:
    """Vertices (n, 3), map frame, of all objects that are there, and their colours (n, 3), RGB in [0, 1]."""
    points, colors = [np.zeros((0, 3))], [np.zeros((0, 3))]
    for known in object_map.objects:
        if known.status != ObjectStatus.REMOVED:
            points.append(np.asarray(_shape(known, mesh).vertices))
            colors.append(np.tile(object_color(known.object_id)[:3], (len(points[-1]), 1)))
    return np.concatenate(points), np.concatenate(colors)


def object_color(object_id: int) -> Color:
    """A colour that stays with an id; ids in a row are far apart in hue."""
    red, green, blue = colorsys.hsv_to_rgb((0.1 + object_id * _GOLDEN_RATIO) % 1.0, 0.65, 0.9)
    return red, green, blue, 1.0


def _mesh_marker(known: MapObject, mesh: Meshes) -> Marker:
    triangles = np.asarray(_shape(known, mesh).triangles, dtype=np.float64).reshape(-1, 3)
    return Marker("objects", known.object_id, MarkerKind.MESH, triangles, object_color(known.object_id))


def _shape(known: MapObject, mesh: Meshes) -> trimesh.Trimesh:
    """The full shape, or the box of what was observed if the code cannot be decoded."""
    try:
        return mesh(known.object_id)
    except NeuseError:
        T_map_box = make_transform(known.T_map_object[:3, :3], known.box_center)
        return trimesh.creation.box(extents=np.maximum(known.box_size, 1e-3), transform=T_map_box)


def _label(known: MapObject) -> Marker:
    status = "" if known.status == ObjectStatus.UNCHANGED else f" ({known.status.name.lower()})"
    text = f"{known.category} {known.object_id}{status}"
    above = known.box_center + np.array([0.0, 0.0, np.linalg.norm(known.box_size) / 2])
    return Marker(
        "labels",
        known.object_id,
        MarkerKind.TEXT,
        above[None],
        _LABEL_COLORS[known.status],
        _LABEL_HEIGHT_M,
        text,
    )


def _arrow(move: ObjectChange) -> Marker:
    assert move.T_map_before is not None
    assert move.T_map_after is not None
    ends = np.stack([move.T_map_before[:3, 3], move.T_map_after[:3, 3]])
    color = _LABEL_COLORS[ObjectStatus.MOVED]
    return Marker("changes", move.object_id, MarkerKind.ARROW, ends, color, _ARROW_WIDTH_M)
