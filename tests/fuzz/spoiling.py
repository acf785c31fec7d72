"""Ways to spoil what is sound: fields of messages, bytes of files, entries of JSON."""

from array import array
from collections.abc import Iterator, Sequence
from functools import cache
from typing import Any

import numpy as np
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message

FLOATS = st.sampled_from(
    [float("nan"), float("inf"), float("-inf"), 0.0, -1.0, 2.0, 1e-300, 1e9, 1e300, -1e300, 5e-324]
) | st.floats(width=32)
INTEGERS = st.sampled_from([0, 1, 2, 3, 7, 255, 256, 65535, 2**31 - 1, 2**32 - 1, 2**63 - 1, -1, -(2**31)])
TEXTS = st.sampled_from(
    ["", " ", "mug\x00", "../mug", "é" * 300, "16UC1", "32FC1", "8UC3", "mono8"]
) | st.text(max_size=20)
LENGTHS = st.sampled_from([0, 1, 2, 3, 5, 7, 240, 1000])
Change = tuple[
    tuple[str | int, ...], Any, int
]  # where, a value for each kind of field, which place of arrays


def spoiled_messages(message: Any) -> st.SearchStrategy[Any]:
    """Copies of a message with one to three fields spoiled, as a subscriber would get them."""
    changes = st.tuples(st.sampled_from(leaves(message)), _values(), st.integers(0, 2**16))
    data, kind = serialize_message(message), type(message)

    def spoil(chosen: Sequence[Change]) -> Any:
        copy = deserialize_message(data, kind)
        for path, values, place in chosen:
            _spoil(copy, path, values, place)
        return copy

    return st.lists(changes, min_size=1, max_size=3).map(spoil)


def leaves(message: Any) -> list[tuple[str | int, ...]]:
    """Paths to all fields of a message and of those inside it; arrays of messages are a field as well."""
    return list(_walk(message, ()))


def _walk(message: Any, path: tuple[str | int, ...]) -> Iterator[tuple[str | int, ...]]:
    for name in message.get_fields_and_field_types():
        value = getattr(message, name)
        if hasattr(value, "get_fields_and_field_types"):
            yield from _walk(value, (*path, name))
        elif isinstance(value, list) and value and hasattr(value[0], "get_fields_and_field_types"):
            yield (*path, name)
            for index, item in enumerate(value):
                yield from _walk(item, (*path, name, index))
        else:
            yield (*path, name)


def _values() -> st.SearchStrategy[Any]:
    return st.fixed_dictionaries({"float": FLOATS, "int": INTEGERS, "text": TEXTS, "length": LENGTHS})


def _spoil(message: Any, path: tuple[str | int, ...], values: dict[str, Any], place: int) -> None:
    owner = message
    for step in path[:-1]:
        if isinstance(step, int) and step >= len(owner):
            return  # another change has shortened the array
        owner = owner[step] if isinstance(step, int) else getattr(owner, step)
    name = str(path[-1])
    kind = owner.get_fields_and_field_types()[name]
    setattr(owner, name, _spoiled(getattr(owner, name), kind, values, place))


def _spoiled(value: Any, kind: str, values: dict[str, Any], place: int) -> Any:
    match value:
        case bool():
            return not value
        case int():
            return _fitting(values["int"], kind)
        case float():
            return values["float"]
        case str():
            return values["text"]
        case np.ndarray():  # of fixed length
            copy = value.copy()
            copy[slice(None) if place % 4 == 0 else place % len(copy)] = values["float"]
            return copy
        case array():
            return _spoiled_array(value, values, place)
        case _:
            return _resized(value, values["length"], kind)


def _spoiled_array(value: array, values: dict[str, Any], place: int) -> array:
    if place % 2 or not value:
        return _resized(value, values["length"] if place % 3 else max(len(value) - 1, 0), "")
    copy = array(value.typecode, value)
    number = values["float"] if value.typecode in "fd" else abs(values["int"]) % 256
    copy[place % len(copy)] = np.float32(number).item() if value.typecode == "f" else number
    return copy


def _resized(value: Any, length: int, kind: str) -> Any:
    """The array at another length, its items over and over; bounded arrays stay within their bound."""
    bound = int(kind.split("<=")[1].rstrip("]>")) if "<=" in kind else len(value) + length
    wanted = min(length, bound)
    repeated = value * (wanted // max(len(value), 1) + 1) if len(value) else value
    return repeated[:wanted]


@cache
def _limits(kind: str) -> tuple[int, int]:
    info = np.iinfo(kind.replace("octet", "uint8").replace("char", "uint8"))
    return int(info.min), int(info.max)


def _fitting(number: int, kind: str) -> int:
    low, high = _limits(kind)
    return min(max(number, low), high)


def spoiled_bytes(whole: bytes) -> st.SearchStrategy[bytes]:
    """A file that was cut, overwritten in places, or has too much; or that is another altogether."""
    places = st.integers(0, max(len(whole) - 1, 0))
    patch = st.tuples(places, st.binary(min_size=1, max_size=8) | _big_numbers())
    patched = st.lists(patch, min_size=1, max_size=4).map(lambda patches: _patched(whole, patches))
    cut = places.map(lambda end: whole[:end])
    moved = st.tuples(places, places).map(lambda ends: whole[: ends[0]] + whole[ends[1] :])
    longer = st.binary(min_size=1, max_size=40).map(lambda more: whole + more)
    return patched | patched | cut | moved | longer | st.binary(max_size=200)


def _big_numbers() -> st.SearchStrategy[bytes]:
    return st.sampled_from([b"\xff" * 4, b"\xff" * 8, b"\x00" * 8, b"\xff\xff\xff\x7f", b"\x00\x00\x00\x80"])


def _patched(whole: bytes, patches: Sequence[tuple[int, bytes]]) -> bytes:
    copy = bytearray(whole)
    for place, patch in patches:
        copy[place : place + len(patch)] = patch
    return bytes(copy)


ODD = (
    st.none() | st.booleans() | FLOATS | INTEGERS | TEXTS | st.just([]) | st.just({}) | st.just([[]])
    | st.sampled_from([-5, 10**30, 1e400, "12", "NaN", "mug", [1], [None] * 9, {"id": 1}, [1.0] * 9])
)  # fmt: skip


def spoiled_json(content: Any) -> st.SearchStrategy[Any]:
    """A JSON value with one to three of its entries replaced or left out."""
    changes = st.tuples(st.sampled_from(list(_entries(content, ()))), ODD, st.booleans())
    return st.lists(changes, min_size=1, max_size=3).map(lambda chosen: _edited(content, chosen))


def _entries(content: Any, path: tuple[str | int, ...]) -> Iterator[tuple[str | int, ...]]:
    yield path
    inner = (
        content.items()
        if isinstance(content, dict)
        else enumerate(content if isinstance(content, list) else [])
    )
    for key, value in inner:
        yield from _entries(value, (*path, key))


def _edited(content: Any, chosen: Sequence[tuple[tuple[str | int, ...], Any, bool]]) -> Any:
    for path, value, dropped in chosen:
        content = _replaced(content, path, value, dropped)
    return content


def _replaced(content: Any, path: tuple[str | int, ...], value: Any, dropped: bool) -> Any:
    if not path:
        return value
    copy = content.copy() if isinstance(content, dict | list) else content
    key = path[0]
    if not (
        (isinstance(copy, dict) and key in copy)
        or (isinstance(copy, list) and isinstance(key, int) and key < len(copy))
    ):
        return copy  # another change has replaced what was here
    if len(path) == 1 and dropped:
        del copy[key]
    else:
        copy[key] = _replaced(copy[key], path[1:], value, dropped)
    return copy


def spoiled_text(text: str) -> st.SearchStrategy[str]:
    """A text with some of its words replaced or left out."""
    words = text.split(" ")
    odd = st.sampled_from(
        ["", "nan", "inf", "-1", "1e999", "x", "\n", "\n\n", "#", "0", "9" * 400]
    ) | st.text(max_size=8)
    changes = st.lists(st.tuples(st.integers(0, len(words) - 1), odd), min_size=1, max_size=3)

    def spoil(chosen: Sequence[tuple[int, str]]) -> str:
        copy = list(words)
        for place, word in chosen:
            copy[place] = word
        return " ".join(copy)

    return changes.map(spoil)
