from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from neuse.errors import ParamError
from neuse_encoder_node.overrides import addressed_names, check_overrides, nearest

KNOWN = ("save_path", "load_path", "slam.keyframes.near_m", "slam.odometry.max_age_s", "queue_size")
SHARED = "/**: {ros__parameters: {save_pth: a, camera: {gain: 2}}}"
OWN = "/a/slam_node: {ros__parameters: {slam: {keyframs: {near_m: 0.2}}}}"
NESTED = "robot: {slam_node: {ros__parameters: {save_pth: a}}}"
FOREIGN = "other_node: {ros__parameters: {save_pth: a}}"


class GivenNode:
    """What a node tells of the parameters that it was given."""

    def __init__(self, *given: str) -> None:
        self._parameter_overrides = dict.fromkeys(given)
        self.warnings: list[str] = []

    def get_name(self) -> str:
        return "slam_node"

    def has_parameter(self, name: str) -> bool:
        return name in (*KNOWN, "use_sim_time")

    def get_logger(self) -> Any:
        return SimpleNamespace(warning=self.warnings.append)


def written(folder: Path, content: str) -> list[str]:
    (folder / "params.yaml").write_text(content)
    return ["node", "--ros-args", "--params-file", str(folder / "params.yaml")]


@pytest.mark.parametrize("option", ["-p", "--param"])
@pytest.mark.parametrize("name", ["save_pth", "slam_node:save_pth"])
def test_unknown_name_on_the_command_line_is_refused_with_the_nearest(monkeypatch, option: str, name: str):
    monkeypatch.setattr("sys.argv", ["node", "--ros-args", option, f"{name}:=/tmp/a:=b.map"])
    with pytest.raises(ParamError, match=r"slam_node has no parameter 'save_pth' \(near: save_path"):
        check_overrides(GivenNode("save_pth"), KNOWN)


@pytest.mark.parametrize(("content", "name"), [(OWN, "slam.keyframs.near_m"), (NESTED, "save_pth")])
def test_unknown_name_in_the_nodes_own_section_is_refused(
    monkeypatch, tmp_path: Path, content: str, name: str
):
    monkeypatch.setattr("sys.argv", written(tmp_path, content))
    with pytest.raises(ParamError, match=rf"'{name}' \(near: s"):
        check_overrides(GivenNode(name), KNOWN)


def test_unknown_name_of_a_shared_section_is_warned_about_in_one_line(monkeypatch, tmp_path: Path):
    monkeypatch.setattr("sys.argv", written(tmp_path, SHARED))
    node = GivenNode("camera.gain", "save_pth", "queue_size")
    check_overrides(node, KNOWN)
    (told,) = node.warnings
    assert told.startswith("slam_node has no parameter 'save_pth' (near: save_path), 'camera.gain';")


def test_long_list_of_unknown_names_is_cut(monkeypatch):
    monkeypatch.setattr("sys.argv", ["node"])
    node = GivenNode(*(f"camera.x{i}" for i in range(40)))
    check_overrides(node, KNOWN)
    assert " and 37 more" in node.warnings[0]


def test_known_names_and_those_of_ros_are_taken_without_a_word(monkeypatch):
    names = ["save_path", "use_sim_time", "qos_overrides./clock.subscription.depth"]
    monkeypatch.setattr("sys.argv", ["node", "--ros-args", *(w for n in names for w in ("-p", f"{n}:=1"))])
    node = GivenNode(*names)
    check_overrides(node, KNOWN)
    assert not node.warnings


@pytest.mark.parametrize(
    "content", [SHARED, FOREIGN, "[]", "slam_node: 3", "{", "slam_node: {ros__parameters: 3}"]
)
def test_names_that_are_not_addressed_to_the_node_are_none(tmp_path: Path, content: str):
    assert addressed_names(written(tmp_path, content), "slam_node") == set()


def test_file_that_is_missing_addresses_nothing():
    assert addressed_names(["--params-file", "/nowhere/a.yaml"], "slam_node") == set()


@pytest.mark.parametrize(
    ("name", "first"),
    [("save_pth", "save_path"), ("max_age_s", "slam.odometry.max_age_s"), ("unicorn", None)],
)
def test_nearest_is_of_the_same_last_part_or_written_alike(name: str, first: str | None):
    assert next(iter(nearest(name, KNOWN)), None) == first
