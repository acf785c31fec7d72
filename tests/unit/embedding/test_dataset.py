import numpy as np
import pytest

from neuse.embedding.dataset import ViewSet
from neuse.embedding.network import UNIT_M
from neuse.embedding.views import POINT_UNIT_M
from neuse.symmetry import AXIAL, NONE

from .tiny import block_mug, distance_to_surface

N_POINTS, N_QUERIES = 64, 40


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def to_object(points, target, extents):
    """(n, 3) points of a batch, metres in the object frame that the target describes."""
    R = target[:, 1:] * UNIT_M / extents
    return (points - target[:, 0]) * UNIT_M @ R


def stretched_mug(scales):
    mesh = block_mug().mesh
    mesh.apply_scale(scales)
    return mesh


@pytest.mark.parametrize("scales", [None, (1.2, 1.2, 0.8), (0.8, 0.8, 1.3)], ids=str)
def test_points_lie_on_the_object_that_the_target_describes(mug_views, rng, scales):
    index = np.arange(0, len(mug_views), 4)
    factors = None if scales is None else np.tile(scales, (len(index), 1))
    batch = mug_views.batch(index, N_POINTS, N_QUERIES, rng, factors)
    scales = np.array(scales or (1, 1, 1))
    mesh, extents = stretched_mug(scales), block_mug().extents * scales
    for points, target in zip(batch.points.numpy(), batch.target.numpy(), strict=True):
        R = target[:, 1:] * UNIT_M / extents
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-5)
        assert distance_to_surface(mesh, to_object(points, target, extents)).max() < 2e-4


@pytest.mark.parametrize("scales", [(1.0, 1.0, 1.0), (1.2, 1.2, 0.8)], ids=str)
def test_queries_are_inside_the_object_where_the_batch_says_so(mug_views, rng, scales):
    batch = mug_views.batch(np.array([0, 7]), N_POINTS, N_QUERIES, rng, np.tile(scales, (2, 1)))
    mesh, extents = stretched_mug(scales), block_mug().extents * scales
    for queries, target, occupied in zip(
        *(x.numpy() for x in (batch.queries, batch.target, batch.occupied)), strict=True
    ):
        points = to_object(queries, target, extents)
        sure = distance_to_surface(mesh, points) > 1e-5
        np.testing.assert_array_equal(mesh.contains(points)[sure], occupied[sure])


def test_target_of_an_ambiguous_object_is_its_axis_alone(shard_folder, mug_views, rng):
    as_ambiguous = ViewSet([shard_folder / "mug_train_0000.npz"], AXIAL)
    index = np.arange(3)
    target = as_ambiguous.batch(index, N_POINTS, N_QUERIES, rng).target
    full = mug_views.batch(index, N_POINTS, N_QUERIES, rng).target
    assert (target[..., 1:3] == 0).all()
    assert (target[..., [0, 3]] == full[..., [0, 3]]).all()


def test_batch_is_a_function_of_the_seed(mug_views):
    first, again, other = (
        mug_views.draw(np.random.default_rng(seed), 2, 3, N_POINTS, N_QUERIES) for seed in (1, 1, 2)
    )
    for a, b in zip(first, again, strict=True):
        assert (a == b).all()
    assert (first.points != other.points).any()


def test_drawn_batch_groups_views_by_shape(mug_views, rng):
    batch = mug_views.draw(rng, 2, 3, N_POINTS, N_QUERIES)
    assert sorted(np.bincount(batch.shape.numpy())) == [3, 3]
    assert (batch.shape[:3] == batch.shape[0]).all()
    np.testing.assert_array_equal(mug_views.shape[batch.view.numpy()], batch.shape.numpy())
    assert batch.points.shape == (6, N_POINTS, 3)
    assert batch.queries.shape == (6, N_QUERIES, 3)
    assert batch.occupied.shape == (6, N_QUERIES)


def test_no_view_is_drawn_twice_while_there_are_others(mug_views):
    for seed in range(10):
        batch = mug_views.draw(np.random.default_rng(seed), 2, 4, N_POINTS, N_QUERIES)
        assert len(batch.view.unique()) == 8


def test_views_of_one_drawn_shape_are_stretched_alike_and_round(mug_views, rng):
    batch = mug_views.draw(rng, 2, 3, N_POINTS, N_QUERIES)
    extents = batch.target[..., 1:].norm(dim=1).numpy() * UNIT_M
    factors = extents / block_mug().extents
    np.testing.assert_allclose(factors[:, 0], factors[:, 1], rtol=1e-5)
    np.testing.assert_allclose(factors[:3], np.tile(factors[0], (3, 1)), rtol=1e-5)
    assert np.abs(factors - 1).max() > 0.01


def test_shapes_of_several_shards_stay_apart(shard_folder):
    paths = [shard_folder / f"mug_{split}_0000.npz" for split in ("train", "validation")]
    views, first = ViewSet(paths, NONE), ViewSet(paths[:1], NONE)
    assert views.n_shapes == 4
    assert len(views) > len(first)
    assert set(views.shape[len(first) :]) == {2, 3}


def test_background_points_are_replaced_as_the_front_end_drops_them(shard_folder, tmp_path):
    arrays = dict(np.load(shard_folder / "mug_train_0000.npz"))
    clean = ViewSet([shard_folder / "mug_train_0000.npz"], NONE)
    leaked = arrays["points"].copy()
    leaked[:, 5:90] = [0, 0, int(0.8 / POINT_UNIT_M)]  # a wall 0.8 m behind
    np.savez(tmp_path / "leaked.npz", **arrays | {"points": leaked})
    views = ViewSet([tmp_path / "leaked.npz"], NONE)
    points_m = views.arrays["points"] * POINT_UNIT_M
    assert np.linalg.norm(points_m, axis=-1).max() < 0.3
    np.testing.assert_allclose(points_m.mean(axis=1), 0.0, atol=1e-4)
    shift = np.linalg.norm(views.arrays["partial_center"] - clean.arrays["partial_center"], axis=1)
    assert shift.max() < 0.01
