"""The built workspace as ROS tools see it: ament index, executables, configuration, and the two scripts."""

import os
import subprocess
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix, get_package_share_directory

pytestmark = pytest.mark.ros

ROOT = Path(__file__).resolve().parents[2]
COMMANDS = ("simulate", "convert", "info", "play", "record", "run", "evaluate", "view", "demo", "bench")
EXECUTABLES = [
    *(("neuse_" + name, name) for name in ("encoder_node", "slam_node", "mapper_node")),
    *(("neuse_bags", name) for name in COMMANDS),
]


@pytest.mark.parametrize(("package", "executable"), EXECUTABLES)
def test_executable_is_where_ros2_run_looks(package: str, executable: str):
    path = Path(get_package_prefix(package), "lib", package, executable)
    assert os.access(path, os.X_OK)


@pytest.mark.parametrize("name", ["encoder_node", "slam_node", "mapper_node"])
def test_parameter_file_is_installed(name: str):
    assert Path(get_package_share_directory(f"neuse_{name}"), "config", f"{name}.yaml").is_file()


@pytest.mark.parametrize(
    ("package", "file"),
    [
        ("neuse_slam_node", "launch/neuse.launch.py"),
        ("neuse_mapper_node", "config/neuse.rviz"),
        ("neuse_mapper_node", "config/neuse_foxglove.json"),
    ],
)
def test_launch_file_and_views_are_installed(package: str, file: str):
    assert Path(get_package_share_directory(package), file).is_file()


def run_script(*arguments: str, **environment: str) -> subprocess.CompletedProcess:
    bare = {"PATH": "/usr/bin:/bin", "HOME": os.environ["HOME"]} | environment
    return subprocess.run([str(ROOT / "run.sh"), *arguments], capture_output=True, text=True, env=bare)


def test_run_script_needs_nothing_but_itself():
    done = run_script("neuse_bags", "simulate", "--help")
    assert done.returncode == 0, done.stderr
    assert "PRESET" in done.stdout


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((), "usage"),
        (("neuse_bags", "fly"), "package neuse_bags has no executable fly"),
        (("unicorn", "fly"), "package unicorn not found"),
    ],
)
def test_run_script_says_what_is_wrong(arguments: tuple[str, ...], complaint: str):
    done = run_script(*arguments)
    assert done.returncode != 0
    assert complaint in done.stderr


def test_environment_can_be_sourced_twice_without_growing():
    once, twice = (
        subprocess.run(
            ["bash", "-c", f"{'source env.sh; ' * times} echo $PYTHONPATH $AMENT_PREFIX_PATH $PATH"],
            cwd=ROOT,
            capture_output=True,
            text=True,
            env={"PATH": "/usr/bin:/bin"},
        ).stdout
        for times in (1, 2)
    )
    assert str(ROOT) in once
    assert once == twice
