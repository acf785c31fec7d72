"""Parameters of the nodes, and requests to the services of mapper_node, which stands for all nodes."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import rclpy
from hypothesis import strategies as st
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions

from neuse.errors import ParamError
from neuse.params import build, flatten
from neuse_encoder_node.node import EncoderNodeParams
from neuse_mapper_node.node import MapperNode, MapperNodeParams
from neuse_msgs.srv import LoadMap, SaveMap
from neuse_slam_node.node import SlamNodeParams

from .messages import toured_mapper
from .soundness import assert_sound
from .spoiling import FLOATS, INTEGERS, ODD, TEXTS
from .target import Target


def service_targets(folder: Path) -> Iterator[Target]:
    """One for the parameters of each node, and one for each service."""
    for name, defaults in {
        "encoder_node": EncoderNodeParams(),
        "slam_node": SlamNodeParams(),
        "mapper_node": MapperNodeParams(),
    }.items():
        names = st.sampled_from([*flatten(defaults), "", "slam", "no.such", "mapper.library."])
        yield Target(f"parameters of {name}", st.tuples(names, ODD | _alike()), _building(defaults))
    node = _mapper_node()
    fifo = folder / "fifo"
    if not fifo.exists():
        os.mkfifo(fifo)
    known = st.sampled_from(
        ["", ".", "/", "/proc/1/x", "a/b", "a" * 5000, str(folder), str(fifo), "/dev/full"]
    )
    paths = known | TEXTS.filter(lambda text: "/" not in text)
    yield Target("~/save_map", paths, _asking(node, SaveMap, folder))
    yield Target("~/load_map", paths, _asking(node, LoadMap, folder))
    yield Target(
        "~/set_parameters",
        st.tuples(st.sampled_from(list(flatten(MapperNodeParams()))), _alike()),
        _setting(node),
    )
    yield Target("~/change_state", st.tuples(st.integers(0, 255), TEXTS), _changing(node))


def _alike() -> st.SearchStrategy[Any]:
    """What a parameter of ROS can be."""
    lists = st.lists(TEXTS, max_size=3).map(tuple) | st.lists(FLOATS, max_size=8).map(tuple)
    return FLOATS | INTEGERS | TEXTS | st.booleans() | lists


def _building(defaults: Any) -> Callable[[tuple[str, Any]], None]:
    def read(given: tuple[str, Any]) -> None:
        name, value = given
        params = build(defaults, {name: value})
        for own, sound in zip(flatten(params).values(), flatten(defaults).values(), strict=True):
            kinds = {float: float | int, tuple: tuple | list}.get(type(sound), type(sound))
            assert isinstance(own, kinds), name
            assert isinstance(own, bool) == isinstance(sound, bool), name
            assert_sound(float(own) if isinstance(own, int) else own, name)

    return read


def _mapper_node() -> MapperNode:
    """A node that is spoken to directly, with a map that may not get lost."""
    if not rclpy.ok():
        rclpy.init(domain_id=100, signal_handler_options=SignalHandlerOptions.NO)
    node = MapperNode()
    node.set_parameters([Parameter("weights", value=["mug"])])
    node.get_logger().set_level(rclpy.logging.LoggingSeverity.FATAL)
    node.trigger_configure()
    node._mapper = toured_mapper()
    return node


def _asking(node: MapperNode, kind: type, folder: Path) -> Callable[[str], None]:
    """A request answered by yes keeps the map as much as one answered by no."""
    (service,) = (service for service in node._services_here if service.srv_type is kind)
    objects = len(node._mapper.object_map.objects)

    def read(path: str) -> None:
        with _inside(folder):
            response = service.callback(kind.Request(path=path), kind.Response())
        assert response.message
        assert len(node._mapper.object_map.objects) == objects
        if not response.success:
            raise ParamError(response.message)

    return read


@contextmanager
def _inside(folder: Path) -> Iterator[None]:
    """Relative paths lie in the folder."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


def _setting(node: MapperNode) -> Callable[[tuple[str, Any]], None]:
    """A working node takes no parameter."""

    def read(given: tuple[str, Any]) -> None:
        name, value = given
        try:
            parameter = Parameter(
                name, value=list(value) if isinstance(value, tuple) else value
            ).to_parameter_msg()
        except (TypeError, OverflowError, AssertionError) as error:  # no message can say this
            raise ParamError(str(error)) from error
        assert parameter.value.type != ParameterType.PARAMETER_NOT_SET
        request = SetParameters.Request(parameters=[parameter])
        response = node._parameter_service._set_parameters_callback(request, SetParameters.Response())
        (result,) = response.results
        assert not result.successful
        raise ParamError(result.reason)

    return read


def _changing(node: MapperNode) -> Callable[[tuple[int, str]], None]:
    """Transitions that the inactive node does not have are refused; the others are no malformed input."""
    known = {
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_ACTIVATE,
        Transition.TRANSITION_INACTIVE_SHUTDOWN,
    }

    def read(given: tuple[int, str]) -> None:
        number, label = given
        if number in known:
            return
        transition = Transition(id=number)
        response = node._service_change_state.callback(
            ChangeState.Request(transition=transition), ChangeState.Response()
        )
        assert not response.success
        raise ParamError(f"no transition {number} {label!r}")

    return read
