"""Whether a record is what its docstring says: finite numbers, rigid transforms, covariances, sizes."""

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from neuse.embedding.code import Code
from neuse.records import Intrinsics, MapObject, ObservedFrame, TrackedFrame
from neuse.slam.checks import is_rigid

FAR_M = 1e8  # beyond all places, and far from where arithmetic fails
LATEST_NS = 2**31 * 10**9


def assert_sound(record: Any, name: str = "record") -> None:
    """Go through a record, its fields and theirs."""
    if is_dataclass(record):
        _check_kind(record, name)
        for field in fields(record):
            _check_field(field.name, getattr(record, field.name), f"{name}.{field.name}")
            assert_sound(getattr(record, field.name), f"{name}.{field.name}")
    elif isinstance(record, tuple | list):
        for index, item in enumerate(record):
            assert_sound(item, f"{name}[{index}]")
    elif isinstance(record, float | np.ndarray) and np.asarray(record).dtype.kind == "f":
        assert np.isfinite(record).all(), f"{name} is not finite: {record}"
        if np.shape(record) != (6, 6):  # covariances may grow for years
            assert np.abs(record).max(initial=0) < FAR_M, f"{name} is beyond all measure: {record}"


def _check_field(field: str, value: Any, name: str) -> None:
    if field.startswith("T_") and value is not None:
        assert is_rigid(value), f"{name} is no rigid transform: {value}"
    elif field == "covariance":
        assert np.allclose(value, value.T, rtol=1e-4), f"{name} is not symmetric: {value}"
        assert np.linalg.eigvalsh(value)[0] >= -1e-6 * np.abs(value).max(), f"{name} is negative: {value}"
    elif field.endswith("stamp_ns"):
        assert 0 <= value < LATEST_NS, f"{name} is no time: {value}"


def _check_kind(record: Any, name: str) -> None:
    match record:
        case Code():
            k = len(record.z)
            assert record.z.shape == (k, 3), f"{name}.z is no (k, 3)"
            assert record.descriptor.shape == (k,), f"{name}.descriptor is no (k,)"
            assert k in range(4, 4096, 2), f"{name} has k = {k}"
            assert (record.sigmas > 0).all(), f"{name}.sigmas are not positive"
            assert abs(record.height_correlation) <= 1, f"{name}.height_correlation is none"
            assert record.category, f"{name} has no category"
        case Intrinsics():
            assert min(record.width, record.height, record.fx, record.fy) > 0, f"{name}: {record}"
        case ObservedFrame() | TrackedFrame():
            assert (record.coarse_depth_m >= 0).all(), f"{name}.coarse_depth_m is negative"
        case MapObject():
            assert (record.box_size >= 0).all(), f"{name}.box_size is negative"
