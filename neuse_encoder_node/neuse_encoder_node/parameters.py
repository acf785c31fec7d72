"""ROS parameters of a node, declared from the frozen dataclass that is the home of their defaults."""

import sys
from dataclasses import Field
from typing import Any, TypeVar

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node

from neuse.errors import ParamError
from neuse.params import build, fields, flatten

Params = TypeVar("Params")
INT64_MAX = 2**63 - 1


def declare_parameters(node: Node, defaults: Any) -> None:
    """Declare every field of `defaults`, nested ones by dotted names, with meaning and range.

    Raises:
        ParamError: a value of another kind was given.
    """
    described = fields(defaults)
    for name, value in flatten(defaults).items():
        try:
            node.declare_parameter(name, to_ros(value), descriptor(described[name], value))
        except InvalidParameterTypeException as error:
            given = node._parameter_overrides[name].value  # rclpy has no public name for them
            raise ParamError(misfit(name, given, to_ros(value))) from error


def read_parameters(node: Node, defaults: Params) -> Params:
    """`defaults` with the node's present values put in.

    Raises:
        ParamError: a value that the dataclass refuses.
    """
    values = {name: node.get_parameter(name).value for name in flatten(defaults)}
    return build(defaults, {name: tuple(v) if _is_array(v) else v for name, v in values.items()})


def to_ros(value: Any) -> Any:
    """A field's value as a ROS parameter has it: tuples are arrays."""
    return list(value) if isinstance(value, tuple) else value


def misfit(name: str, given: Any, default: Any) -> str:
    """What to write instead of a value of another kind than the default's: to ROS, 1 is no double."""
    meant = (
        _decimals(given) if _is_of(float, default) and _is_of(int, given) else f"a value such as {default!r}"
    )
    return f"parameter {name} = {_plain(given)!r} is none; write {meant}"


def descriptor(field: Field, value: Any) -> ParameterDescriptor:
    """Meaning and closed range of a field; an open end is the limit of the type."""
    found = ParameterDescriptor(name=field.name, description=field.metadata.get("description", ""))
    low, high = field.metadata.get("low"), field.metadata.get("high")
    if low is None and high is None:
        return found
    if isinstance(value, float):
        limit = sys.float_info.max
        bounds = [float(-limit if low is None else low), float(limit if high is None else high)]
        found.floating_point_range = [FloatingPointRange(from_value=bounds[0], to_value=bounds[1])]
    elif isinstance(value, int):
        lowest, highest = -INT64_MAX if low is None else int(low), INT64_MAX if high is None else int(high)
        found.integer_range = [IntegerRange(from_value=lowest, to_value=highest)]
    return found


def _is_of(kind: type, value: Any) -> bool:
    """Whether a value, or each of an array, is of this very kind."""
    values = value if _is_array(value) else [value]
    return len(values) > 0 and all(type(one) is kind for one in values)


def _decimals(value: Any) -> str:
    return str([float(one) for one in value] if _is_array(value) else float(value))


def _plain(value: Any) -> Any:
    """rclpy has numbers in `array.array`, which prints badly."""
    return list(value) if _is_array(value) else value


def _is_array(value: Any) -> bool:
    return not isinstance(value, str) and hasattr(value, "__len__")
