"""What the three nodes share: a lifecycle node that runs one stage of the library in a worker thread."""

import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import ChangeState
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

from neuse.errors import InputError, NeuseError
from neuse.params import CheckedParams, flatten, param
from neuse_encoder_node.health import DROPPED, Health
from neuse_encoder_node.overrides import check_overrides
from neuse_encoder_node.parameters import declare_parameters, read_parameters
from neuse_encoder_node.stamps import StampOrder, Succession
from neuse_encoder_node.worker import Worker

RCLError = rclpy_implementation.RCLError
LOG_PERIOD_S = 5.0
SUMMARY_PERIOD_S = 10.0
FLUSH = Duration(seconds=1)


@dataclass(frozen=True)
class StageParams(CheckedParams):
    """Parameters that every node has."""

    autostart: bool = param(True, "configure and activate on start; false: wait for a lifecycle manager")
    queue_size: int = param(
        10, "frames that may wait for the worker; beyond it the oldest is dropped", 1, 100000
    )
    restart_s: float = param(
        1.0, "stamps that step back by more than this are a new run: everything is forgotten", 0.0, 1e6
    )
    finish_s: float = param(
        10.0, "when the node ends it goes on at most so long with what waits, seconds", 0.0, 1e5
    )


class StageNode(LifecycleNode):
    """A lifecycle node around one stage.

    A subclass says what to build (`build`), what to do with one item of the queue (`process`, in the
    worker), and how to forget (`forget`). It hands items over with `enqueue`. The stage itself knows no
    threads: `lock` is held whenever it is touched. A NeuseError drops the item, with one line and a
    counter; the node lives on.
    """

    def __init__(self, name: str, defaults: StageParams) -> None:
        super().__init__(name)
        self.defaults = defaults
        self.health = Health()
        self.lock = threading.Lock()
        self._worker: Worker | None = None
        self._active = False
        self.is_shut_down = False
        self._logged_s: dict[str, float] = {}
        self._subscriptions_here: list[Any] = []
        self._publishers_here: list[Any] = []
        self._services_here: list[Any] = []
        self._change_state = self._service_change_state.callback
        self._service_change_state.callback = self._change_state_if_possible
        declare_parameters(self, defaults)
        check_overrides(self, flatten(defaults))
        self.add_on_set_parameters_callback(self._check_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(1.0, self.report, clock=steady)
        self.create_timer(SUMMARY_PERIOD_S, self._say_summary, clock=steady)

    def build(self, params: Any) -> None:
        """Build the stage and its connections."""
        raise NotImplementedError

    def process(self, stamp_ns: int, item: Any) -> None:
        """Work on one item."""
        raise NotImplementedError

    def forget(self) -> None:
        """Start anew, as if just built."""
        raise NotImplementedError

    def order_of(self, item: Any) -> StampOrder:
        """The stamps among which an item comes in turn."""
        return self._order

    def flush(self) -> None:
        """Hand over to the worker what still waits, before the node falls silent."""

    def finish(self) -> None:
        """Publish what is still open once the worker is done."""

    def listen(
        self,
        message_type: type,
        topic: str,
        callback: Callable[[Any], None],
        qos: QoSProfile,
        raw: bool = False,
    ) -> None:
        """Subscribe until the node is cleaned up; nothing is heard while it is inactive. raw: bytes are."""

        def hear(message: Any) -> None:
            if self._active:
                self._guarded(lambda: callback(message), topic)

        self._subscriptions_here.append(self.create_subscription(message_type, topic, hear, qos, raw=raw))

    def offer(self, message_type: type, topic: str, qos: QoSProfile) -> Any:
        """A publisher until the node is cleaned up; silent while it is inactive."""
        publisher = self.create_lifecycle_publisher(message_type, topic, qos)
        self._publishers_here.append(publisher)
        return publisher

    def serve(self, service_type: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Answer a service until the node is cleaned up."""
        self._services_here.append(self.create_service(service_type, name, callback))

    def enqueue(self, stamp_ns: int, item: Any) -> None:
        """Hand an item to the worker."""
        if self._worker is not None:
            self._worker.put((stamp_ns, item))

    @property
    def is_behind(self) -> bool:
        """Whether items wait for the worker: no time for what is only to be looked at."""
        return self.backlog > 0

    @property
    def backlog(self) -> int:
        """How many items wait for the worker."""
        return 0 if self._worker is None else self._worker.waiting

    def refuse(self, reason: str, detail: str, amount: int = 1) -> None:
        """Count a fault of the input, and log it unless this reason was logged just now."""
        self.health.refuse(reason, amount)
        now_s = time.monotonic()
        if now_s - self._logged_s.get(reason, -LOG_PERIOD_S) >= LOG_PERIOD_S:
            self._logged_s[reason] = now_s
            self.get_logger().warning(f"{reason}: {detail}")

    def report(self) -> None:
        """Publish the node's diagnostics."""
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(self.health.report(self.get_fully_qualified_name().lstrip("/"), header))

    def _say_summary(self) -> None:
        if self._active:
            self.get_logger().info(self.health.summary())

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        try:
            params = read_parameters(self, self.defaults)
            self._order, self._finish_s = StampOrder(params.restart_s), params.finish_s
            self.build(params)
            self._worker = Worker(self.get_name(), self._work, params.queue_size, self._dropped)
        except NeuseError as error:
            self.get_logger().error(f"cannot configure: {error}")
            self.health.fail(f"cannot configure: {error}")
            self._disconnect()
            return TransitionCallbackReturn.FAILURE
        self.health.fail("")
        return super().on_configure(state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        result = super().on_activate(state)
        self._active = True
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._fall_silent()
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._disconnect()
        return super().on_cleanup(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._fall_silent()
        self._disconnect()
        self.is_shut_down = True
        return super().on_shutdown(state)

    def _fall_silent(self) -> None:
        """Hear no more, work through what waits, and say what is still open."""
        if not self._active or self._worker is None:
            return
        self._active = False
        self.flush()
        if not self._worker.drain(self._finish_s):
            self.refuse("unfinished", f"frames still waited after {self._finish_s:.0f} s; they are dropped")
        with self.lock:
            self.finish()
        self.report()
        for publisher in [*self._publishers_here, self._diagnostics]:
            publisher.wait_for_all_acked(FLUSH)

    def _disconnect(self) -> None:
        if self._worker is not None:
            self._worker.stop()
            self._worker = None
        for subscription in self._subscriptions_here:
            self.destroy_subscription(subscription)
        for publisher in self._publishers_here:
            self.destroy_lifecycle_publisher(publisher)
        for service in self._services_here:
            self.destroy_service(service)
        self._subscriptions_here, self._publishers_here, self._services_here = [], [], []

    def _work(self, entry: tuple[int, Any]) -> None:
        stamp_ns, item = entry
        with self.lock:
            self._guarded(lambda: self._process_in_order(stamp_ns, item), f"stamp {stamp_ns} ns")

    def _guarded(self, act: Callable[[], None], what: str) -> None:
        """Act upon a message; the node outlives whatever is wrong with it."""
        try:
            act()
        except InputError as error:
            self.refuse(error.reason, f"{error} ({what})")
        except NeuseError as error:
            self.refuse(type(error).__name__, f"{error} ({what})")
        except Exception as error:  # the last guard: no message may end a node
            self.refuse("internal_error", f"{error!r} ({what}); the message is dropped, please report it")
            self.get_logger().debug(traceback.format_exc())

    def _process_in_order(self, stamp_ns: int, item: Any) -> None:
        succession = self.order_of(item).follow(stamp_ns)
        if succession == Succession.STALE:
            raise InputError("stale_stamp", "stamp is not later than the one before; the frame is dropped")
        if succession == Succession.RESTART:
            self.refuse("time_jump", f"stamps went back to {stamp_ns} ns: a new run, everything is forgotten")
            self.forget()
        self.process(stamp_ns, item)
        self.health.tally("frames")

    def _dropped(self, entry: tuple[int, Any]) -> None:
        self.refuse(
            DROPPED,
            f"frame {entry[0]} ns came faster than it can be worked on; slow down or widen queue_size",
        )

    def _change_state_if_possible(self, request: ChangeState.Request, response: ChangeState.Response) -> Any:
        """Refuse a transition that the present state does not have; rclpy of Jazzy would end the process."""
        try:
            return self._change_state(request, response)
        except RCLError as error:
            self.refuse("impossible_transition", str(error).splitlines()[0])
            response.success = False
            return response

    def _check_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """The stage reads its parameters when it is configured, and not later."""
        own = [parameter.name for parameter in parameters if parameter.name != "use_sim_time"]
        if own and self._worker is not None:
            reason = f"{own[0]} is read on configuration: deactivate and clean up the node first"
            return SetParametersResult(successful=False, reason=reason)
        return SetParametersResult(successful=True)
