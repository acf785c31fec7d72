"""How well stated covariances are corrected by what objects tell."""

import numpy as np
import pytest

from neuse.geometry import exp
from neuse.slam.odometry import Motion
from neuse.slam.trust import GATE_SIGMAS, Trust, contradict

STATED = np.diag([0.01] * 3 + [0.03] * 3) ** 2
SEEN = np.diag([0.004] * 3 + [0.006] * 3) ** 2
STEP = exp([0.0, 0.1, 0.0, 0.3, 0.0, 0.1])


def experience(factors, n=60, seed=0, seen_covariance=SEEN):
    """A trust that has compared n motions, whose variances are the stated ones times the factors."""
    rng, trust = np.random.default_rng(seed), Trust()
    sigmas = np.sqrt(np.repeat(factors, 3) * np.diag(STATED))
    for _ in range(n):
        told = Motion(STEP @ exp(sigmas * rng.normal(size=6)), STATED)
        seen = STEP @ exp(np.sqrt(np.diag(seen_covariance)) * rng.normal(size=6))
        trust.learn(told, Motion(seen, seen_covariance))
    return trust


@pytest.mark.parametrize("factors", [(1.0, 1.0), (4.0, 0.25), (0.25, 16.0), (100.0, 100.0)])
@pytest.mark.parametrize("seed", range(3))
def test_sigmas_are_found_within_a_factor_of_one_and_a_half(factors, seed):
    found = np.sqrt(experience(factors, seed=seed).factors)
    assert np.abs(np.log(found / np.sqrt(factors))).max() < np.log(1.5)


def test_what_objects_cannot_tell_stays_nearly_as_stated():
    found = experience((0.01, 0.01), seen_covariance=100 * STATED).factors
    assert np.all((found > 0.3) & (found < 1.5))


def test_noise_that_has_grown_is_found_and_forgotten_again():
    trust, rng = experience((1.0, 1.0)), np.random.default_rng(1)
    factors = []
    for sigma in (0.3, 0.03):
        for _ in range(150):
            told = Motion(STEP @ exp(np.r_[np.zeros(3), sigma * rng.normal(size=3)]), STATED)
            trust.learn(told, Motion(STEP, SEEN))
        factors.append(trust.factors[1])
    np.testing.assert_allclose(np.sqrt(factors), [10.0, 1.0], rtol=0.5)


def test_a_lie_now_and_then_is_no_noise():
    trust = experience((1.0, 1.0))
    before = trust.factors.copy()
    trust.learn(Motion(STEP @ exp([0, 0, 0, 3.0, 0, 0]), STATED), Motion(STEP, SEEN))
    assert 1.0 < trust.factors[1] / before[1] < 3.0


def test_scaled_covariances_stay_covariances_and_are_no_less_than_wished():
    trust = experience((4.0, 0.04))
    A = np.random.default_rng(0).normal(size=(6, 6))
    motion = Motion(STEP, A @ A.T)
    scaled = trust.scaled(motion).covariance
    assert np.linalg.eigvalsh(scaled)[0] > 0
    np.testing.assert_allclose(np.diag(scaled), np.repeat(trust.factors, 3) * np.diag(motion.covariance))
    np.testing.assert_allclose(trust.scaled(motion, 1.0).covariance[3:, 3:], motion.covariance[3:, 3:])


@pytest.mark.parametrize(("share", "expected"), [(0.9, False), (1.1, True)])
def test_motions_contradict_each_other_beyond_the_gate(share, expected):
    sigma = np.sqrt(STATED[3, 3] + SEEN[3, 3])
    told = Motion(exp([0, 0, 0, share * GATE_SIGMAS * sigma, 0, 0]), STATED)
    assert contradict(told, Motion(np.eye(4), SEEN)) == expected
