"""Shared checks."""

import numpy as np
import pytest

from neuse.errors import ParamError
from neuse.geometry import exp
from neuse.slam.checks import check_choice, is_covariance, is_rigid


def test_transforms_are_rigid_and_others_are_not():
    T = exp([0.1, 0.2, 0.3, 1, 2, 3])
    assert is_rigid(T)
    assert not is_rigid(np.diag([1.0, 1, -1, 1]) @ T)
    assert not is_rigid(1.1 * T)
    assert not is_rigid(T[:3])
    assert not is_rigid(np.full((4, 4), np.inf))


def test_only_positive_definite_symmetric_matrices_are_covariances():
    assert is_covariance(np.diag([1e-6, 1, 1, 1, 1, 1e3]))
    assert not is_covariance(np.zeros((6, 6)))
    assert not is_covariance(np.eye(5))
    assert not is_covariance(np.full((6, 6), np.nan))
    assert not is_covariance(np.eye(6) + np.triu(np.ones((6, 6)), 1))


def test_unknown_choice_names_the_known_ones():
    check_choice("mode", "b", ("a", "b"))
    with pytest.raises(ParamError, match="mode = 'c' is unknown; choose one of a, b"):
        check_choice("mode", "c", ("a", "b"))
