"""Parameters that a node was given and does not have: a misspelt name must not pass in silence."""

import sys
from collections.abc import Collection, Iterator, Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from pathlib import Path
from typing import Any

import yaml
from rclpy.node import Node

from neuse.errors import ParamError

QOS = "qos_overrides."  # rclpy reads them when it makes a publisher or subscription
N_TOLD = 3
VALUES, FILES = ("-p", "--param"), ("--params-file",)


def check_overrides(node: Node, known: Collection[str]) -> None:
    """Refuse names that are addressed to this node alone and not `known`; warn of those meant for any node.

    Raises:
        ParamError: such a name, given by -p or in the node's own section of a parameter file.
    """
    given = node._parameter_overrides  # rclpy has no public name for them
    unknown = [name for name in given if not node.has_parameter(name) and not name.startswith(QOS)]
    addressed = addressed_names(sys.argv, node.get_name())
    own = [name for name in unknown if name in addressed]
    if own:
        raise ParamError(f"{node.get_name()} has no parameter {_listed(own, known)}")
    if unknown:
        node.get_logger().warning(
            f"{node.get_name()} has no parameter {_listed(unknown, known)}; "
            "if the file means another node by that, all is well"
        )


def addressed_names(arguments: Sequence[str], node_name: str) -> set[str]:
    """Parameters given by -p, or in sections of parameter files that name the node; not those of /**."""
    names: set[str] = set()
    for option, value in pairwise(arguments):
        if option in VALUES:
            names.add(value.partition(":=")[0].rpartition(":")[2])
        elif option in FILES:
            names.update(_named_in(_content(Path(value)), node_name))
    return names


def nearest(name: str, known: Collection[str]) -> list[str]:
    """Known names that may be meant: of the same last part, then those written alike."""
    leaf = name.rpartition(".")[2]
    found = [other for other in known if other.rpartition(".")[2] == leaf]
    return list(dict.fromkeys([*found, *get_close_matches(name, known, N_TOLD)]))[:N_TOLD]


def _listed(names: Sequence[str], known: Collection[str]) -> str:
    """A few of the names, first those for which there is a suggestion."""
    near = {name: nearest(name, known) for name in names}
    told = sorted(names, key=lambda name: not near[name])[:N_TOLD]
    words = [f"{name!r}" + (f" (near: {', '.join(near[name])})" if near[name] else "") for name in told]
    rest = len(names) - len(told)
    return ", ".join(words) + (f" and {rest} more" if rest else "")


def _content(path: Path) -> Any:
    """What a parameter file says; rcl has read it before, and tells what it finds wrong with it."""
    try:
        return yaml.safe_load(path.read_text())
    except (OSError, ValueError, yaml.YAMLError):
        return None


def _named_in(content: Any, node_name: str) -> Iterator[str]:
    """Names in the sections of a node; sections of nodes may lie in those of namespaces."""
    for key, section in content.items() if isinstance(content, Mapping) else ():
        if str(key).rpartition("/")[2] == node_name and isinstance(section, Mapping):
            yield from _flat(section.get("ros__parameters"))
        else:
            yield from _named_in(section, node_name)


def _flat(parameters: Any, prefix: str = "") -> Iterator[str]:
    for name, value in parameters.items() if isinstance(parameters, Mapping) else ():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}"
