"""The shipped YAML files hold every default, and ROS has the meaning and range of each parameter."""

import runpy
from array import array
from pathlib import Path
from typing import Any

import pytest
import yaml

from neuse.params import fields, flatten
from neuse_encoder_node.parameters import descriptor, misfit, to_ros

ROOT = Path(__file__).resolve().parents[3]
TOOL = runpy.run_path(str(ROOT / "tools" / "write_parameter_files.py"))
NODES = TOOL["NODES"]


def dotted(nested: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for name, value in nested.items():
        flat |= dotted(value, f"{prefix}{name}.") if isinstance(value, dict) else {prefix + name: value}
    return flat


@pytest.mark.parametrize("name", NODES)
def test_shipped_file_equals_the_defaults(name: str):
    stored = yaml.safe_load(TOOL["parameter_path"](name).read_text())["/**"]["ros__parameters"]
    defaults = {key: to_ros(value) for key, value in flatten(NODES[name]).items()}
    assert dotted(stored) == defaults
    assert {key: type(value) for key, value in dotted(stored).items()} == {
        key: type(value) for key, value in defaults.items()
    }


@pytest.mark.parametrize("name", NODES)
def test_shipped_file_is_as_the_tool_writes_it(name: str):
    assert TOOL["parameter_path"](name).read_text() == TOOL["parameter_file"](name)


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_says_what_it_means(name: str):
    assert all(field.metadata.get("description") for field in fields(NODES[name]).values())


@pytest.mark.parametrize("name", NODES)
def test_descriptor_has_the_range_of_the_field(name: str):
    for key, value in flatten(NODES[name]).items():
        field = fields(NODES[name])[key]
        found = descriptor(field, value)
        ranges = [*found.floating_point_range, *found.integer_range]
        low, high = field.metadata["low"], field.metadata["high"]
        assert len(ranges) == (low is not None or high is not None)
        for allowed in ranges:
            assert low is None or allowed.from_value == low
            assert high is None or allowed.to_value == high


@pytest.mark.parametrize(
    ("given", "default", "told"),
    [
        (1, 0.5, "a.b = 1 is none; write 1.0"),
        (array("q", [0, 1]), [0.5, 0.5], r"a.b = [0, 1] is none; write [0.0, 1.0]"),
        (2.0, 3, "a.b = 2.0 is none; write a value such as 3"),
        ("x", 0.5, "a.b = 'x' is none; write a value such as 0.5"),
        (True, 0.5, "a.b = True is none; write a value such as 0.5"),
        ([], [0.5], "a.b = [] is none; write a value such as [0.5]"),
    ],
)
def test_value_of_another_kind_is_told_with_what_to_write(given: Any, default: Any, told: str):
    assert misfit("a.b", given, default) == f"parameter {told}"
