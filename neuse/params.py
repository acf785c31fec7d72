"""Parameters: frozen dataclasses are the only home of a default, its meaning and its range."""

import dataclasses
import math
import re
from numbers import Integral, Real
from typing import Any, TypeVar

from neuse.errors import ParamError

Params = TypeVar("Params")


def param(default: Any, description: str, low: float | None = None, high: float | None = None) -> Any:
    """A dataclass field that carries what a ROS parameter descriptor needs: meaning and closed range."""
    return dataclasses.field(default=default, metadata={"description": description, "low": low, "high": high})


class CheckedParams:
    """Mixin: refuses values of another kind than the default's, or outside the declared ranges."""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):  # type: ignore[arg-type]
            _check_kind(field, getattr(self, field.name))
            _check_range(field, getattr(self, field.name))


def _check_kind(field: dataclasses.Field, value: Any) -> None:
    nested = field.default_factory is not dataclasses.MISSING
    fits = dataclasses.is_dataclass(value) if nested else _is_like(value, field.default)
    if not fits:
        sample = "its nested parameters" if nested else f"a value such as {field.default!r}"
        raise ParamError(f"parameter {field.name} = {str(value)[:100]!r} is none; give it {sample}")


def _is_like(value: Any, default: Any) -> bool:
    """Whether the value is of the default's kind."""
    match default:
        case bool() | str():
            return isinstance(value, type(default))
        case int():
            return isinstance(value, Integral) and not isinstance(value, bool)
        case float():
            return isinstance(value, Real) and not isinstance(value, bool)
        case tuple() if default:
            return isinstance(value, tuple | list) and all(
                _is_like(item, default[0]) and not _is_nan(item) for item in value
            )
    return True  # a field without default may be anything


def _is_nan(value: Any) -> bool:
    return isinstance(value, Real) and math.isnan(value)


def _check_range(field: dataclasses.Field, value: Any) -> None:
    low, high = field.metadata.get("low"), field.metadata.get("high")
    too_low, too_high = low is not None and not value >= low, high is not None and not value <= high
    if too_low or too_high or _is_nan(value):
        raise ParamError(
            f"parameter {field.name} = {value!r} is outside [{low}, {high}]; choose a value inside"
        )


def flatten(params: Any, prefix: str = "") -> dict[str, Any]:
    """Nested parameter dataclasses as {"dotted.name": value}."""
    flat: dict[str, Any] = {}
    for field in dataclasses.fields(params):
        value = getattr(params, field.name)
        nested = dataclasses.is_dataclass(value)
        flat |= flatten(value, f"{prefix}{field.name}.") if nested else {f"{prefix}{field.name}": value}
    return flat


def fields(params: Any, prefix: str = "") -> dict[str, dataclasses.Field]:
    """{"dotted.name": dataclass field} of nested parameter dataclasses, in the order of `flatten`."""
    flat: dict[str, dataclasses.Field] = {}
    for field in dataclasses.fields(params):
        value = getattr(params, field.name)
        nested = dataclasses.is_dataclass(value)
        flat |= fields(value, f"{prefix}{field.name}.") if nested else {f"{prefix}{field.name}": field}
    return flat


def build(defaults: Params, values: dict[str, Any]) -> Params:
    """A copy of `defaults` with {"dotted.name": value} put in; inverse of `flatten`.

    Raises:
        ParamError: a name that `defaults` does not have, or a value outside its range.
    """
    own: dict[str, Any] = {}
    nested: dict[str, dict[str, Any]] = {}
    names = {field.name for field in dataclasses.fields(defaults)}  # type: ignore[arg-type]
    for name, value in values.items():
        head, _, tail = name.partition(".")
        if head not in names:
            raise ParamError(f"unknown parameter {name!r}; known: {', '.join(flatten(defaults))}")
        if tail:
            nested.setdefault(head, {})[tail] = value
        else:
            own[head] = value
    for head, inner in nested.items():
        if not dataclasses.is_dataclass(getattr(defaults, head)):
            raise ParamError(f"unknown parameter {f'{head}.{next(iter(inner))}'!r}; {head} has no parts")
        own[head] = _build_part(head, getattr(defaults, head), inner)
    return dataclasses.replace(defaults, **own)  # type: ignore[type-var]


def _build_part(head: str, defaults: Any, values: dict[str, Any]) -> Any:
    """Nested parameters, of which an error tells the dotted name."""
    try:
        return build(defaults, values)
    except ParamError as error:
        told = re.sub(r"parameter ('?)", rf"parameter \g<1>{head}.", str(error), count=1)
        raise ParamError(told) from error
