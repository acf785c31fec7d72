"""Checks that several modules share."""

from collections.abc import Sequence

import numpy as np

from neuse.errors import ParamError
from neuse.geometry import Array


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Refuse a parameter that is none of the choices.

    Raises:
        ParamError: with the parameter, its value and the choices.
    """
    if value not in choices:
        raise ParamError(f"parameter {name} = {value!r} is unknown; choose one of {', '.join(choices)}")


def is_rigid(T: Array) -> bool:
    """Whether T is a finite (4, 4) rigid transform."""
    if np.shape(T) != (4, 4) or not np.isfinite(T).all():
        return False
    R = T[:3, :3]
    return bool(np.abs(R @ R.T - np.eye(3)).max() < 1e-5 and np.linalg.det(R) > 0)


def is_covariance(covariance: Array) -> bool:
    """Whether this is a finite, symmetric, positive definite (6, 6) matrix."""
    if np.shape(covariance) != (6, 6) or not np.isfinite(covariance).all():
        return False
    asymmetry = np.abs(covariance - covariance.T).max()
    return bool(asymmetry <= 1e-6 * np.abs(covariance).max() and np.linalg.eigvalsh(covariance)[0] > 0)
