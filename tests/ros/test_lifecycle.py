"""Nodes under a lifecycle manager, with wrong parameters, and told to change parameters while they work."""

from pathlib import Path

import pytest
from conftest import START_S
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from peer import Peer
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from rclpy.node import Node

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def peer(node: Node, start_node) -> Peer:
    start_node("slam_node", autostart=False)
    return Peer(node, "slam_node")


def state(peer: Peer) -> int:
    return peer.call(GetState, "slam_node/get_state", GetState.Request()).current_state.id


def change_state(peer: Peer, transition: int) -> bool:
    request = ChangeState.Request(transition=Transition(id=transition))
    return peer.call(ChangeState, "slam_node/change_state", request).success


def set_parameter(peer: Peer, name: str, value: float) -> tuple[bool, str]:
    typed = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    request = SetParameters.Request(parameters=[Parameter(name=name, value=typed)])
    (result,) = peer.call(SetParameters, "slam_node/set_parameters", request).results
    return result.successful, result.reason


def test_node_waits_for_its_manager_and_goes_through_its_states(peer: Peer):
    assert state(peer) == State.PRIMARY_STATE_UNCONFIGURED
    for transition, reached in [
        (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
        (Transition.TRANSITION_DEACTIVATE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_CLEANUP, State.PRIMARY_STATE_UNCONFIGURED),
        (Transition.TRANSITION_CONFIGURE, State.PRIMARY_STATE_INACTIVE),
        (Transition.TRANSITION_ACTIVATE, State.PRIMARY_STATE_ACTIVE),
    ]:
        assert change_state(peer, transition)
        assert state(peer) == reached


def test_impossible_transition_is_refused_and_the_node_lives_on(peer: Peer):
    assert state(peer) == State.PRIMARY_STATE_ACTIVE
    assert not change_state(peer, Transition.TRANSITION_CONFIGURE)
    assert state(peer) == State.PRIMARY_STATE_ACTIVE


def test_parameter_of_a_working_node_cannot_be_changed(peer: Peer):
    successful, reason = set_parameter(peer, "odometry_wait_s", 0.5)
    assert not successful
    assert "clean up the node first" in reason


def test_value_outside_the_range_is_refused_by_ros_itself(peer: Peer):
    successful, reason = set_parameter(peer, "odometry_wait_s", -1.0)
    assert not successful
    assert "odometry_wait_s" in reason


def test_every_parameter_is_described(peer: Peer):
    names = peer.call(ListParameters, "slam_node/list_parameters", ListParameters.Request()).result.names
    own = [name for name in names if not name.startswith(("use_sim_time", "start_type_description"))]
    request = DescribeParameters.Request(names=own)
    descriptors = peer.call(DescribeParameters, "slam_node/describe_parameters", request).descriptors
    assert len(own) > 30
    assert all(descriptor.description for descriptor in descriptors)
    described = {d.name: d for d in descriptors}
    assert described["slam.odometry.max_speed_mps"].floating_point_range[0].to_value == 1000.0


def test_node_with_a_value_outside_its_range_says_so_in_one_line(start_node):
    node = start_node("slam_node", odometry_wait_s=-3.0)
    assert node.process.wait(timeout=START_S) == 2
    assert "odometry_wait_s" in node.output
    assert "Traceback" not in node.output


def test_node_with_a_value_of_the_wrong_type_says_so_in_one_line(start_node):
    node = start_node("slam_node", topic_depth="many")
    assert node.process.wait(timeout=START_S) == 2
    assert "topic_depth" in node.output
    assert "Traceback" not in node.output


def test_parameter_file_that_is_missing_is_told_in_one_line(start_node):
    node = start_node("slam_node", params_file="/nowhere/slam.yaml")
    assert node.process.wait(timeout=START_S) == 2
    assert "/nowhere/slam.yaml" in node.output
    assert "Traceback" not in node.output


def test_node_that_was_shut_down_still_ends_well(node: Node, start_node):
    mapper = start_node("mapper_node", autostart=False)
    peer = Peer(node, "mapper_node")
    shutdown = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_UNCONFIGURED_SHUTDOWN))
    assert peer.call(ChangeState, "mapper_node/change_state", shutdown).success
    assert mapper.end() == 0
    assert "Traceback" not in mapper.output


def test_node_that_cannot_be_configured_says_why_and_waits(node: Node, start_node):
    mapper = start_node("mapper_node", load_path="/nowhere/table.map")
    peer = Peer(node, "mapper_node")
    peer.wait_for(lambda: peer.level == DiagnosticStatus.ERROR, "an error in /diagnostics")
    assert "/nowhere/table.map" in peer.message
    assert "cannot configure" in mapper.output
    assert mapper.process.poll() is None
    mapper.end()


def test_damaged_weights_are_told_and_the_node_works_once_they_are_replaced(
    node: Node, start_node, tmp_path: Path
):
    damaged = tmp_path / "mug.safetensors"
    damaged.write_bytes(b"no weights")
    encoder = start_node("encoder_node", weights=f"['{damaged}']")
    peer = Peer(node, "encoder_node")
    peer.wait_for(lambda: peer.level == DiagnosticStatus.ERROR, "an error in /diagnostics")
    assert str(damaged) in peer.message
    assert "Traceback" not in encoder.output

    typed = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=["mug"])
    request = SetParameters.Request(parameters=[Parameter(name="weights", value=typed)])
    assert peer.call(SetParameters, "encoder_node/set_parameters", request).results[0].successful
    configure = ChangeState.Request(transition=Transition(id=Transition.TRANSITION_CONFIGURE))
    assert peer.call(ChangeState, "encoder_node/change_state", configure).success
    peer.wait_for(lambda: peer.level == DiagnosticStatus.OK, "recovery in /diagnostics")


def test_missing_weights_are_told(node: Node, start_node):
    mapper = start_node("mapper_node", weights="['unicorn']")
    peer = Peer(node, "mapper_node")
    peer.wait_for(lambda: "unicorn" in peer.message, "an error in /diagnostics")
    assert mapper.process.poll() is None
