"""Mesh files are read whole, or refused before they take memory."""

import json
import struct
from pathlib import Path

import pytest
import trimesh

from neuse.errors import MeshError
from neuse.simulation import mesh_files
from neuse.simulation.mesh_files import mesh_paths, read_mesh


def glb(content: dict[str, object]) -> bytes:
    """A glb file with no binary chunk."""
    text = json.dumps(content).encode()
    text += b" " * (-len(text) % 4)
    chunk = struct.pack("<II", len(text), 0x4E4F534A) + text
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk


def test_parts_of_a_scene_are_read_in_their_places(tmp_path: Path) -> None:
    scene, moved = trimesh.Scene(), trimesh.transformations.translation_matrix([0.3, 0, 0])
    scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)))
    scene.add_geometry(trimesh.creation.box((0.1, 0.1, 0.1)), transform=moved)
    scene.export(tmp_path / "two.glb")
    mesh = read_mesh(tmp_path / "two.glb")
    assert mesh.extents[0] == pytest.approx(0.4)
    assert len(mesh.faces) == 24


def test_files_of_meshes_are_found_by_their_endings(tmp_path: Path) -> None:
    for name in ("b.PLY", "a.glb", "notes.txt", "c.stl", "d.obj"):
        (tmp_path / name).touch()
    assert [path.name for path in mesh_paths(tmp_path)] == ["a.glb", "b.PLY", "c.stl", "d.obj"]


def test_file_of_absurd_size_is_refused_unread(tmp_path: Path) -> None:
    path = tmp_path / "huge.ply"
    with path.open("wb") as file:
        file.truncate(10**12)  # sparse
    with pytest.raises(MeshError, match=r"huge\.ply has 1000000 MB; simplify it"):
        read_mesh(path)


def test_array_declared_but_not_stored_is_refused(tmp_path: Path) -> None:
    accessors = [{"componentType": 5126, "count": 10**11, "type": "VEC3"}]
    (tmp_path / "zeros.glb").write_bytes(glb({"asset": {"version": "2.0"}, "accessors": accessors}))
    with pytest.raises(MeshError, match=r"zeros\.glb declares 100000000000 elements"):
        read_mesh(tmp_path / "zeros.glb")


def test_mesh_of_too_many_faces_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mesh_files, "MAX_FACES", 11)
    trimesh.creation.box().export(tmp_path / "fine.ply")
    with pytest.raises(MeshError, match=r"has 12 faces; simplify it to 11"):
        read_mesh(tmp_path / "fine.ply")


@pytest.mark.parametrize("content", [b"", b"glTF", glb({"accessors": [{"count": "x"}]}), glb({}), b"x" * 40])
def test_damaged_glb_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "bad.glb").write_bytes(content)
    with pytest.raises(MeshError, match=r"bad\.glb"):
        read_mesh(tmp_path / "bad.glb")


def test_folder_with_the_name_of_a_mesh_is_refused(tmp_path: Path) -> None:
    (tmp_path / "folder.obj").mkdir()
    with pytest.raises(MeshError, match=r"folder\.obj is no file"):
        read_mesh(tmp_path / "folder.obj")
