"""Message types by name: their Python class, and their full text as bags embed it."""

from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from ament_index_python.packages import PackageNotFoundError, get_package_share_directory
from rosbags.typesys import TypesysError, get_types_from_msg

from neuse.errors import BagError

_PRIMITIVES = frozenset(
    ["bool", "byte", "char", "string", "wstring", "float32", "float64"]
    + [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
)
_SEPARATOR = "=" * 80


@cache
def message_class(type_name: str) -> Any:
    """The class of a message type such as `sensor_msgs/msg/Image`.

    Raises:
        BagError: its package is not installed here, or has no such message.
    """
    package, _, name = split_type(type_name)
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise BagError(f"{type_name} is not installed here; build or source its package") from error


@cache
def message_definition(type_name: str) -> str:
    """Text of a message and of all messages inside it, concatenated as MCAP's `ros2msg` encoding wants it.

    Raises:
        BagError: the .msg file of the type, or of one inside it, is not installed here.
    """
    order = _with_dependencies(type_name)
    first, *others = [_message_text(name) for name in order]
    parts = [
        f"{_SEPARATOR}\nMSG: {_short(name)}\n{text}" for name, text in zip(order[1:], others, strict=True)
    ]
    return "\n".join([first, *parts])


def is_installed_alike(type_name: str, definition: str) -> bool:
    """Whether messages of this text, as a bag embeds it, can be read by the class that is installed here.

    True too where nothing is installed or the text cannot be parsed: then others have more to say.
    """
    try:
        embedded = get_types_from_msg(definition, type_name)
        installed = get_types_from_msg(message_definition(type_name), type_name)
    except (BagError, TypesysError):
        return True
    return all(name in embedded and embedded[name][1] == fields for name, (_, fields) in installed.items())


def split_type(type_name: str) -> tuple[str, str, str]:
    """(package, "msg", name) of a type's name.

    Raises:
        BagError: the name is not `package/msg/Name`.
    """
    match type_name.split("/"):
        case [package, "msg", name] if package and name:
            return package, "msg", name
    raise BagError(f"{type_name!r} is no message type; expected package/msg/Name")


def _with_dependencies(type_name: str) -> list[str]:
    """The type, then every type inside it once, breadth first."""
    order = [type_name]
    for name in order:
        order += [inner for inner in _inner_types(name) if inner not in order]
    return order


def _inner_types(type_name: str) -> list[str]:
    package, _, _ = split_type(type_name)
    lines = (line.split("#")[0].split() for line in _message_text(type_name).splitlines())
    types = (words[0].split("[")[0].split("<")[0] for words in lines if words)
    return list(dict.fromkeys(_full(name, package) for name in types if name not in _PRIMITIVES))


def _full(name: str, package: str) -> str:
    """`Header` of std_msgs or `std_msgs/Header` as `std_msgs/msg/Header`."""
    own_package, _, short = name.rpartition("/")
    return f"{own_package.removesuffix('/msg') or package}/msg/{short}"


def _short(type_name: str) -> str:
    package, _, name = split_type(type_name)
    return f"{package}/{name}"


@cache
def _message_text(type_name: str) -> str:
    package, _, name = split_type(type_name)
    try:
        return Path(get_package_share_directory(package), "msg", f"{name}.msg").read_text()
    except (PackageNotFoundError, OSError, ValueError) as error:
        raise BagError(f"{type_name}'s .msg is not installed; build or source its package") from error
