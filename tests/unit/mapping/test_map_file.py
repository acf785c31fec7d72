import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from neuse.embedding.code import Code
from neuse.errors import MapFileError
from neuse.geometry import make_transform
from neuse.mapping.map_file import load_map, save_map
from neuse.mapping.stored_map import StoredKeyframe, StoredMap, StoredObject
from neuse.mapping.views import View
from neuse.records import ChangeKind, ObjectChange

from .synthetic import CAMERA

RNG = np.random.default_rng(0)


def view(ambiguous=False):
    z, descriptor = RNG.normal(size=(8, 3)), RNG.normal(size=8)
    code = Code("mug", ambiguous, z, descriptor, 0.1 + RNG.random(6), -0.25)
    return View(code, RNG.normal(size=(int(RNG.integers(1, 20)), 3)), 4.5)


def stored_map(n_objects=2, n_keyframes=3):
    objects = tuple(
        StoredObject(i, "mug", 2, 10, 20, 5, -30, -1, {0: view(), 2: view(ambiguous=True)})
        for i in range(n_objects)
    )
    depths = [RNG.integers(0, 65535, (6, 8)).astype(np.uint16), None]
    keyframes = tuple(
        StoredKeyframe(i - 9, np.eye(4), CAMERA, depths[i % 2], {1: RNG.normal(size=3)})
        for i in range(n_keyframes)
    )
    changes = (
        ObjectChange(5, ChangeKind.REMOVED, 1, "mug", np.eye(4), None),
        ObjectChange(7, ChangeKind.MOVED, 0, "mug", np.eye(4), make_transform(np.eye(3), [1, 2, 3]), 9),
    )
    return StoredMap(123, objects, keyframes, changes[: 2 * bool(n_objects)])


def assert_equal(one, other):
    """Deep equality of dataclasses with arrays."""
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, other)
    elif hasattr(one, "__dataclass_fields__"):
        assert type(one) is type(other)
        for name in one.__dataclass_fields__:
            assert_equal(getattr(one, name), getattr(other, name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_equal(a, b)
    elif isinstance(one, dict):
        assert one.keys() == other.keys()
        for key in one:
            assert_equal(one[key], other[key])
    else:
        assert one == other


@pytest.mark.parametrize(("n_objects", "n_keyframes"), [(2, 3), (0, 0), (0, 4)])
def test_map_survives_the_round_trip(tmp_path, n_objects, n_keyframes):
    stored = stored_map(n_objects, n_keyframes)
    save_map(tmp_path / "map.npz", stored)
    assert_equal(load_map(tmp_path / "map.npz"), stored)
    assert [path.name for path in tmp_path.iterdir()] == ["map.npz"]


def test_missing_file_is_refused(tmp_path):
    with pytest.raises(MapFileError, match="no map file"):
        load_map(tmp_path / "none.npz")


def test_place_that_cannot_be_written_is_refused(tmp_path):
    with pytest.raises(MapFileError, match="cannot write"):
        save_map(tmp_path / "no_folder" / "map.npz", stored_map())


def test_folder_is_refused(tmp_path):
    with pytest.raises(MapFileError):
        load_map(tmp_path)


@pytest.mark.parametrize(
    "content", [b"", b"hello", b"PK\x03\x04 but no zip"], ids=["empty", "text", "broken zip"]
)
def test_foreign_file_is_refused(tmp_path, content):
    (tmp_path / "map.npz").write_bytes(content)
    with pytest.raises(MapFileError, match="damaged or no map"):
        load_map(tmp_path / "map.npz")


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95])
def test_truncated_file_is_refused(tmp_path, share):
    path = tmp_path / "map.npz"
    save_map(path, stored_map())
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(MapFileError, match="damaged"):
        load_map(path)


def test_flipped_byte_is_noticed_or_harmless(tmp_path):
    path, stored = tmp_path / "map.npz", stored_map()
    save_map(path, stored)
    whole, refused = path.read_bytes(), 0
    for position in range(0, len(whole), 41):
        damaged = bytearray(whole)
        damaged[position] ^= 0xFF
        path.write_bytes(damaged)
        try:
            assert_equal(load_map(path), stored)
        except MapFileError:
            refused += 1
    assert refused > len(whole) / 41 / 3


def rewritten(path, **changes):
    """The file at `path` with some of its arrays or header entries replaced, or left out if None."""
    save_map(path, stored_map())
    with np.load(path) as file:
        arrays = dict(file)
    header = json.loads(arrays["header"].tobytes())
    for name, value in changes.items():
        target = header if name in header else arrays
        if value is None:
            del target[name]
        else:
            target[name] = value
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    with open(path, "wb") as file:
        np.savez(file, **arrays)
    return path


def test_other_version_is_refused_by_its_number(tmp_path):
    with pytest.raises(MapFileError, match="version 99"):
        load_map(rewritten(tmp_path / "map.npz", version=99))


def test_archive_of_another_program_is_refused(tmp_path):
    with pytest.raises(MapFileError, match="no map file of this program"):
        load_map(rewritten(tmp_path / "map.npz", format="other"))


@pytest.mark.parametrize(
    "changes",
    [
        {"view_z": np.zeros((32, 2))},
        {"view_z": np.full((32, 3), np.nan)},
        {"view_numbers": np.ones((4, 7))},
        {"depths": np.zeros(96)},
        {"poses": None},
        {"objects": None},
        {"seen_centers": np.zeros((2, 3))},
        {"views": np.zeros((5, 3), np.int64)},
        {"header": None},
    ],
    ids=[
        "code of wrong shape",
        "not finite",
        "short",
        "float depth",
        "missing array",
        "no objects",
        "unequal",
        "too many",
        "none",
    ],
)
def test_wrong_content_is_refused(tmp_path, changes):
    path = tmp_path / "map.npz"
    if "header" in changes:
        np.savez(path, z_0=np.zeros((8, 3)))
    else:
        rewritten(path, **changes)
    with pytest.raises(MapFileError, match="damaged"):
        load_map(path)


def changed(name, where, value):
    """An array of a sound map with one of its values replaced."""

    def change(arrays):
        array = arrays[name].copy()
        array[where] = value
        return {name: array}

    return change


@pytest.mark.parametrize(
    "change",
    [
        changed("objects", (1, 0), 0), changed("objects", (0, 0), -1), changed("objects", (0, 1), 9),
        changed("objects", (0, 5), 1), changed("objects", (0, 4), -1),
        changed("views", (0, 1), 3), changed("views", (0, 0), -1), changed("views", (slice(None), 0), 0),
        changed("view_numbers", (0, 2), 0.0), changed("view_numbers", (0, 6), 2.0),
        changed("view_numbers", (0, 7), 0.0), changed("view_points_lengths", 0, 0),
        changed("view_z_lengths", 1, 7), changed("poses", (1, 0), 2.0), changed("ticks", (0, 0), 1),
        changed("intrinsics", (0, 2), -600.0), changed("depth_shapes", (0, 0), -6),
        changed("depth_shapes", (0, 1), 9), changed("seen", (0, 1), -4), changed("changes", (0, 1), 7),
        changed("change_poses", (0, 5), 3.0),
    ],
)  # fmt: skip
def test_numbers_that_mean_nothing_are_refused(tmp_path, change):
    path = tmp_path / "map.npz"
    save_map(path, stored_map())
    with np.load(path) as file:
        changes = change(dict(file))
    with pytest.raises(MapFileError, match="damaged"):
        load_map(rewritten(path, **changes))


@pytest.mark.parametrize(
    "changes",
    [{"categories": ["mug", 4]}, {"categories": ["mug", ""]}, {"categories": ["mug"]}, {"categories": None},
     {"change_categories": ["mug"]}, {"change_categories": ["mug", 1]},
     {"stamp_ns": 2**63}, {"stamp_ns": 1.5}, {"stamp_ns": True}],
)  # fmt: skip
def test_header_entry_that_is_none_is_refused(tmp_path, changes):
    with pytest.raises(MapFileError, match="damaged"):
        load_map(rewritten(tmp_path / "map.npz", **changes))


@pytest.mark.parametrize("name", ["", "/", "/dev/null"])
def test_place_that_is_no_file_is_refused_and_left_alone(name):
    before = Path(name).stat()
    with pytest.raises(MapFileError, match="no name of a file"):
        save_map(Path(name), stored_map())
    assert Path(name).stat().st_mode == before.st_mode


def test_full_disk_leaves_the_old_map_and_no_remains(tmp_path, monkeypatch):
    path, stored = tmp_path / "map.npz", stored_map()
    save_map(path, stored)

    def fill(number):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", fill)
    with pytest.raises(MapFileError, match="No space left"):
        save_map(path, stored_map(5, 3))
    assert_equal(load_map(path), stored)
    assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]


def test_objects_in_a_pickle_are_never_loaded(tmp_path):
    path = tmp_path / "map.npz"
    rewritten(path, view_z=np.array([{"a": 1}], dtype=object))
    with pytest.raises(MapFileError, match="damaged"):
        load_map(path)
