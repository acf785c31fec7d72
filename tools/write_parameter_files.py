"""Writes each config/<node>.yaml from the dataclasses that hold the defaults; run it when one changes."""

import dataclasses
from pathlib import Path
from typing import Any

import yaml

from neuse_encoder_node import node as encoder
from neuse_encoder_node.parameters import to_ros
from neuse_mapper_node import node as mapper
from neuse_slam_node import node as slam

ROOT = Path(__file__).resolve().parents[1]
NODES = {
    encoder.NAME: encoder.EncoderNodeParams(),
    slam.NAME: slam.SlamNodeParams(),
    mapper.NAME: mapper.MapperNodeParams(),
}


def parameter_file(node_name: str) -> str:
    """Text of a node's YAML file: every default with its meaning and range, nested as the dataclasses are."""
    head = [f"# Every parameter of {node_name} with its default.", "/**:", "  ros__parameters:"]
    return "\n".join(head + _lines(NODES[node_name], indent=4)) + "\n"


def parameter_path(node_name: str) -> Path:
    """Where a node's YAML file lies."""
    return ROOT / f"neuse_{node_name}" / "config" / f"{node_name}.yaml"


def _lines(params: Any, indent: int) -> list[str]:
    lines = []
    for field in dataclasses.fields(params):
        value, start = getattr(params, field.name), " " * indent + field.name
        if dataclasses.is_dataclass(value):
            lines += [f"{start}:", *_lines(value, indent + 2)]
        else:
            lines.append(f"{start}: {_yaml(value)}  # {_meaning(field)}")
    return lines


def _yaml(value: Any) -> str:
    dumped = yaml.safe_dump(to_ros(value), default_flow_style=True, width=1000)
    return dumped.removesuffix("\n").removesuffix("\n...")


def _meaning(field: dataclasses.Field) -> str:
    low, high = field.metadata["low"], field.metadata["high"]
    if low is None and high is None:
        return field.metadata["description"]
    ends = "-inf" if low is None else low, "inf" if high is None else high
    return f"{field.metadata['description']} [{ends[0]}, {ends[1]}]"


def main() -> None:
    for node_name in NODES:
        parameter_path(node_name).write_text(parameter_file(node_name))


if __name__ == "__main__":
    main()
