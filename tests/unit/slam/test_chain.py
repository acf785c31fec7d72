"""What tied a keyframe to others goes over to its stand-in."""

import numpy as np
import pytest

from neuse.geometry import adjoint, exp, inverse
from neuse.records import Edge, EdgeKind
from neuse.slam.chain import STAND_IN_COVARIANCE, Chain

POSES = [exp(np.r_[0.1 * i, 0.2, 0.1, i, 0.5 * i, 0.0]) for i in range(6)]
COVARIANCE = np.diag([0.01, 0.02, 0.03, 0.1, 0.2, 0.3]) ** 2


def edge(i, j):
    T_i_j = inverse(POSES[i]) @ POSES[j]
    return Edge(i, j, 10 * i, 10 * j, EdgeKind.ODOMETRY, T_i_j, COVARIANCE)


def chain_of(*ends):
    chain = Chain()
    for i, j in ends:
        chain.add(edge(i, j))
    return chain


def hand_over(chain, left, stand_in):
    return chain.hand_over(left, stand_in, inverse(POSES[stand_in]) @ POSES[left])


def test_edges_of_both_directions_lead_to_the_stand_in():
    before, after = hand_over(chain_of((1, 2), (2, 3)), left=2, stand_in=5)
    assert [(e.from_id, e.to_id) for e in (before, after)] == [(1, 5), (5, 3)]
    for e in (before, after):
        np.testing.assert_allclose(e.T_from_to, inverse(POSES[e.from_id]) @ POSES[e.to_id], atol=1e-12)


@pytest.mark.parametrize(("ends", "swapped"), [((2, 3), False), ((1, 2), True)])
def test_covariance_is_that_of_the_edge_and_of_the_place_beside_the_stand_in(ends, swapped):
    """Against many noisy pairs of both."""
    rng, count = np.random.default_rng(0), 4000
    (handed,) = hand_over(chain_of(ends), left=2, stand_in=5)
    T_stand_in_left, T_edge = inverse(POSES[5]) @ POSES[2], edge(*ends).T_from_to
    xi = rng.normal(size=(count, 6)) * np.sqrt(np.diag(COVARIANCE))
    zeta = rng.normal(size=(count, 6)) * np.sqrt(np.diag(STAND_IN_COVARIANCE))
    if swapped:
        A = adjoint(T_stand_in_left)
        errors = xi @ A.T + zeta @ A.T
    else:
        errors = xi + zeta @ adjoint(inverse(T_edge)).T
    np.testing.assert_allclose(handed.covariance, np.cov(errors.T), atol=0.06 * handed.covariance.max())


def test_edge_to_the_stand_in_itself_is_gone():
    assert hand_over(chain_of((1, 2)), left=2, stand_in=1) == []


def test_two_keyframes_are_tied_once_however_often_the_camera_passes():
    chain = chain_of((0, 1), (2, 3))
    assert [(e.from_id, e.to_id) for e in hand_over(chain, left=2, stand_in=0)] == [(0, 3)]
    assert hand_over(chain, left=3, stand_in=1) == []
    assert hand_over(chain, left=3, stand_in=1) == []


def test_edges_go_over_again_when_the_other_end_leaves():
    chain = chain_of((1, 2), (2, 3), (3, 4))
    hand_over(chain, left=2, stand_in=0)
    ends = {(e.from_id, e.to_id) for e in hand_over(chain, left=3, stand_in=5)}
    assert ends == {(0, 5), (5, 4)}
