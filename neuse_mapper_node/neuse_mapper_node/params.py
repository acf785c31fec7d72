"""Parameters of mapper_node."""

from dataclasses import dataclass, field

from neuse.embedding import devices
from neuse.mapping.mapper import MapperParams
from neuse.params import param
from neuse_encoder_node.stage_node import StageParams
from neuse_encoder_node.weights import MEANING, SHIPPED


@dataclass(frozen=True)
class MapperNodeParams(StageParams):
    """Parameters of mapper_node."""

    queue_size: int = param(200, "frames that may wait for the worker; beyond it the oldest goes", 1, 100000)
    topic_depth: int = param(100, "depth of the reliable queues", 1, 10000)
    map_period_s: float = param(1.0, "the map is published at most this often, in stamps", 0.0, 3600.0)
    draw_period_s: float = param(3.0, "markers and points come at most this often, in stamps", 0.0, 3600.0)
    decode_share: float = param(0.05, "shapes are decoded in this share of the time at most", 0.001, 1.0)
    resolution_m: float = param(0.004, "grid on which shapes are decoded, m", 0.001, 0.1)
    map_frame: str = param("map", "name of the frame of the map")
    load_path: str = param("", "map file to go on with; empty: start with nothing")
    save_path: str = param("", "map file that is written when the node ends; empty: none")
    sessions: str = param("", "namespaces of robots that share this map, with commas; empty: the node's own")
    weights: tuple[str, ...] = param(SHIPPED, MEANING)
    device: str = param(devices.AUTO, devices.MEANING)
    mapper: MapperParams = field(default_factory=MapperParams)
