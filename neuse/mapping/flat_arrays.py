"""Lists of arrays of several lengths end to end in one, and checks of arrays that come from elsewhere.

What cannot be meant raises a ValueError.
"""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from neuse.geometry import Array

Arrays = dict[str, np.ndarray]


def joined(name: str, parts: Sequence[np.ndarray], width: int) -> Arrays:
    """Arrays (n_i, width) end to end, and their lengths."""
    flat = np.concatenate([np.zeros((0, width)), *parts])
    return {name: flat, f"{name}_lengths": np.array([len(part) for part in parts], dtype=np.int64)}


def split(name: str, arrays: Arrays, n: int, width: int) -> list[Array]:
    """What `joined` has joined, n parts."""
    flat = checked(arrays[name], (-1, width), np.float64)
    lengths = checked(arrays[f"{name}_lengths"], (n,), np.int64)
    if (lengths < 1).any() or lengths.sum() != len(flat):
        raise ValueError(f"{name} has other lengths than it says")
    return np.split(flat, np.cumsum(lengths)[:-1]) if n else []


def integers(rows: Iterable[Sequence[Any]], width: int) -> np.ndarray:
    """(n, width) int64, for no rows as well."""
    return np.array(list(rows), dtype=np.int64).reshape(-1, width)


def floats(rows: Iterable[Any], width: int) -> Array:
    """(n, width) float64, for no rows as well."""
    return np.array(list(rows), dtype=np.float64).reshape(-1, width)


def names(named: Any, n: int) -> list[str]:
    """The names of n categories, if these are such."""
    if (
        not isinstance(named, list)
        or len(named) != n
        or not all(isinstance(name, str) and name for name in named)
    ):
        raise ValueError(f"{n} categories are needed, not {str(named)[:80]}")
    return named


def integer(value: Any) -> int:
    """The value, if it is an integer of 64 bits."""
    if not isinstance(value, int) or isinstance(value, bool) or abs(value) >= 2**63:
        raise ValueError(f"{value!r} is no integer")
    return value


def rigid(rows: Array) -> Array:
    """(n, 4, 4) transforms of (n, 16) numbers."""
    T = rows.reshape(-1, 4, 4)
    square = T[:, :3, :3] @ T[:, :3, :3].transpose(0, 2, 1)
    if not (np.allclose(square, np.eye(3), atol=1e-6) and np.allclose(T[:, 3], [0, 0, 0, 1])):
        raise ValueError("a pose is none")
    return T


def checked(array: np.ndarray, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """The array, if it is of this type and shape (-1: any length) and finite."""
    fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
    if not fits or array.dtype != dtype or not np.isfinite(array).all():
        raise ValueError(f"{array.dtype} of shape {array.shape} instead of {shape}, or not finite")
    return array
