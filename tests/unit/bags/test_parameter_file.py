"""Parameter files of the nodes, read for the pipeline in one process."""

from pathlib import Path

import numpy as np
import pytest

from neuse.errors import ParamError
from neuse_bags.parameter_file import NodeParams, read_node_params

SHIPPED = Path(__file__).parents[3]


def read(tmp_path: Path, text: str) -> NodeParams:
    path = tmp_path / "my.yaml"
    path.write_text(text)
    return read_node_params(path)


@pytest.mark.parametrize("node", ["encoder_node", "slam_node", "mapper_node"])
def test_shipped_file_says_the_defaults(tmp_path: Path, node: str) -> None:
    text = (SHIPPED / f"neuse_{node}" / "config" / f"{node}.yaml").read_text()
    assert read(tmp_path, text.replace("/**:", f"{node}:")) == NodeParams()


def test_values_reach_the_stage_that_they_are_for(tmp_path: Path) -> None:
    params = read(
        tmp_path,
        """
        /robot/slam_node:
          ros__parameters:
            use_sim_time: true
            T_child_camera: [1, 2, 3, 0, 0, 0, 1.0]
            slam: {mode: edges, odometry.sigma_translation_m: 0.2}
        encoder_node:
          ros__parameters: {weights: [mug], encoder: {min_points: 99}}
        camera_driver:
          ros__parameters: {exposure: 3}
        """,
    )
    assert params.pipeline.slam.mode == "edges"
    assert params.pipeline.slam.odometry.sigma_translation_m == 0.2
    assert params.pipeline.encoder.min_points == 99
    assert params.encoder_node.weights == ("mug",)
    np.testing.assert_array_equal(params.slam_node.camera_pose[:3, 3], [1, 2, 3])


def test_section_of_every_node_reaches_each_that_has_the_name(tmp_path: Path) -> None:
    params = read(tmp_path, "/**: {ros__parameters: {queue_size: 7, feedback_delay_s: 0.5}}")
    assert [params.encoder_node.queue_size, params.slam_node.queue_size, params.mapper_node.queue_size] == [
        7
    ] * 3
    assert params.pipeline.feedback_delay_s == 0.5


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("a: [", "no YAML"),
        ("just words", "NODE: {ros__parameters"),
        ("slam_node: {slam: {mode: edges}}", "slam_node: a parameter file has NODE"),
        ("slam_node: {ros__parameters: {slam: {mood: edges}}}", "slam_node has no parameter 'slam.mood'"),
        ("slam_node: {ros__parameters: {encoder: {min_points: 9}}}", "no parameter 'encoder.min_points'"),
        ("slam_node: {ros__parameters: {slam: {mode: circles}}}", "mode"),
        ("encoder_node: {ros__parameters: {encoder: {min_points: 1}}}", r"min_points = 1 is outside \[8"),
        ("encoder_node: {ros__parameters: {encoder: 3}}", "no parameter 'encoder'"),
        ("mapper_node: {ros__parameters: {weights: mug}}", "weights"),
    ],
)
def test_file_that_cannot_be_meant_is_refused_by_name(tmp_path: Path, text: str, complaint: str) -> None:
    with pytest.raises(ParamError, match=f"my.yaml: .*{complaint}"):
        read(tmp_path, text)
