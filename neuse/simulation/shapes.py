"""Object shapes in their own frame: what the simulator places, renders and supervises with."""

from dataclasses import dataclass, field

import numpy as np
import trimesh

from neuse.errors import InputError
from neuse.geometry import Array
from neuse.simulation.bottles import sample_bottle
from neuse.simulation.mugs import sample_mug
from neuse.simulation.textures import Color, Texture, sample_texture, texture_color

__all__ = ["Shape", "Texture", "categories", "is_ambiguous", "make_shape", "sample_shape", "texture_color"]

SPLITS = ("train", "validation", "test")
HELD_OUT_SHARE = 0.25

_SAMPLERS = {"mug": sample_mug, "bottle": sample_bottle}
_AMBIGUOUS = {"mug": False, "bottle": True}


@dataclass(frozen=True, eq=False)  # compared and hashed by identity
class Shape:
    """An object in its own frame, metres.

    The z axis is the axis of the body and points to the opening, the origin lies on it at mid height; the
    handle of a mug points to +x.

    ambiguous: a turn about z does not change the shape (as for bottles).    mesh: closed, normals outwards.
    extents: (3,) x reach of the handle from the axis (without a handle: largest radius), y largest radius of
        the body, z half height.    texture: colours of the surface.
    """

    name: str
    category: str
    ambiguous: bool
    mesh: trimesh.Trimesh
    extents: Array
    texture: Texture = field(default_factory=Texture)

    @property
    def color(self) -> Color:
        """Base colour, RGB."""
        return self.texture.color_a


def categories() -> tuple[str, ...]:
    """Categories that `sample_shape` knows."""
    return tuple(_SAMPLERS)


def is_ambiguous(category: str) -> bool:
    """Whether objects of the category are taken to be the same all around their axis."""
    return _AMBIGUOUS.get(category, False)


def sample_shape(category: str, rng: np.random.Generator, split: str = "train") -> Shape:
    """A random shape.

    Every split has the common families; a quarter of the shapes for "validation" and "test" come from those
    that "train" never shows: bodies `stepped` and `octagonal` and handles `hook` and `triangle` for mugs,
    `gourd`, `cone` and `amphora` for bottles.

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


def make_shape(name: str, category: str, mesh: trimesh.Trimesh, texture: Texture | None = None) -> Shape:
    """A shape from a closed mesh that is already in the object frame."""
    ambiguous = is_ambiguous(category)
    return Shape(name, category, ambiguous, mesh, _extents(mesh, ambiguous), texture or Texture())


def _extents(mesh: trimesh.Trimesh, ambiguous: bool) -> Array:
    vertices = mesh.vertices
    half_height = np.abs(vertices[:, 2]).max()
    if ambiguous:
        radius = np.linalg.norm(vertices[:, :2], axis=1).max()
        return np.array([radius, radius, half_height])
    return np.array([vertices[:, 0].max(), np.abs(vertices[:, 1]).max(), half_height])
