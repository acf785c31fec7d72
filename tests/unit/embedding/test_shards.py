import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from neuse.embedding import shards
from neuse.embedding.shards import (
    ShapeSource,
    ensure_shards,
    generate_shard,
    sample_occupancy,
    write_shard,
)
from neuse.embedding.views import MAX_POINTS, MIN_POINTS, ViewParams
from neuse.errors import InputError, MeshError
from neuse.simulation.shapes import make_shape

from .conftest import CLEAN
from .tiny import block_bottle, block_mug

MUGS = ShapeSource("mug")
SMALL = ViewParams(views_per_shape=2, shapes_per_shard=1)


@pytest.fixture(scope="module")
def few_others():
    """One shape of clutter a category instead of ten."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(shards, "CLUTTER_SHAPES", 1)
        yield


@pytest.fixture(scope="module")
def shard(few_others, tmp_path_factory):
    """A small generated shard of mugs."""
    path = tmp_path_factory.mktemp("generated") / "mug.npz"
    generate_shard(path, MUGS, "train", 0, SMALL)
    return dict(np.load(path))


def generate(tmp_path, split, index):
    generate_shard(tmp_path / "again.npz", MUGS, split, index, SMALL)
    return dict(np.load(tmp_path / "again.npz"))


def test_shard_is_fixed_by_its_name(shard, tmp_path):
    again = generate(tmp_path, "train", 0)
    assert again.keys() == shard.keys()
    for name, array in shard.items():
        np.testing.assert_array_equal(again[name], array, err_msg=name)


@pytest.mark.parametrize(("split", "index"), [("validation", 0), ("train", 1)])
def test_shards_of_other_splits_and_indices_hold_other_shapes_and_views(shard, tmp_path, split, index):
    other = generate(tmp_path, split, index)
    assert not np.array_equal(other["extents"], shard["extents"])
    assert not np.isin(other["T_camera_object"][:, 0, 0], shard["T_camera_object"][:, 0, 0]).any()


def test_splits_draw_from_different_seeds():
    assert len(set(shards.SPLIT_SEEDS.values())) == len(shards.SPLIT_SEEDS)


def test_fields_of_a_shard_fit_together(shard):
    n_views, n_shapes = SMALL.views_per_shape, SMALL.shapes_per_shard
    assert shard["points"].shape == (n_views, MAX_POINTS, 3)
    assert shard["points"].dtype == np.int16
    assert shard["T_camera_object"].shape == (n_views, 4, 4)
    assert shard["extents"].shape == (n_shapes, 3)
    assert shard["queries"].shape == (n_shapes, 4096, 3)
    assert (shard["n_points"] >= MIN_POINTS).all()
    np.testing.assert_array_equal(shard["shape"], np.repeat(np.arange(n_shapes), n_views))


def test_occupancy_agrees_with_the_solid():
    sample = sample_occupancy(block_bottle().mesh, np.random.default_rng(6))
    r, z = np.linalg.norm(sample["queries"][:, :2], axis=1), sample["queries"][:, 2]
    inside = ((r < 0.035) & (np.abs(z + 0.03) < 0.07)) | ((r < 0.013) & (np.abs(z - 0.055) < 0.045))
    assert (sample["occupied"] == inside).mean() > 0.99  # the mesh has 48 sides
    assert 0.2 < inside.mean() < 0.7


@pytest.fixture(scope="module")
def folder(few_others, tmp_path_factory):
    """A folder with one small shard of mugs."""
    folder = tmp_path_factory.mktemp("folder")
    ensure_shards(folder, MUGS, "train", 1, SMALL)
    return folder


def test_missing_shards_are_generated_and_others_left_alone(few_others, folder, tmp_path):
    first = tmp_path / "mug_train_0000.npz"
    first.write_bytes((folder / first.name).read_bytes())
    before = first.stat().st_mtime_ns
    paths = ensure_shards(tmp_path, MUGS, "train", 2, SMALL)
    assert [path.name for path in paths] == ["mug_train_0000.npz", "mug_train_0001.npz"]
    assert first.stat().st_mtime_ns == before
    assert len(np.load(paths[1])["points"]) == SMALL.views_per_shape


def test_shard_records_how_it_was_drawn(folder):
    record = json.loads(str(np.load(folder / "mug_train_0000.npz")["record"]))
    assert record["views_per_shape"] == SMALL.views_per_shape
    assert record["shapes"] == "simulated"


def test_shard_of_other_parameters_is_refused_by_its_name(folder):
    with pytest.raises(InputError, match=r"mug_train_0000\.npz was drawn with .*delete the shards"):
        ensure_shards(folder, MUGS, "train", 1, replace(SMALL, range_m=(1.0, 2.0)))


def test_shard_without_a_record_is_taken_as_it_is(folder, tmp_path):
    arrays = dict(np.load(folder / "mug_train_0000.npz"))
    del arrays["record"]
    np.savez(tmp_path / "mug_train_0000.npz", **arrays)
    assert len(ensure_shards(tmp_path, MUGS, "train", 1, replace(SMALL, range_m=(1.0, 2.0)))) == 1


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 half"])
def test_damaged_shard_is_refused_by_its_name(tmp_path, content):
    (tmp_path / "mug_train_0000.npz").write_bytes(content)
    with pytest.raises(InputError, match=r"mug_train_0000\.npz is no shard"):
        ensure_shards(tmp_path, MUGS, "train", 1, SMALL)


def test_interrupted_writing_leaves_no_shard(tmp_path, monkeypatch):
    def interrupted(path, **arrays):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    few, rng = replace(CLEAN, views_per_shape=1), np.random.default_rng(0)
    with pytest.raises(KeyboardInterrupt):
        write_shard(tmp_path / "x.npz", [block_mug()], [block_bottle()], few, rng)
    assert not (tmp_path / "x.npz").exists()


def test_shape_that_no_layout_shows_is_refused(tmp_path):
    far, rng = replace(CLEAN, views_per_shape=1, range_m=(40.0, 41.0)), np.random.default_rng(0)
    with pytest.raises(InputError, match="block_mug"):
        write_shard(tmp_path / "x.npz", [block_mug()], [block_bottle()], far, rng)


def test_layouts_are_drawn_until_the_shape_is_seen(monkeypatch):
    seen = iter([None] * 4 + [{}])
    monkeypatch.setattr(shards, "draw_view", lambda *arguments: next(seen))
    few, rng = replace(CLEAN, views_per_shape=1), np.random.default_rng(0)
    assert shards._draw_views(block_mug(), [block_bottle()], few, rng) == [{}]


@pytest.fixture
def meshes(tmp_path, monkeypatch):
    """A folder with six mugs of the user's own, of six heights; named, since reading them takes seconds."""
    shapes = [
        make_shape(str(i), "mug", block_mug().mesh.copy().apply_scale([1, 1, 0.6 + 0.1 * i]))
        for i in range(6)
    ]
    monkeypatch.setattr(shards, "load_category", lambda folder, category, symmetry: list(shapes))
    monkeypatch.setattr(shards, "remove_one", shapes.pop, raising=False)
    return tmp_path


def test_own_meshes_are_held_out_from_training(meshes):
    source, rng = ShapeSource("mug", meshes), np.random.default_rng(0)
    names = {
        split: {shape.name for shape in source.draw(12, split, rng)} for split in ("train", "validation")
    }
    assert names == {"train": {"1", "2", "3", "4"}, "validation": {"0", "5"}}


def test_each_draw_of_an_own_mesh_is_another_shape(meshes):
    drawn = ShapeSource("mug", meshes).draw(8, "train", np.random.default_rng(0))
    ratios = {round(float(shape.extents[2] / shape.extents[0]), 6) for shape in drawn}
    assert len(ratios) == 8
    assert all(shape.mesh.is_watertight for shape in drawn)


def test_shards_of_own_meshes_and_of_simulated_shapes_are_not_mixed(few_others, meshes, folder):
    with pytest.raises(InputError, match=r"asks for .*meshes"):
        ensure_shards(folder, ShapeSource("mug", meshes), "train", 1, SMALL)


def test_record_of_own_meshes_changes_with_them(meshes):
    before = ShapeSource("mug", meshes).record
    assert ShapeSource("mug", meshes).record == before
    shards.remove_one()
    assert ShapeSource("mug", meshes).record != before


@pytest.mark.parametrize("folder", [".", "kettle"])
def test_fewer_than_two_meshes_are_refused(tmp_path, folder):
    (tmp_path / folder).mkdir(exist_ok=True)
    trimesh.creation.box([0.1, 0.1, 0.1]).export(tmp_path / folder / "one.ply")
    with pytest.raises(MeshError, match="holds 1 meshes of kettle"):
        ShapeSource("kettle", tmp_path)
