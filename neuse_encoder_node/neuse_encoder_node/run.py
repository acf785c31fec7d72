"""The main function of the nodes: start, activate, spin, and end without losing what has arrived."""

import signal
import threading
import time
from collections.abc import Callable

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.signals import SignalHandlerOptions

from neuse.errors import ParamError
from neuse_encoder_node.stage_node import StageNode

try:  # spends less on each message; the first releases of Jazzy do not have it
    from rclpy.experimental import EventsExecutor as Executor
except ImportError:
    Executor = SingleThreadedExecutor

GRACE_S = 0.5


def run(make_node: Callable[[], StageNode]) -> int:
    """Run a node until Ctrl-C or SIGTERM; what waits in its queue is finished first. Returns an exit code."""
    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # whatever rcl finds wrong with the arguments
        return _refuse_to_start(error)
    try:
        node = make_node()
    except (ParameterException, ParamError) as error:
        return _refuse_to_start(error)
    if node.get_parameter("autostart").value and node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
        node.trigger_activate()
    _spin(node, stop)
    if not node.is_shut_down:
        node.trigger_shutdown()
    node.destroy_node()
    rclpy.shutdown()
    return 0


def _refuse_to_start(error: Exception) -> int:
    reason = str(error).splitlines()[0]
    rclpy.logging.get_logger("neuse").fatal(f"cannot start: {reason}; correct the arguments")
    rclpy.try_shutdown()
    return 2


def _spin(node: StageNode, stop: threading.Event) -> None:
    """Spin until stopped, and a little longer: messages that have arrived are still taken.

    rclpy's own handling of signals would close the context before the last messages are out.
    """
    executor = Executor()
    executor.add_node(node)
    while not stop.is_set():
        executor.spin_once(timeout_sec=0.1)
    end_s = time.monotonic() + GRACE_S
    while time.monotonic() < end_s:
        executor.spin_once(timeout_sec=0.05)
    executor.remove_node(node)
