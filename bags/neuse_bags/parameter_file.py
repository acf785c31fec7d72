"""A ROS parameter file of the nodes, for the same stages in one process."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from neuse.errors import ParamError
from neuse.params import build, flatten
from neuse.pipeline import PipelineParams
from neuse_encoder_node.node import EncoderNodeParams
from neuse_mapper_node.params import MapperNodeParams
from neuse_slam_node.node import SlamNodeParams

EVERY_NODE = "**"
OF_ROS = ("use_sim_time",)  # parameters that every node has
FORM = "a parameter file has NODE: {ros__parameters: {...}}, as config/slam_node.yaml of neuse_slam_node"


@dataclass(frozen=True)
class NodeParams:
    """Parameters of the three nodes, by default those that they start with."""

    encoder_node: EncoderNodeParams = field(default_factory=EncoderNodeParams)
    slam_node: SlamNodeParams = field(default_factory=SlamNodeParams)
    mapper_node: MapperNodeParams = field(default_factory=MapperNodeParams)

    @property
    def pipeline(self) -> PipelineParams:
        """The same stages in one process."""
        slam = self.slam_node
        return PipelineParams(
            self.encoder_node.encoder, slam.slam, self.mapper_node.mapper, slam.joining, slam.feedback_delay_s
        )


NODES = tuple(NodeParams.__dataclass_fields__)


def read_node_params(path: Path) -> NodeParams:
    """The nodes' parameters with what a file says of them; sections of other nodes do not matter.

    Raises:
        ParamError: no parameter file, a name that no node has, or a value outside its range.
    """
    try:
        return build(NodeParams(), dict(_values(_content(path))))
    except ParamError as error:
        raise ParamError(f"{path}: {error}") from error


def _content(path: Path) -> Mapping[Any, Any]:
    try:
        content = yaml.safe_load(path.read_text())
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ParamError(f"no YAML: {str(error).splitlines()[0]}") from error
    if not isinstance(content, dict):
        raise ParamError(FORM)
    return content


def _values(content: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    """("node.dotted.name", value) of all that the file says of our nodes."""
    known = flatten(NodeParams())
    for key, section in content.items():
        node = str(key).rpartition("/")[2]
        if node not in (*NODES, EVERY_NODE):
            continue
        if not isinstance(section, dict) or not isinstance(section.get("ros__parameters"), dict):
            raise ParamError(f"{key}: {FORM}")
        for name, value in _flat(section["ros__parameters"]):
            names = [f"{one}.{name}" for one in ([node] if node in NODES else NODES)]
            found = [full for full in names if full in known]
            if not found and name not in OF_ROS:
                raise ParamError(f"{key} has no parameter {name!r}")
            yield from ((full, tuple(value) if isinstance(value, list) else value) for full in found)


def _flat(parameters: Mapping[Any, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(dotted name, value) of nested parameters."""
    for name, value in parameters.items():
        if isinstance(value, dict):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", value
