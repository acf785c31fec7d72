"""package.xml of every package names what its Python imports, so that rosdep and colcon know."""

import ast
import sys
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
PACKAGES = ["neuse_encoder_node", "neuse_slam_node", "neuse_mapper_node", "bags"]
# of other SLAMs, which rosdep need not know: who has them has their adapters
OPTIONAL = {"pose_graph_tools_msgs", "rtabmap_msgs"}
# of wheels, which rosdep does not know; pyproject.toml has them. neuse_bags is run by the launch file of
# neuse_slam_node, on which it depends itself.
WHEELS = {"numpy", "trimesh", "mcap", "rosbags", "lz4", "backports", "rerun", "tqdm", "yaml", "cv2"}
WHEELS |= {"setuptools", "torch"}


def imported(folder: Path) -> set[str]:
    """Top-level names that the Python files of a folder import."""
    names = set()
    for path in folder.rglob("*.py"):
        for statement in ast.walk(ast.parse(path.read_text())):
            if isinstance(statement, ast.Import):
                names |= {alias.name.split(".")[0] for alias in statement.names}
            elif isinstance(statement, ast.ImportFrom) and statement.module:
                names.add(statement.module.split(".")[0])
    return names - set(sys.stdlib_module_names)


@pytest.mark.parametrize("name", PACKAGES)
def test_every_import_of_another_package_is_declared(name: str):
    root = ElementTree.parse(ROOT / name / "package.xml").getroot()
    declared = {element.text for element in root if element.tag.endswith("depend")}
    own = root.findtext("name")
    assert imported(ROOT / name) - WHEELS - OPTIONAL - {own} <= declared


@pytest.mark.parametrize("name", [*PACKAGES, "neuse", "neuse_msgs"])
def test_package_says_who_licensed_it_and_how(name: str):
    root = ElementTree.parse(ROOT / name / "package.xml").getroot()
    assert root.findtext("license") == "Apache-2.0"
    assert root.findtext("version") == "0.1.0"
