from dataclasses import dataclass, field
from dataclasses import fields as dataclass_fields

import pytest

from neuse.errors import ParamError
from neuse.params import CheckedParams, build, fields, flatten, param


@dataclass(frozen=True)
class Inner(CheckedParams):
    gate_m: float = param(0.5, "largest distance of a match", 0.0, 2.0)
    name: str = param("horn", "method")


@dataclass(frozen=True)
class Outer(CheckedParams):
    count: int = param(3, "how many", 1)
    inner: Inner = field(default_factory=Inner)


FLAT = {"count": 3, "inner.gate_m": 0.5, "inner.name": "horn"}


def test_flatten_gives_dotted_names_in_the_order_of_the_fields():
    assert list(flatten(Outer()).items()) == list(FLAT.items())


def test_build_is_the_inverse_of_flatten():
    other = Outer(count=7, inner=Inner(gate_m=1.5, name="icp"))
    assert build(Outer(), flatten(other)) == other


def test_build_keeps_what_is_not_named():
    assert build(Outer(), {"inner.gate_m": 1.0}) == Outer(inner=Inner(gate_m=1.0))
    assert build(Outer(), {}) == Outer()


@pytest.mark.parametrize("name", ["cuont", "inner.gate", "inner.gate_m.deeper", "count.deeper", ""])
def test_build_refuses_an_unknown_name(name):
    with pytest.raises(ParamError, match="unknown parameter"):
        build(Outer(), {name: 1})


def test_build_refuses_a_value_outside_its_range():
    with pytest.raises(ParamError, match="gate_m"):
        build(Outer(), {"inner.gate_m": 3.0})


def test_errors_of_nested_parameters_tell_the_dotted_name():
    with pytest.raises(ParamError, match=r"parameter inner\.gate_m = 3.0 is outside"):
        build(Outer(), {"inner.gate_m": 3.0})
    with pytest.raises(ParamError, match=r"unknown parameter 'inner\.gate'"):
        build(Outer(), {"inner.gate": 1.0})


@pytest.mark.parametrize("value", [0.0, 1.0, 2.0])
def test_range_is_closed(value):
    assert Inner(gate_m=value).gate_m == value


@pytest.mark.parametrize("value", [-1e-9, 2.1, float("nan"), float("inf")])
def test_value_outside_its_range_is_refused_with_name_value_and_range(value):
    with pytest.raises(ParamError, match=rf"gate_m = {value!r} is outside \[0.0, 2.0\]"):
        Inner(gate_m=value)


@dataclass(frozen=True)
class Kinds(CheckedParams):
    on: bool = param(True, "a switch")
    share: float = param(0.5, "without a range")
    count: int = param(2, "without a range")
    names: tuple[str, ...] = param(("a",), "of any number")
    pose: tuple[float, ...] = param((0.0, 1.0), "of any number")
    inner: Inner = field(default_factory=Inner)


@pytest.mark.parametrize(
    ("name", "value"),
    [("on", 1), ("share", "half"), ("share", True), ("count", 2.0), ("count", None), ("names", "a"),
     ("names", (1,)), ("pose", (0.0, float("nan"))), ("pose", ("x",)), ("inner", 3), ("inner", {})],
)  # fmt: skip
def test_value_of_another_kind_than_the_default_is_refused(name, value):
    with pytest.raises(ParamError, match=f"parameter {name} = .* is none"):
        build(Kinds(), {name: value})


def test_what_is_not_a_number_is_refused_without_a_range_too():
    with pytest.raises(ParamError, match="share"):
        Kinds(share=float("nan"))
    assert Kinds(share=float("inf")).share == float("inf")


def test_numbers_of_like_kinds_are_taken():
    import numpy as np

    assert Kinds(share=1, count=np.int64(4), names=(), pose=[1, np.float32(2.0)]).share == 1


def test_one_sided_range_is_open_on_the_other_side():
    assert Outer(count=10**9).count == 10**9
    with pytest.raises(ParamError, match="count"):
        Outer(count=0)


def test_fields_carry_description_and_range_under_the_flat_names():
    found = fields(Outer())
    assert list(found) == list(FLAT)
    assert found["inner.gate_m"].metadata == {
        "description": "largest distance of a match",
        "low": 0.0,
        "high": 2.0,
    }
    assert found["count"] is dataclass_fields(Outer)[0]
