"""The user's own meshes as shapes: read, checked, and turned into the object frame."""

import zlib
from pathlib import Path

import numpy as np
import trimesh

from neuse.errors import MeshError
from neuse.simulation.canonical import canonical_frame
from neuse.simulation.shapes import Shape, make_shape
from neuse.simulation.textures import sample_texture

SUFFIXES = (".obj", ".ply", ".stl")
SIZE_RANGE_M = (0.01, 1.0)
MILLIMETRES_ABOVE = 5.0


def load_meshes(directory: str | Path, category: str) -> list[Shape]:
    """Shapes from DIR/<category>/*.obj, *.ply and *.stl, metres, in any orientation, sorted by file name.

    An empty list where DIR has no folder for this category.

    Raises:
        MeshError: no such directory, no mesh in the category's folder, or a mesh that cannot be used.
    """
    folder = Path(directory) / category
    if not Path(directory).is_dir():
        raise MeshError(f"{directory} is not a directory; expected meshes in {folder}/*.obj, *.ply or *.stl")
    if not folder.is_dir():
        return []
    paths = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise MeshError(f"{folder} has no .obj, .ply or .stl file; put meshes in it or remove it")
    return [_load_shape(path, category) for path in paths]


def _load_shape(path: Path, category: str) -> Shape:
    mesh = _closed(_read(path), path)
    _check_size(mesh, path)
    mesh.apply_transform(canonical_frame(mesh, category))
    rng = np.random.default_rng(zlib.crc32(path.stem.encode()))
    return make_shape(path.stem, category, mesh, sample_texture(rng, float(mesh.extents[2])))


def _read(path: Path) -> trimesh.Trimesh:
    try:
        mesh = trimesh.load_mesh(path, process=True)
    except Exception as error:  # the readers raise whatever the damage makes them raise
        raise MeshError(f"{path} cannot be read as a mesh ({error}); export it again") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise MeshError(f"{path} has no faces; export it as a triangle mesh")
    return trimesh.Trimesh(mesh.vertices, mesh.faces)  # without materials, whose seams keep vertices apart


def _closed(mesh: trimesh.Trimesh, path: Path) -> trimesh.Trimesh:
    """The mesh with coinciding vertices merged, small holes filled and normals outwards."""
    mesh.merge_vertices()
    mesh.update_faces(mesh.nondegenerate_faces() & mesh.unique_faces())
    mesh.remove_unreferenced_vertices()
    trimesh.repair.fill_holes(mesh)
    trimesh.repair.fix_normals(mesh, multibody=True)
    if not mesh.is_volume:
        raise MeshError(
            f"{path} is not closed; close its holes and merge its vertices, so that it bounds a solid"
        )
    parts = mesh.split()
    return trimesh.boolean.union(parts) if len(parts) > 1 else mesh


def _check_size(mesh: trimesh.Trimesh, path: Path) -> None:
    size, (low, high) = float(mesh.extents.max()), SIZE_RANGE_M
    if size > MILLIMETRES_ABOVE:
        raise MeshError(
            f"{path} is {size:.4g} m large, so probably in millimetres; scale it by 0.001 to metres"
        )
    if not low <= size <= high:
        raise MeshError(f"{path} is {size:.4g} m large, outside [{low}, {high}] m; scale it to its real size")
