"""Object shapes in their own frame: what the simulator places, renders and supervises with."""

from dataclasses import dataclass, field

import numpy as np
import trimesh

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.simulation.bottles import sample_bottle
from neuse.simulation.bowls import sample_bowl
from neuse.simulation.boxes import sample_box
from neuse.simulation.mugs import sample_mug
from neuse.simulation.textures import Color, Texture, sample_texture, texture_color
from neuse.symmetry import AXIAL, BOX, NONE, Symmetry

__all__ = ["Shape", "Texture", "categories", "make_shape", "sample_shape", "symmetry_of", "texture_color"]

SPLITS = ("train", "validation", "test")
HELD_OUT_SHARE = 0.25

_SAMPLERS = {"mug": sample_mug, "bottle": sample_bottle, "bowl": sample_bowl, "box": sample_box}
_SYMMETRIES = {"mug": NONE, "bottle": AXIAL, "bowl": AXIAL, "box": BOX}


@dataclass(frozen=True, eq=False)  # compared and hashed by identity
class Shape:
    """An object in its own frame, metres.

    The z axis is the axis of the body and points to the opening, the origin lies on it at mid height; the
    handle of a mug points to +x. Of a box the axes are its edges, in any order.

    symmetry: which turns about the axes do not count.    mesh: closed, normals outwards.
    extents: (3,) x reach of the handle from the axis (of an axial shape: largest radius), y largest radius of
        the body, z half height; of a box its half sizes.    texture: colours of the surface.
    """

    name: str
    category: str
    symmetry: Symmetry
    mesh: trimesh.Trimesh
    extents: Array
    texture: Texture = field(default_factory=Texture)

    @property
    def ambiguous(self) -> bool:
        """Whether a turn about z does not change the shape (as for bottles)."""
        return self.symmetry.ambiguous

    @property
    def color(self) -> Color:
        """Base colour, RGB."""
        return self.texture.color_a


def categories() -> tuple[str, ...]:
    """Categories that `sample_shape` knows."""
    return tuple(_SAMPLERS)


def symmetry_of(category: str) -> Symmetry:
    """The symmetry that simulated objects of the category are taken to have; none of an unknown category."""
    return _SYMMETRIES.get(category, NONE)


def sample_shape(category: str, rng: np.random.Generator, split: str = "train") -> Shape:
    """A random shape.

    Every split has the common families; a quarter of the shapes for "validation" and "test" come from those
    that "train" never shows: bodies `stepped` and `octagonal` and handles `hook` and `triangle` for mugs,
    `gourd`, `cone` and `amphora` for bottles, `stepped` and `bell` for bowls, `pillow` and `grooved` for
    boxes.

    Raises:
        InputError: an unknown category or split.
    """
    if category not in _SAMPLERS:
        raise InputError(
            "unknown_category", f"no procedural shapes of category {category!r}; known: {categories()}"
        )
    if split not in SPLITS:
        raise InputError("unknown_split", f"unknown split {split!r}; choose one of {SPLITS}")
    held_out = split != "train" and bool(rng.random() < HELD_OUT_SHARE)
    family, mesh = _SAMPLERS[category](rng, held_out)
    mesh.apply_translation([0, 0, -mesh.bounds[:, 2].mean()])
    name = f"{category}_{family}_{rng.integers(16**6):06x}"
    return make_shape(name, category, mesh, sample_texture(rng, float(np.ptp(mesh.bounds[:, 2]))))


def make_shape(
    name: str,
    category: str,
    mesh: trimesh.Trimesh,
    texture: Texture | None = None,
    symmetry: Symmetry | None = None,
) -> Shape:
    """A shape from a closed mesh that is already in the object frame; by default its category's symmetry."""
    symmetry = symmetry or symmetry_of(category)
    return Shape(name, category, symmetry, mesh, _extents(mesh, symmetry), texture or Texture())


def _extents(mesh: trimesh.Trimesh, symmetry: Symmetry) -> Array:
    vertices = mesh.vertices
    reach = np.abs(vertices).max(axis=0)
    if symmetry.ambiguous:
        radius = np.linalg.norm(vertices[:, :2], axis=1).max()
        return np.array([radius, radius, reach[2]])
    return np.array([vertices[:, 0].max() if symmetry is NONE else reach[0], reach[1], reach[2]])
