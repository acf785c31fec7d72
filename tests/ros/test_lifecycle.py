"""Nodes under a lifecycle manager, with wrong parameters, and told to change parameters while they work."""

import signal
from pathlib import Path

import pytest
from conftest import START_S, RunningNode
from diagnostic_msgs.msg import DiagnosticStatus
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from mapping.synthetic import five_things, make_world, orbit
from peer import Peer
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, ListParameters, SetParameters
from rclpy.node import Node

from neuse.mapping.mapper import ObjectMapper

pytestmark = pytest.mark.ros


@pytest.fixture(scope="module")
def slam(start_node, tmp_path_factory: pytest.TempPathFactory) -> RunningNode:
    shared = tmp_path_factory.mktemp("params") / "shared.yaml"
    shared.write_text("/**: {ros__parameters: {use_sim_time: false, slam: {keyframs: {near_m: 0.2}}}}")
    return start_node("slam_node", autostart=False, params_file=shared)


@pytest.fixture(scope="module")
def peer(node: Node, slam: RunningNode) -> Peer:
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


def test_node_with_an_integer_for_a_decimal_says_what_to_write(start_node):
    node = start_node("slam_node", **{"slam.stamp_tolerance_s": 1})
    assert node.process.wait(timeout=START_S) == 2
    assert "parameter slam.stamp_tolerance_s = 1 is none; write 1.0" in node.output
    assert "Traceback" not in node.output


def test_node_with_a_parameter_that_it_does_not_have_names_the_nearest(start_node):
    node = start_node("mapper_node", save_pth="/tmp/room.map")
    assert node.process.wait(timeout=START_S) == 2
    assert "mapper_node has no parameter 'save_pth' (near: save_path" in node.output
    assert "Traceback" not in node.output


def test_file_of_all_nodes_may_have_what_this_one_does_not_know_and_that_is_told(
    peer: Peer, slam: RunningNode
):
    assert state(peer)
    (told,) = [line for line in slam.output.splitlines() if "has no parameter" in line]
    assert "slam_node has no parameter 'slam.keyframs.near_m' (near: slam.keyframes.near_m" in told


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


def test_place_of_the_map_that_cannot_be_written_to_is_told_at_the_start(node: Node, start_node):
    mapper = start_node("mapper_node", save_path="/nodir/x/room.map", weights="['mug']")
    peer = Peer(node, "mapper_node")
    peer.wait_for(lambda: "/nodir/x does not exist" in peer.message, "an error in /diagnostics")
    assert peer.level == DiagnosticStatus.ERROR
    assert "cannot configure: save_path '/nodir/x/room.map'" in mapper.output
    mapper.end()


def test_map_that_cannot_be_saved_at_the_end_is_told_and_counted(node: Node, start_node, tmp_path: Path):
    known, folder = tmp_path / "known.map", tmp_path / "kept"
    folder.mkdir()
    world = make_world(five_things(), ObjectMapper({}))
    world.tour(orbit(count=16))
    world.mapper.save(known)
    mapper = start_node("mapper_node", load_path=known, save_path=folder / "room.map", weights="['mug']")
    peer = Peer(node, "mapper_node")
    peer.wait_for_count("objects", 5)
    folder.rmdir()
    mapper.process.send_signal(signal.SIGINT)
    peer.wait_for_count("map_not_saved")
    assert mapper.end() == 0
    assert f"map_not_saved: cannot write the map to {folder / 'room.map'}" in mapper.output
    assert "Traceback" not in mapper.output


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
