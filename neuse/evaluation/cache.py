"""What takes long to make is made once: records in .npz files, of which reading executes nothing.

A record is a dataclass of numbers, texts, arrays, and tuples or dictionaries of such. Its arrays are laid end
to end, one member of the file for each type of number; all else is JSON. The types of its fields say how to
read it.
"""

import json
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import fields, is_dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import NoneType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np

from neuse.mapping.archive import read_arrays

RecordT = TypeVar("RecordT")
Arrays = dict[str, list[np.ndarray]]


def cached(path: Path, kind: type[RecordT], make: Callable[[], RecordT]) -> RecordT:
    """What the file holds; where there is none, what `make` makes is put there first."""
    if path.exists():
        return load_record(path, kind)
    record = make()
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    save_record(partial, record)
    partial.rename(path)
    return record


def save_record(path: Path, record: Any) -> None:
    """Write a record to a file."""
    arrays: Arrays = defaultdict(list)
    tree = json.dumps(_packed(record, arrays)).encode()
    members: dict[str, Any] = {
        name: np.concatenate([array.ravel() for array in parts]) for name, parts in arrays.items()
    }
    with path.open("wb") as file:
        np.savez_compressed(file, tree=np.frombuffer(tree, dtype=np.uint8), **members)


def load_record(path: Path, kind: type[RecordT]) -> RecordT:
    """Read a record from a file.

    Raises:
        MapFileError, ValueError, OSError, zipfile.BadZipFile, zlib.error: as archive.read_arrays.
    """
    members = read_arrays(path)
    tree = json.loads(members.pop("tree").tobytes())
    return _unpacked(tree, kind, {name: _Reel(member) for name, member in members.items()})


class _Reel:
    """Arrays of one type of number, laid end to end."""

    def __init__(self, numbers: np.ndarray) -> None:
        self._numbers, self._start = numbers, 0

    def next(self, shape: list[int]) -> np.ndarray:
        end = self._start + int(np.prod(shape))
        array = self._numbers[self._start : end].reshape(shape).copy()
        self._start = end
        return array


def _packed(value: Any, arrays: Arrays) -> Any:
    """The value as JSON has it; an array leaves its type and shape."""
    if isinstance(value, np.ndarray):
        arrays[value.dtype.name].append(value)
        return [value.dtype.name, *value.shape]
    if is_dataclass(value):
        return [_packed(getattr(value, field.name), arrays) for field in fields(value)]
    if isinstance(value, tuple):
        return [_packed(item, arrays) for item in value]
    if isinstance(value, dict):
        return {key: _packed(item, arrays) for key, item in value.items()}
    if isinstance(value, Enum):
        return value.value
    return value.item() if isinstance(value, np.generic) else value


def _unpacked(tree: Any, kind: Any, reels: dict[str, _Reel]) -> Any:
    origin, arguments = get_origin(kind) or kind, get_args(kind)
    if NoneType in arguments:
        (kind,) = (argument for argument in arguments if argument is not NoneType)
        return None if tree is None else _unpacked(tree, kind, reels)
    if origin is np.ndarray:
        return reels[tree[0]].next(tree[1:])
    if isinstance(kind, type) and is_dataclass(kind):
        return kind(*_items(tree, _kinds(kind), reels))
    if origin is tuple:
        return tuple(_items(tree, [arguments[0]] * len(tree), reels))
    if origin is dict:
        return {key: _unpacked(item, arguments[1], reels) for key, item in tree.items()}
    return kind(tree)


def _items(trees: list[Any], kinds: list[Any], reels: dict[str, _Reel]) -> Iterator[Any]:
    return (_unpacked(tree, kind, reels) for tree, kind in zip(trees, kinds, strict=True))


@cache
def _kinds(record: Any) -> list[Any]:
    """Types of a record's fields."""
    hints = get_type_hints(record)
    return [hints[field.name] for field in fields(record)]
