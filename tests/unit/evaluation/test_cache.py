"""Records in files: all comes back as it was, and a file can do no more than hold data."""

import pickle
import zipfile
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np
import pytest
from nodes import samples

from neuse.errors import MapFileError
from neuse.evaluation.cache import cached, load_record, save_record
from neuse.evaluation.trajectory import Trajectory
from neuse.evaluation.truth import TrueMap, TrueObject, Truth
from neuse.records import ChangeKind, ObjectChange, ObservedFrame, TrackedFrame


@dataclass(frozen=True)
class Pair:
    """Frames of two kinds, by name, and numbers."""

    frames: tuple[ObservedFrame, ...]
    tracked: dict[str, TrackedFrame]
    level: float
    note: str = ""
    truth: Truth | None = None


def pair() -> Pair:
    trajectory = Trajectory(np.array([1, 2**60]), np.stack([samples.transform(1), samples.transform(2)]))
    thing = TrueObject(3, "mug", samples.transform(4), np.ones(3))
    changes = tuple(map(samples.change, ChangeKind))
    truth = Truth(trajectory, (TrueMap(1, (thing,)),), changes, (1,))
    frame = samples.observed_frame()
    empty = replace(frame, observations=(), rejections=())
    return Pair((frame, empty), {"a b": samples.tracked_frame()}, float("inf"), "né", truth)


def assert_same(one: Any, other: Any) -> None:
    """Equal to the last digit, with equal types."""
    assert type(one) is type(other)
    if isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        np.testing.assert_array_equal(one, other)
        assert one.flags.writeable
    elif is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple | dict):
        assert len(one) == len(other)
        for a, b in zip(*(x.items() if isinstance(x, dict) else x for x in (one, other)), strict=True):
            assert_same(a, b)
    else:
        assert one == other


@pytest.mark.parametrize("record", [pair(), replace(pair(), frames=(), truth=None)])
def test_record_comes_back_as_it_was(tmp_path, record):
    save_record(tmp_path / "a.npz", record)
    assert_same(load_record(tmp_path / "a.npz", Pair), record)


def test_numbers_of_numpy_come_back_as_the_field_says(tmp_path):
    change = replace(samples.change(ChangeKind.MOVED), object_id=np.int64(7))
    save_record(tmp_path / "a.npz", change)
    assert type(load_record(tmp_path / "a.npz", ObjectChange).object_id) is int


def test_record_is_made_once_and_a_stopped_making_leaves_nothing(tmp_path):
    path = tmp_path / "new" / "a.npz"

    def stopped() -> Pair:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        cached(path, Pair, stopped)
    assert not path.exists()
    assert_same(cached(path, Pair, pair), cached(path, Pair, stopped))
    assert [file.name for file in path.parent.iterdir()] == ["a.npz"]


class Bomb:
    def __reduce__(self):
        return (pytest.fail, ("executed",))


@pytest.mark.parametrize("write", [
    lambda path: path.write_bytes(pickle.dumps(Bomb())),
    lambda path: np.savez(path, tree=np.array([Bomb()], dtype=object)),
])  # fmt: skip
def test_pickle_is_refused_and_nothing_runs(tmp_path, write):
    write(tmp_path / "a.npz")
    with pytest.raises((ValueError, zipfile.BadZipFile)):
        load_record(tmp_path / "a.npz", Pair)


def test_folder_is_refused(tmp_path):
    with pytest.raises(MapFileError, match="is no file"):
        load_record(tmp_path, Pair)
