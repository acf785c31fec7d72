"""The examples of docs/ as somebody would run them."""

import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import gtsam
import numpy as np
import pytest
from peer import Peer
from rclpy.node import Node

from neuse.geometry import exp
from neuse.records import Edge, EdgeKind
from neuse_msgs.msg import PoseGraphEdgeArray
from neuse_slam_node.conversions import edges_to_msg

pytestmark = pytest.mark.ros

EXAMPLE = Path(__file__).resolve().parents[2] / "docs" / "examples" / "edges_to_gtsam.py"


def edge(from_id: int, to_id: int, seed: int) -> Edge:
    """A far turn with a full covariance, so that order and axes matter."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(6, 6)) * [0.01, 0.02, 0.03, 0.1, 0.2, 0.3]
    covariance = root @ root.T + 1e-4 * np.eye(6)
    return Edge(from_id, to_id, 10**9, 2 * 10**9, EdgeKind.SHORT_RANGE, exp(rng.normal(size=6)), covariance)


@pytest.fixture
def example(domain: int, tmp_path: Path) -> Iterator[subprocess.Popen]:
    with (tmp_path / "log").open("w") as log:
        process = subprocess.Popen([sys.executable, str(EXAMPLE)], cwd=tmp_path, stdout=log, stderr=log)
    yield process
    process.kill()
    process.wait()


def test_subscriber_adds_edges_to_a_gtsam_graph(node: Node, example: subprocess.Popen, tmp_path: Path):
    peer = Peer(node, "edges_to_gtsam")
    peer.connect(PoseGraphEdgeArray, "neuse/edges")
    edges = [edge(0, 3, 1), edge(3, 5, 2), edge(0, 5, 3)]
    peer.send("neuse/edges", edges_to_msg(edges[:1], 2, "camera"))
    peer.send("neuse/edges", edges_to_msg(edges[1:], 3, "camera"))
    log = tmp_path / "log"
    peer.wait_for(lambda: "3 edges between 3 keyframes" in log.read_text(), "graph of three edges")
    example.send_signal(signal.SIGINT)
    assert example.wait(timeout=60) == 0, log.read_text()
    graph, _ = gtsam.readG2o(str(tmp_path / "graph.g2o"), True)
    assert_holds(graph, edges)


def assert_holds(graph: gtsam.NonlinearFactorGraph, edges: list[Edge]) -> None:
    """As precisely as the text file of gtsam is."""
    assert graph.size() == len(edges)
    for sent, factor in zip(edges, map(graph.at, range(graph.size())), strict=True):
        assert list(factor.keys()) == [sent.from_id, sent.to_id]
        np.testing.assert_allclose(factor.measured().matrix(), sent.T_from_to, atol=1e-4)
        information = factor.noiseModel().information()
        expected = np.linalg.inv(sent.covariance)
        np.testing.assert_allclose(information, expected, rtol=1e-3, atol=1e-3 * abs(expected).max())


def test_example_is_as_short_as_promised():
    assert len(EXAMPLE.read_text().splitlines()) <= 40
