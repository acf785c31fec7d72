"""The user's own meshes as shapes: read, checked, closed, and turned into the object frame."""

import logging
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from neuse.errors import MeshError
from neuse.simulation.canonical import canonical_frame
from neuse.simulation.closing import solid_of
from neuse.simulation.mesh_files import PATTERN, mesh_paths, read_mesh
from neuse.simulation.self_similarity import find_symmetry
from neuse.simulation.shapes import Shape, categories, make_shape, symmetry_of
from neuse.simulation.textures import sample_texture
from neuse.symmetry import Symmetry

_log = logging.getLogger(__name__)

SIZE_RANGE_M = (0.01, 1.0)
OTHER_UNITS = {"millimetres": 0.001, "centimetres": 0.01}


def load_meshes(directory: str | Path, category: str, symmetry: Symmetry | None = None) -> list[Shape]:
    """Shapes from DIR/<category>/*.obj, *.ply, *.stl and *.glb, metres, in any orientation, sorted by file
    name; an empty list where DIR has no folder for this category.

    Args:
        symmetry: of the category; found from the meshes where neither told nor that of simulated shapes.
    Raises:
        MeshError: no such directory, no mesh in the category's folder, or a mesh that cannot be used.
    """
    folder = Path(directory) / category
    _check_directory(Path(directory), folder)
    return load_folder(folder, category, symmetry) if folder.is_dir() else []


def load_category(directory: str | Path, category: str, symmetry: Symmetry | None = None) -> list[Shape]:
    """As `load_meshes`, and from DIR itself where it has no folder for this category.

    Raises:
        MeshError: no such directory, no mesh, or one that cannot be used.
    """
    folder = Path(directory) / category
    _check_directory(Path(directory), folder)
    return load_folder(folder if folder.is_dir() else Path(directory), category, symmetry)


def load_folder(folder: Path, category: str, symmetry: Symmetry | None = None) -> list[Shape]:
    """The meshes of one folder as shapes of a category; see `load_meshes`.

    Raises:
        MeshError: there is none, or one that cannot be used.
    """
    paths = mesh_paths(folder)
    if not paths:
        raise MeshError(f"{folder} has no {PATTERN.replace('*', '')} file; put meshes in it or remove it")
    meshes = [_load(path) for path in paths]
    if symmetry is None:
        symmetry = symmetry_of(category) if category in categories() else find_symmetry(meshes)
    return _shapes([path.stem for path in paths], meshes, category, symmetry)


def _check_directory(directory: Path, folder: Path) -> None:
    if not directory.is_dir():
        raise MeshError(f"{directory} is not a directory; expected meshes in {folder}/{PATTERN}")


def _load(path: Path) -> trimesh.Trimesh:
    mesh = read_mesh(path)
    _check_size(mesh, path)
    return _closed(mesh, path)


def _shapes(
    names: Sequence[str], meshes: Sequence[trimesh.Trimesh], category: str, symmetry: Symmetry
) -> list[Shape]:
    shapes = []
    for name, mesh in zip(names, meshes, strict=True):
        mesh.apply_transform(canonical_frame(mesh, symmetry))
        rng = np.random.default_rng(zlib.crc32(name.encode()))
        texture = sample_texture(rng, float(mesh.extents[2]))
        shapes.append(make_shape(name, category, mesh, texture, symmetry))
    return shapes


def _closed(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    """The mesh as the surface of a solid: with vertices merged and holes filled, or else with walls."""
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    if not len(mesh.faces):
        raise MeshError(f"{path} has no face with an area; export it as the surface of a solid")
    trimesh.repair.fill_holes(mesh)
    trimesh.repair.fix_normals(mesh, multibody=True)
    if mesh.is_volume:
        parts = mesh.split()
        return trimesh.boolean.union(parts) if len(parts) > 1 else mesh
    _log.warning("%s is not closed: what is open in it becomes thin walls", path)
    try:
        return solid_of(mesh)
    except MeshError as error:
        raise MeshError(f"{path} is not closed: {error}; export it as a solid") from error


def _check_size(mesh: trimesh.Trimesh, path: Path) -> None:
    size, (low, high) = float(mesh.extents.max()), SIZE_RANGE_M
    if low <= size <= high:
        return
    for unit, scale in OTHER_UNITS.items():
        if size > 5.0 and low <= scale * size <= high:
            raise MeshError(
                f"{path} is {size:.4g} m large, so probably in {unit}; scale it by {scale:g} to metres"
            )
    raise MeshError(f"{path} is {size:.4g} m large, outside [{low}, {high}] m; scale it to its real size")
