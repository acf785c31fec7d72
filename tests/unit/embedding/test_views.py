from dataclasses import replace

import numpy as np
import pytest

from neuse.embedding import views
from neuse.embedding.views import (
    HALF_CAMERA,
    MAX_POINTS,
    MIN_POINTS,
    POINT_UNIT_M,
    ViewParams,
    draw_camera,
    draw_layout,
    draw_view,
    ensure_shards,
    generate_shard,
    handle_share,
    sample_occupancy,
    write_shard,
)
from neuse.geometry import inverse, transform_points

from .conftest import CLEAN
from .tiny import block_bottle, block_mug, distance_to_surface

SMALL = ViewParams(views_per_shape=2, shapes_per_shard=1)


@pytest.fixture(scope="module")
def few_others():
    """One shape of clutter a category instead of ten."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(views, "CLUTTER_SHAPES", 1)
        yield


@pytest.fixture(scope="module")
def shard(few_others, tmp_path_factory):
    """A small generated shard of mugs."""
    path = tmp_path_factory.mktemp("generated") / "mug.npz"
    generate_shard(path, "mug", "train", 0, SMALL)
    return dict(np.load(path))


def generate(tmp_path, split, index):
    generate_shard(tmp_path / "again.npz", "mug", split, index, SMALL)
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
    assert len(set(views.SPLIT_SEEDS.values())) == len(views.SPLIT_SEEDS)


def test_fields_of_a_shard_fit_together(shard):
    n_views, n_shapes = SMALL.views_per_shape, SMALL.shapes_per_shard
    assert shard["points"].shape == (n_views, MAX_POINTS, 3)
    assert shard["points"].dtype == np.int16
    assert shard["T_camera_object"].shape == (n_views, 4, 4)
    assert shard["extents"].shape == (n_shapes, 3)
    assert shard["queries"].shape == (n_shapes, 4096, 3)
    assert (shard["n_points"] >= MIN_POINTS).all()
    np.testing.assert_array_equal(shard["shape"], np.repeat(np.arange(n_shapes), n_views))


@pytest.fixture(scope="module")
def clean_views():
    """Views of a solid mug among clutter, without any fault, and the mug."""
    rng, mug = np.random.default_rng(3), block_mug()
    layout = draw_layout(mug, [block_bottle()], rng, CLEAN)
    drawn = [draw_view(layout, rng, CLEAN) for _ in range(8)]
    return [view for view in drawn if view is not None], mug


def points_object(view):
    points_camera = view["points"] * POINT_UNIT_M + view["partial_center"]
    return transform_points(inverse(view["T_camera_object"].astype(float)), points_camera)


def test_points_of_a_view_without_faults_lie_on_the_object(clean_views):
    drawn, mug = clean_views
    assert len(drawn) >= 4
    for view in drawn:
        assert distance_to_surface(mug.mesh, points_object(view)[::16]).max() < 2e-4


def test_points_of_a_view_lie_in_front_of_the_camera(clean_views):
    for view in clean_views[0]:
        assert (view["points"] * POINT_UNIT_M + view["partial_center"])[:, 2].min() > 0.1


def test_partial_centre_is_the_mean_of_what_was_seen(clean_views):
    for view in clean_views[0]:
        n = int(view["n_points"])
        if n <= MAX_POINTS:
            np.testing.assert_allclose(view["points"][:n].mean(axis=0) * POINT_UNIT_M, 0.0, atol=1e-4)


def test_visible_share_is_a_share(clean_views):
    for view in clean_views[0]:
        assert 0.0 < view["visible"] <= 1.1  # counted on every third row and column


def test_faults_move_points_off_the_surface():
    rng, mug = np.random.default_rng(4), block_mug()
    noisy = replace(CLEAN, fixed_noise_m=0.003)
    view = draw_view(draw_layout(mug, [block_bottle()], rng, noisy), rng, noisy)
    error = distance_to_surface(mug.mesh, points_object(view)[::8])
    assert 0.001 < np.sqrt(np.mean(error**2)) < 0.0035
    assert view["noise_m"] == pytest.approx(0.003)


def test_view_of_too_few_points_is_none():
    rng = np.random.default_rng(5)
    far = replace(CLEAN, range_m=(40.0, 41.0))
    layout = draw_layout(block_mug(), [block_bottle()], rng, far)
    assert draw_view(layout, rng, far) is None


@pytest.mark.parametrize("seed", range(5))
def test_camera_sees_the_origin_at_its_range_and_elevation(seed):
    rng = np.random.default_rng(seed)
    azimuth, elevation, range_m = rng.uniform(0, 6.2), rng.uniform(-0.2, 1.4), rng.uniform(0.3, 5.0)
    T_camera_world = draw_camera(azimuth, elevation, range_m, rng)
    assert np.linalg.norm(T_camera_world[:3, 3]) == pytest.approx(range_m)
    x, y, z = inverse(T_camera_world)[:3, 3]
    assert z == pytest.approx(range_m * np.sin(elevation))
    assert np.arctan2(y, x) % (2 * np.pi) == pytest.approx(azimuth)
    assert HALF_CAMERA.window_around(T_camera_world[None, :3, 3]) is not None


def test_handle_share_counts_points_beyond_the_body():
    mug = block_mug()
    on_body, on_handle = [0.04, 0.0, 0.0], [0.06, 0.0, 0.0]
    assert handle_share(mug, np.array([on_body, on_body, on_body, on_handle])) == 0.25
    assert handle_share(mug, np.empty((0, 3))) == 0.0
    assert handle_share(block_bottle(), np.array([on_handle])) == 0.0


def test_occupancy_agrees_with_the_solid():
    sample = sample_occupancy(block_bottle().mesh, np.random.default_rng(6))
    r, z = np.linalg.norm(sample["queries"][:, :2], axis=1), sample["queries"][:, 2]
    inside = ((r < 0.035) & (np.abs(z + 0.03) < 0.07)) | ((r < 0.013) & (np.abs(z - 0.055) < 0.045))
    assert (sample["occupied"] == inside).mean() > 0.99  # the mesh has 48 sides
    assert 0.2 < inside.mean() < 0.7


def test_missing_shards_are_generated_and_others_left_alone(few_others, tmp_path):
    (tmp_path / "mug_train_0000.npz").write_bytes(b"made before")
    paths = ensure_shards(tmp_path, "mug", "train", 2, SMALL)
    assert [path.name for path in paths] == ["mug_train_0000.npz", "mug_train_0001.npz"]
    assert paths[0].read_bytes() == b"made before"
    assert len(np.load(paths[1])["points"]) == SMALL.views_per_shape


def test_interrupted_writing_leaves_no_shard(tmp_path, monkeypatch):
    def interrupted(path, **arrays):
        path.write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(np, "savez", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_shard(
            tmp_path / "x.npz",
            [block_mug()],
            [block_bottle()],
            replace(CLEAN, views_per_shape=1),
            np.random.default_rng(0),
        )
    assert not (tmp_path / "x.npz").exists()
