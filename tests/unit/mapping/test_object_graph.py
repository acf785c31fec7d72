import numpy as np
import pytest

from neuse import geometry
from neuse.geometry import transform_points
from neuse.mapping.object_graph import Anchor, LayoutParams, align_graphs, is_unchanged

PARAMS = LayoutParams()
X = np.array([1.0, 0.0, 0.0])
PLACES = np.array([[0.3, 0.0, 0.0], [-0.2, 0.3, 0.0], [-0.1, -0.3, 0.02], [0.1, 0.1, 0.05]])


def anchors_seen_through(T_observed_reference, places=PLACES):
    observed = transform_points(T_observed_reference, places)
    return [Anchor(i, o, r, 0) for i, (o, r) in enumerate(zip(observed, places, strict=True))]


def test_drift_of_a_frame_is_taken_out():
    drift = geometry.exp([0.0, 0.0, 0.0, 0.3, -0.2, 0.1])
    T = align_graphs(anchors_seen_through(drift), PARAMS)
    np.testing.assert_allclose(T @ drift, np.eye(4), atol=1e-9)


def test_turned_frame_is_turned_back_without_prior():
    drift = geometry.exp([0.02, 0.01, 0.2, 0.3, -0.2, 0.1])
    T = align_graphs(anchors_seen_through(drift), LayoutParams(rotation_prior_m=0.0))
    np.testing.assert_allclose(T @ drift, np.eye(4), atol=1e-9)


def test_one_wrong_anchor_among_four_hardly_matters():
    anchors = anchors_seen_through(geometry.exp([0, 0, 0, 0.3, -0.2, 0.1]))
    anchors[0] = Anchor(0, anchors[0].observed + np.array([0.1, 0.0, 0.0]), anchors[0].reference, 0)
    T = align_graphs(anchors, PARAMS)
    np.testing.assert_allclose(transform_points(T, anchors[3].observed), PLACES[3], atol=0.02)


def test_lone_anchor_is_trusted_only_where_it_confirms_the_pose():
    near, far = geometry.exp([0, 0, 0, 0.01, 0, 0]), geometry.exp([0, 0, 0, 0.1, 0, 0])
    assert align_graphs(anchors_seen_through(near, PLACES[:1]), PARAMS) is not None
    assert align_graphs(anchors_seen_through(far, PLACES[:1]), PARAMS) is None


def test_no_anchors_give_no_alignment_and_no_verdict():
    assert align_graphs([], PARAMS) is None
    assert is_unchanged(np.zeros(3), np.zeros(3), [], PARAMS) is None


@pytest.mark.parametrize("seed", range(5))
def test_verdict_does_not_depend_on_drift(seed):
    rng = np.random.default_rng(seed)
    known = np.array([0.05, -0.1, 0.0])
    drift = geometry.exp(np.concatenate([rng.normal(scale=0.02, size=3), rng.normal(scale=0.3, size=3)]))
    anchors = anchors_seen_through(drift)
    assert is_unchanged(transform_points(drift, known + 0.01 * X), known, anchors, PARAMS) is True
    assert is_unchanged(transform_points(drift, known + 0.06 * X), known, anchors, PARAMS) is False


def test_a_single_agreeing_edge_means_unchanged():
    """NeuSE eq. 10: the other anchors may all have been displaced."""
    anchors = anchors_seen_through(np.eye(4))
    moved = [Anchor(a.object_id, a.observed + 0.2 * X, a.reference, 0) for a in anchors[1:]]
    assert is_unchanged(np.zeros(3), np.zeros(3), [*moved, *anchors[:1]], PARAMS) is True
