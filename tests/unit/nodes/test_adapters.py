"""Edges for other SLAMs, with stand-ins for message packages that are no wheels."""

import sys
from dataclasses import dataclass, field, replace
from importlib import import_module, util
from types import ModuleType
from typing import Any

import gtsam
import numpy as np
import pytest
from geometry_msgs.msg import Pose, Transform
from std_msgs.msg import Header

from neuse.errors import InputError
from neuse.geometry import Array, exp, inverse, log
from neuse.records import NO_ID, Edge, EdgeKind
from neuse_slam_node.adapters.bodies import moved_to_body, moved_to_camera

T_FROM_TO = exp([0.3, -0.8, 0.5, 1.0, -2.0, 0.7])
T_BODY_CAMERA = exp([1.2, -1.2, 1.1, 0.2, 0.05, 0.4])
FROM_NS, TO_NS = 1_700_000_000_123_456_789, 1_700_000_003_000_000_001


@dataclass
class PoseGraphEdge:
    """pose_graph_tools_msgs/PoseGraphEdge."""

    ODOM = 0
    LOOPCLOSE = 1
    header: Header = field(default_factory=Header)
    key_from: int = 0
    key_to: int = 0
    robot_from: int = 0
    robot_to: int = 0
    type: int = 0
    pose: Pose = field(default_factory=Pose)
    covariance: Any = field(default_factory=lambda: np.zeros(36))


@dataclass
class Link:
    """rtabmap_msgs/Link."""

    from_id: int = 0
    to_id: int = 0
    type: int = 0
    transform: Transform = field(default_factory=Transform)
    information: Any = field(default_factory=lambda: np.zeros(36))


def adapter(name: str, package: str, message: type, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """An adapter over a stand-in for its message package."""
    module = ModuleType(f"{package}.msg")
    setattr(module, message.__name__, message)
    monkeypatch.setitem(sys.modules, package, ModuleType(package))
    monkeypatch.setitem(sys.modules, f"{package}.msg", module)
    found = import_module(f"neuse_slam_node.adapters.{name}")
    del sys.modules[found.__name__]
    return found


@pytest.fixture
def kimera(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return adapter("pose_graph_tools", "pose_graph_tools_msgs", PoseGraphEdge, monkeypatch)


@pytest.fixture
def rtabmap(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    return adapter("rtabmap", "rtabmap_msgs", Link, monkeypatch)


def covariance() -> Array:
    """Full, with other values in every block."""
    root = np.random.default_rng(4).normal(size=(6, 6)) * [0.01, 0.02, 0.03, 0.1, 0.2, 0.3]
    return root @ root.T + np.diag([1e-4, 2e-4, 3e-4, 1e-2, 2e-2, 3e-2])


def edge(kind: EdgeKind = EdgeKind.LOOP_CLOSURE) -> Edge:
    return Edge(4, 9, FROM_NS, TO_NS, kind, T_FROM_TO, covariance(), (1, 2), 0.003)


def propagated_covariance(transform: Any) -> Array:
    """Covariance of what a function makes of the pose of the edge, by numerical differences."""
    at_mean = transform(T_FROM_TO)
    columns = [
        (
            log(inverse(at_mean) @ transform(T_FROM_TO @ exp(step)))
            - log(inverse(at_mean) @ transform(T_FROM_TO @ exp(-step)))
        )
        / 2e-6
        for step in 1e-6 * np.eye(6)
    ]
    J = np.stack(columns, axis=1)
    return J @ covariance() @ J.T


def matrix(flat: Any) -> Array:
    return np.array(flat).reshape(6, 6)


def pose_matrix(pose: Pose) -> Array:
    """By an independent library."""
    q, p = pose.orientation, pose.position
    return gtsam.Pose3(gtsam.Rot3.Quaternion(q.w, q.x, q.y, q.z), np.array([p.x, p.y, p.z])).matrix()


def test_hydra_gets_stamps_as_keys_and_the_pose_of_from_in_to(kimera: ModuleType):
    message = kimera.edge_to_hydra(edge(), "camera", robot=3)
    assert (message.key_from, message.key_to) == (FROM_NS, TO_NS)
    assert (message.robot_from, message.robot_to, message.type) == (3, 3, PoseGraphEdge.LOOPCLOSE)
    assert (message.header.frame_id, message.header.stamp.nanosec) == ("camera", 1)
    np.testing.assert_allclose(pose_matrix(message.pose), np.linalg.inv(T_FROM_TO), atol=1e-12)
    np.testing.assert_allclose(
        matrix(message.covariance), propagated_covariance(inverse), rtol=1e-5, atol=1e-9
    )


def test_kimera_gets_keyframes_as_keys_and_the_pose_and_covariance_as_gtsam_has_them(kimera: ModuleType):
    message = kimera.edge_to_kimera(edge(EdgeKind.ODOMETRY), "camera")
    assert (message.key_from, message.key_to, message.type) == (4, 9, PoseGraphEdge.ODOM)
    np.testing.assert_allclose(pose_matrix(message.pose), T_FROM_TO, atol=1e-12)
    np.testing.assert_array_equal(matrix(message.covariance), covariance())


def assert_came_back(back: Edge | None):
    assert back is not None
    ends = (back.from_id, back.to_id, back.from_stamp_ns, back.to_stamp_ns, back.kind)
    assert ends == (NO_ID, NO_ID, FROM_NS, TO_NS, EdgeKind.EXTERNAL)
    np.testing.assert_allclose(back.T_from_to, T_FROM_TO, atol=1e-12)
    np.testing.assert_allclose(back.covariance, covariance(), rtol=1e-9, atol=1e-12)


def test_edges_come_back_from_hydra_and_kimera(kimera: ModuleType):
    assert_came_back(kimera.edge_from_hydra(kimera.edge_to_hydra(edge(), "camera")))
    message = kimera.edge_to_kimera(edge(), "camera")
    assert_came_back(kimera.edge_from_kimera(message, {4: FROM_NS, 9: TO_NS}))
    assert kimera.edge_from_kimera(message, {4: FROM_NS}) is None


def test_rtabmap_gets_its_node_ids_and_the_information_translation_first(rtabmap: ModuleType):
    message = rtabmap.edge_to_link(edge(), {FROM_NS: 17, TO_NS: 23})
    assert (message.from_id, message.to_id, message.type) == (17, 23, rtabmap.USER_CLOSURE)
    t = message.transform.translation
    np.testing.assert_allclose([t.x, t.y, t.z], T_FROM_TO[:3, 3])
    blocks = [3, 4, 5, 0, 1, 2]
    expected = np.linalg.inv(covariance()[np.ix_(blocks, blocks)])
    np.testing.assert_allclose(matrix(message.information), expected, rtol=1e-9)


def test_link_weighs_an_error_as_the_edge_does(rtabmap: ModuleType):
    """The error of RTAB-Map's optimisers, log(measured^-1 estimated) with translation first."""
    message = rtabmap.edge_to_link(edge(), {FROM_NS: 17, TO_NS: 23})
    xi = np.array([0.02, -0.01, 0.03, 0.1, 0.2, -0.1])
    swapped = np.concatenate([xi[3:], xi[:3]])
    assert swapped @ matrix(message.information) @ swapped == pytest.approx(
        xi @ np.linalg.solve(covariance(), xi)
    )


def test_links_come_back_where_their_nodes_are_known(rtabmap: ModuleType):
    message = rtabmap.edge_to_link(edge(EdgeKind.ODOMETRY), {FROM_NS: 17, TO_NS: 23})
    assert message.type == rtabmap.NEIGHBOR
    assert_came_back(rtabmap.edge_from_link(message, {17: FROM_NS, 23: TO_NS}))
    assert rtabmap.edge_from_link(message, {23: TO_NS}) is None
    assert rtabmap.edge_to_link(edge(), {FROM_NS: 17}) is None


def test_link_that_says_nothing_of_rotation_is_position_only(rtabmap: ModuleType):
    message = rtabmap.edge_to_link(
        replace(edge(), covariance=np.diag([9999.0] * 3 + [0.01] * 3)), {FROM_NS: 17, TO_NS: 23}
    )
    back = rtabmap.edge_from_link(message, {17: FROM_NS, 23: TO_NS})
    np.testing.assert_allclose(np.diag(back.covariance), [9999.0] * 3 + [0.01] * 3)


def test_information_that_is_none_is_refused(rtabmap: ModuleType):
    message = rtabmap.edge_to_link(edge(), {FROM_NS: 17, TO_NS: 23})
    message.information = np.zeros(36)
    with pytest.raises(InputError, match="not positive definite"):
        rtabmap.edge_from_link(message, {17: FROM_NS, 23: TO_NS})


def test_edge_moved_to_the_body_says_the_same_of_the_body():
    moved = moved_to_body(edge(), T_BODY_CAMERA)

    def of_body(T_from_to: Array) -> Array:
        return T_BODY_CAMERA @ T_from_to @ inverse(T_BODY_CAMERA)

    np.testing.assert_allclose(moved.T_from_to, of_body(T_FROM_TO), atol=1e-12)
    np.testing.assert_allclose(moved.covariance, propagated_covariance(of_body), rtol=1e-5, atol=1e-9)
    back = moved_to_camera(moved, T_BODY_CAMERA)
    np.testing.assert_allclose(back.T_from_to, T_FROM_TO, atol=1e-12)
    np.testing.assert_allclose(back.covariance, covariance(), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(
    ("name", "package"), [("pose_graph_tools", "pose_graph_tools_msgs"), ("rtabmap", "rtabmap_msgs")]
)
def test_adapter_needs_its_message_package(name: str, package: str):
    if util.find_spec(package):
        pytest.skip(f"{package} is installed")
    with pytest.raises(ModuleNotFoundError, match=package):
        import_module(f"neuse_slam_node.adapters.{name}")
