import errno
import json
import os
from pathlib import Path

import numpy as np
import pytest

from neuse.embedding.code import Code
from neuse.errors import MapFileError
from neuse.mapping.map_file import StoredKeyframe, StoredMap, StoredObject, load_map, save_map

from .synthetic import CAMERA

RNG = np.random.default_rng(0)


def stored_map(n_objects=2, n_keyframes=3):
    objects = tuple(
        StoredObject(
            i, "mug", 2, 10, 20, 5, -30, -1, 4.5,
            Code("mug", False, RNG.normal(size=(8, 3)), RNG.normal(size=8), RNG.random(6), -0.25),
            RNG.normal(size=(20, 3)),
        )
        for i in range(n_objects)
    )  # fmt: skip
    keyframes = tuple(
        StoredKeyframe(
            i - 9,
            np.eye(4),
            CAMERA,
            RNG.integers(0, 65535, (6, 8)).astype(np.uint16),
            {1: RNG.normal(size=3)},
        )
        for i in range(n_keyframes)
    )
    return StoredMap(123, objects, keyframes)


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


@pytest.mark.parametrize(("n_objects", "n_keyframes"), [(2, 3), (0, 0), (1, 0)])
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
        {"z_0": np.zeros((8, 2))},
        {"z_0": np.full((8, 3), np.nan)},
        {"sigmas_1": np.zeros(5)},
        {"depth_1": np.zeros((6, 8))},
        {"pose_2": None},
        {"objects": None},
        {"seen_ids_0": np.array([1, 2])},
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


@pytest.mark.parametrize(
    ("entry", "value"),
    [("object_id", "7"), ("object_id", 2**63), ("last_tick", 1.5), ("weight", 0.0), ("weight", float("nan")),
     ("category", ""), ("category", 4), ("height_correlation", 2.0), ("status", 9)],
)  # fmt: skip
def test_entry_that_is_none_is_refused(tmp_path, entry, value):
    path = tmp_path / "map.npz"
    save_map(path, stored_map())
    with np.load(path) as file:
        objects = json.loads(file["header"].tobytes())["objects"]
    objects[1][entry] = value
    with pytest.raises(MapFileError, match="damaged"):
        load_map(rewritten(path, objects=objects))


@pytest.mark.parametrize(
    "changes",
    [
        {"sigmas_0": np.full(6, -1.0)},
        {"pose_1": np.ones((4, 4))},
        {"points_0": np.zeros((0, 3))},
        {"depth_0": np.zeros((0, 8), np.uint16)},
    ],
    ids=["sigmas", "pose", "no points", "no depth"],
)
def test_numbers_that_mean_nothing_are_refused(tmp_path, changes):
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
        save_map(path, stored_map(5, 9))
    assert_equal(load_map(path), stored)
    assert [file.name for file in tmp_path.iterdir()] == ["map.npz"]


def test_objects_in_a_pickle_are_never_loaded(tmp_path):
    path = tmp_path / "map.npz"
    rewritten(path, z_0=np.array([{"a": 1}], dtype=object))
    with pytest.raises(MapFileError, match="damaged"):
        load_map(path)
