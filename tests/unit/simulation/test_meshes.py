"""Reading the user's own meshes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from neuse.errors import MeshError
from neuse.simulation.meshes import load_category, load_meshes
from neuse.simulation.shapes import sample_shape
from neuse.symmetry import AXIAL, HALF_TURN, NONE


@pytest.fixture
def mug() -> trimesh.Trimesh:
    return sample_shape("mug", np.random.default_rng(4)).mesh.copy()


def export(mesh: trimesh.Trimesh, directory: Path, name: str, category: str = "mug") -> Path:
    path = directory / category / name
    path.parent.mkdir(exist_ok=True)
    mesh.export(path)
    return path


@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_mug_with_y_up_becomes_a_shape_in_the_object_frame(
    mug: trimesh.Trimesh, tmp_path: Path, suffix: str
) -> None:
    expected = mug.extents
    y_up = trimesh.transformations.rotation_matrix(-np.pi / 2, [1, 0, 0])
    export(mug.apply_transform(y_up), tmp_path, f"cup.{suffix}")
    (shape,) = load_meshes(tmp_path, "mug")
    assert (shape.name, shape.category, shape.ambiguous) == ("cup", "mug", False)
    assert shape.mesh.is_volume
    np.testing.assert_allclose(shape.mesh.extents, expected, atol=1e-3)
    assert shape.mesh.bounds[1, 0] > -shape.mesh.bounds[0, 0] + 0.005


def test_shapes_come_in_the_order_of_their_names_and_look_the_same_each_time(
    mug: trimesh.Trimesh, tmp_path: Path
) -> None:
    for name in ("b.ply", "a.stl", "notes.txt"):
        export(mug, tmp_path, name) if name != "notes.txt" else (tmp_path / "mug" / name).write_text("x")
    first, second = load_meshes(tmp_path, "mug"), load_meshes(tmp_path, "mug")
    assert [shape.name for shape in first] == ["a", "b"]
    assert [shape.texture for shape in first] == [shape.texture for shape in second]
    np.testing.assert_array_equal(first[0].mesh.vertices, second[0].mesh.vertices)


def test_small_hole_and_inverted_faces_are_repaired(mug: trimesh.Trimesh, tmp_path: Path) -> None:
    volume = mug.volume
    mug.update_faces(np.arange(len(mug.faces)) != 100)
    mug.invert()
    export(mug, tmp_path, "cup.ply")
    (shape,) = load_meshes(tmp_path, "mug")
    assert shape.mesh.is_volume
    assert shape.mesh.volume == pytest.approx(volume, rel=1e-3)


def test_overlapping_parts_are_joined(tmp_path: Path) -> None:
    body = trimesh.creation.cylinder(radius=0.03, height=0.15)
    cap = trimesh.creation.cylinder(radius=0.02, height=0.06).apply_translation([0, 0, 0.09])
    export(trimesh.util.concatenate([body, cap]), tmp_path, "bottle.ply", "bottle")
    (shape,) = load_meshes(tmp_path, "bottle")
    assert shape.mesh.body_count == 1
    assert shape.mesh.volume < body.volume + 0.8 * cap.volume
    assert shape.mesh.bounds[1, 2] == pytest.approx(0.0975, abs=1e-3)


def test_category_without_a_folder_has_no_meshes(tmp_path: Path) -> None:
    assert load_meshes(tmp_path, "bottle") == []


def test_symmetry_of_an_unknown_category_is_found_or_told(tmp_path: Path) -> None:
    export(trimesh.creation.cylinder(radius=0.04, height=0.1), tmp_path, "a.ply", "kettle")
    assert [shape.symmetry for shape in load_meshes(tmp_path, "kettle")] == [AXIAL]
    assert [shape.symmetry for shape in load_meshes(tmp_path, "kettle", HALF_TURN)] == [HALF_TURN]


def test_symmetry_of_a_known_category_is_known(tmp_path: Path) -> None:
    export(trimesh.creation.cylinder(radius=0.04, height=0.1), tmp_path, "a.ply", "mug")
    assert [shape.symmetry for shape in load_meshes(tmp_path, "mug")] == [NONE]


def test_meshes_of_one_category_may_lie_in_the_folder_itself(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.1, 0.05, 0.07))
    box.export(tmp_path / "loose.stl")
    assert [shape.name for shape in load_category(tmp_path, "carton")] == ["loose"]
    export(box, tmp_path, "own.stl", "carton")
    assert [shape.name for shape in load_category(tmp_path, "carton")] == ["own"]
    assert [shape.category for shape in load_category(tmp_path, "other")] == ["other"]


def test_missing_directory_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match="not a directory"):
        load_meshes(tmp_path / "none", "mug")


def test_folder_without_meshes_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mug").mkdir()
    with pytest.raises(MeshError, match=r"no \.obj"):
        load_meshes(tmp_path, "mug")


def test_open_mesh_is_closed_and_told_by_name(mug: trimesh.Trimesh, tmp_path: Path, caplog) -> None:
    mug.update_faces(mug.triangles_center[:, 2] < 0.01)
    export(mug, tmp_path, "open.ply")
    (shape,) = load_meshes(tmp_path, "mug")
    assert shape.mesh.is_volume
    assert "open.ply is not closed" in caplog.text


@pytest.mark.parametrize(
    ("scale", "remedy"),
    [(1000.0, r"millimetres; scale it by 0\.001"), (130.0, r"centimetres; scale it by 0\.01")],
)
def test_mesh_in_another_unit_is_refused_with_the_remedy(tmp_path: Path, scale: float, remedy: str) -> None:
    export(trimesh.creation.box((0.04, 0.04, 0.06)).apply_scale(scale), tmp_path, "cup.stl")
    with pytest.raises(MeshError, match=rf"cup\.stl.*{remedy}"):
        load_meshes(tmp_path, "mug")


@pytest.mark.parametrize("scale", [0.01, 20.0, 1e6])
def test_mesh_of_unreasonable_size_is_refused(mug: trimesh.Trimesh, tmp_path: Path, scale: float) -> None:
    export(mug.apply_scale(scale), tmp_path, "cup.stl")
    with pytest.raises(MeshError, match="real size"):
        load_meshes(tmp_path, "mug")


@pytest.mark.parametrize("content", [b"", b"ply\nnonsense", b"v 0 0 0\nv 1 0 0\n"])
@pytest.mark.parametrize("suffix", ["obj", "ply", "stl", "glb"])
def test_damaged_or_empty_file_is_refused_by_name(tmp_path: Path, content: bytes, suffix: str) -> None:
    (tmp_path / "mug").mkdir()
    (tmp_path / "mug" / f"bad.{suffix}").write_bytes(content)
    with pytest.raises(MeshError, match=rf"bad\.{suffix}"):
        load_meshes(tmp_path, "mug")


def test_mesh_of_faces_without_area_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mug").mkdir()
    (tmp_path / "mug" / "line.obj").write_text("v 0 0 0\nv 0.1 0 0\nv 0.2 0 0\nf 1 2 3\n")
    with pytest.raises(MeshError, match=r"line\.obj has no face with an area"):
        load_meshes(tmp_path, "mug")


def test_solid_with_a_vertex_that_is_not_finite_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mug").mkdir()
    box = trimesh.creation.box((0.1, 0.1, 0.1))
    box.vertices[0, 0] = np.nan
    (tmp_path / "mug" / "box.ply").write_bytes(trimesh.exchange.ply.export_ply(box))
    with pytest.raises(MeshError, match=r"box\.ply has vertices without three finite"):
        load_meshes(tmp_path, "mug")


@pytest.mark.parametrize("corner", ["0.1 0.1", "nan 0 0"])
def test_mesh_without_three_finite_coordinates_is_refused(tmp_path: Path, corner: str) -> None:
    (tmp_path / "mug").mkdir()
    plane = len(corner.split()) == 2
    others = ["0 0", "0.1 0", "0 0.1"] if plane else ["0 0 0", "0.1 0 0", "0 0.1 0"]
    lines = [f"v {point}" for point in [*others, corner]] + ["f 1 2 3", "f 1 2 4", "f 1 3 4", "f 2 3 4"]
    (tmp_path / "mug" / "a.obj").write_text("\n".join(lines))
    with pytest.raises(MeshError, match=r"a\.obj"):
        load_meshes(tmp_path, "mug")
