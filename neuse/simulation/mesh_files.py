"""Mesh files: obj, ply, stl and glb as triangles, refused before they take memory."""

import json
import struct
from pathlib import Path

import numpy as np
import trimesh

from neuse.errors import MeshError

SUFFIXES = (".obj", ".ply", ".stl", ".glb")
PATTERN = "*.obj, *.ply, *.stl or *.glb"
MAX_BYTES = 200_000_000
MAX_FACES = 500_000


def mesh_paths(folder: Path) -> list[Path]:
    """The mesh files in a folder, sorted by name."""
    return sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES)


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Vertices and triangles of a file, all its parts in one, without materials.

    Raises:
        MeshError: it cannot be read, has no faces, or is larger than any mesh of use here.
    """
    _check_bytes(path)
    try:
        if path.suffix.lower() == ".glb":
            _check_glb(path)
        mesh = trimesh.load_mesh(path, process=False)
    except MeshError:
        raise
    except Exception as error:  # the readers raise whatever the damage makes them raise
        raise MeshError(f"{path} cannot be read as a mesh ({error}); export it again") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise MeshError(f"{path} has no faces; export it as a triangle mesh")
    if mesh.vertices.shape[1:] != (3,) or not np.isfinite(mesh.vertices).all():
        raise MeshError(f"{path} has vertices without three finite coordinates; export it again")
    if len(mesh.faces) > MAX_FACES:
        raise MeshError(f"{path} has {len(mesh.faces)} faces; simplify it to {MAX_FACES} or fewer")
    return trimesh.Trimesh(mesh.vertices, mesh.faces)  # materials have seams, which keep vertices apart


def _check_bytes(path: Path) -> None:
    if not path.is_file():
        raise MeshError(f"{path} is no file; give a mesh")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise MeshError(f"{path} has {size / 1e6:.0f} MB; simplify it to {MAX_BYTES / 1e6:.0f} MB or less")


def _check_glb(path: Path) -> None:
    """Arrays of a glb file may be declared without being stored, as zeros of any number."""
    with path.open("rb") as file:
        _, _, _, length, _ = struct.unpack("<4sIIII", file.read(20))
        accessors = json.loads(file.read(length)).get("accessors", [])
    declared = sum(int(accessor["count"]) for accessor in accessors)
    if declared > 10 * MAX_FACES:
        raise MeshError(f"{path} declares {declared} elements; simplify it to {MAX_FACES} faces or fewer")
