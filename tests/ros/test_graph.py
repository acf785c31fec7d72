"""The three nodes, a recorder and a player on a short simulated bag, beside the pipeline in one process."""

from pathlib import Path

import numpy as np
import pytest

from neuse.records import Edge, TrackedFrame
from neuse_bags import simulate, topics
from neuse_bags.demo import record_graph
from neuse_bags.mcap_file import BagReader
from neuse_slam_node.conversions import edges_from_msgs, tracked_frame_from_msg

pytestmark = [pytest.mark.ros, pytest.mark.slow]

N_FRAMES = 60


@pytest.fixture(scope="module")
def bag_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The first seconds of the demo's world."""
    path = tmp_path_factory.mktemp("graph") / "tabletop.mcap"
    arguments = ["tabletop", "--seed", "3", "--frames", str(N_FRAMES), "--out", str(path)]
    assert simulate.main(arguments) == 0
    return path


@pytest.fixture(scope="module")
def graph(bag_path: Path, domain: int) -> Path:
    """What the nodes published."""
    recording = bag_path.with_name("recording.mcap")
    record_graph(bag_path, recording, rate=1.0, logs=bag_path.with_name("logs"))
    return recording


@pytest.fixture(scope="module")
def pipeline(bag_path: Path, start_bags) -> Path:
    """What the pipeline gives."""
    folder = bag_path.with_name("pipeline")
    process = start_bags("run", bag_path, "--out", folder)
    assert process.wait(timeout=300) == 0
    return folder / "recording.mcap"


def read_edges(path: Path) -> list[Edge]:
    with BagReader(path) as bag:
        messages = [message.decode() for message in bag.messages([topics.EDGES.name])]
    return [edge for message in messages for edge in edges_from_msgs(message.edges)]


def read_frames(path: Path) -> list[TrackedFrame]:
    with BagReader(path) as bag:
        return [tracked_frame_from_msg(message.decode()) for message in bag.messages([topics.FRAMES.name])]


def test_every_frame_is_tracked(graph: Path):
    stamps_ns = [frame.stamp_ns for frame in read_frames(graph)]
    assert len(stamps_ns) == N_FRAMES
    assert stamps_ns == sorted(stamps_ns)


def test_graph_and_pipeline_give_the_same_edges(graph: Path, pipeline: Path):
    edges, wanted = read_edges(graph), read_edges(pipeline)
    assert len(wanted) > N_FRAMES
    names = ("from_id", "to_id", "from_stamp_ns", "to_stamp_ns", "kind", "object_ids")
    assert [[getattr(e, n) for n in names] for e in edges] == [[getattr(e, n) for n in names] for e in wanted]
    for one, other in zip(edges, wanted, strict=True):
        np.testing.assert_allclose(one.T_from_to, other.T_from_to, atol=1e-9)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-6, atol=1e-12)


def test_graph_and_pipeline_give_the_same_poses_and_objects(graph: Path, pipeline: Path):
    for one, other in zip(read_frames(graph), read_frames(pipeline), strict=True):
        np.testing.assert_allclose(one.T_map_camera, other.T_map_camera, atol=1e-9)
        assert [(o.status, o.object_id) for o in one.observations] == [
            (o.status, o.object_id) for o in other.observations
        ]


def test_final_map_is_the_same(graph: Path, pipeline: Path):
    final = []
    for path in (graph, pipeline):
        with BagReader(path) as bag:
            *_, last = bag.messages([topics.MAP.name])
        final.append([(o.object_id, o.category, o.status, o.n_observations) for o in last.decode().objects])
    assert final[0]
    assert final[0] == final[1]


def test_nodes_end_without_complaint(graph: Path):
    logs = {path.stem: path.read_text() for path in graph.with_name("logs").iterdir()}
    assert {"encoder_node", "slam_node", "mapper_node", "record", "play"} == logs.keys()
    assert not [name for name, text in logs.items() if "Traceback" in text or "[WARN]" in text]
