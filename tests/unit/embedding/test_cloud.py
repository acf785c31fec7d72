import numpy as np
import pytest

from neuse.embedding.cloud import ENOUGH, REACH_M, core

from .tiny import partial_cloud


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def test_background_that_leaked_through_the_mask_is_dropped(rng):
    seen = partial_cloud(rng, 400)
    wall = rng.uniform(-0.3, 0.3, (60, 3)) + np.array([0.1, -0.2, 2.5])
    kept = core(np.concatenate([seen, wall]))
    assert kept[:400].all()
    assert not kept[400:].any()


@pytest.mark.parametrize("size_m", [[0.01, 0.03, 0.03], [0.06, 0.06, 0.3], [0.12, 0.12, 0.02]], ids=str)
def test_compact_object_is_kept_whole(rng, size_m):
    assert core(rng.uniform(-1, 1, (500, 3)) * size_m).all()


def test_nothing_beyond_the_reach_is_kept_however_large_the_cloud(rng):
    points = rng.uniform(-2, 2, (500, 3))
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    np.testing.assert_array_equal(core(points), distance <= REACH_M)


def test_answer_moves_with_the_cloud(rng):
    points = rng.standard_t(2, (300, 3)) * 0.03
    np.testing.assert_array_equal(core(points + np.array([1.0, -2.0, 3.0])), core(points))


def test_clouds_of_a_batch_are_judged_each_by_itself(rng):
    batch = rng.standard_t(2, (3, 200, 3)) * [[[0.01]], [[0.05]], [[0.2]]]
    np.testing.assert_array_equal(core(batch), np.stack([core(points) for points in batch]))


def test_single_point_and_coinciding_points_are_kept():
    assert core(np.zeros((1, 3))).all()
    assert core(np.ones((20, 3))).all()


def test_large_cloud_is_judged_as_its_points_are_spread(rng):
    points = rng.standard_t(2, (20 * ENOUGH, 3)) * 0.01
    distance = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    reach = distance[core(points)].max()
    assert reach == pytest.approx(2.5 * np.quantile(distance, 0.75), rel=0.05)
    assert (distance[~core(points)] > 0.99 * reach).all()
