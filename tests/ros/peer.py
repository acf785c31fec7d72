"""What a test needs to talk to a node under test: publishers, collected messages, counters, and patience."""

import time
from collections.abc import Callable
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from lifecycle_msgs.srv import GetState
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile

from neuse_encoder_node.conversions import stamp_from_msg

SETTLE_S = 1.0  # the node must know, too, where its answers go
WAIT_S = 120.0


class Peer:
    """The other side of one node under test, whose diagnostics it follows."""

    def __init__(self, node: Node, name: str) -> None:
        self._node, self._name = node, name
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(node)
        self._publishers: dict[str, Any] = {}
        self.heard: dict[str, list[Any]] = {}
        self.diagnostics: dict[str, str] = {}
        self.level, self.message = b"", ""
        node.create_subscription(DiagnosticArray, "/diagnostics", self._hear_diagnostics, 50)

    def listen(self, message_type: type, topic: str, qos: QoSProfile | int = 1000) -> list[Any]:
        """Collect the messages of a topic, in a list that grows."""
        found = self.heard.setdefault(topic, [])
        self._node.create_subscription(message_type, topic, found.append, qos)
        return found

    def connect(self, message_type: type, topic: str, qos: QoSProfile | int = 1000) -> None:
        """Get ready to send to a topic that the node under test hears."""
        publisher = self._node.create_publisher(message_type, topic, qos)
        self._publishers[topic] = publisher
        self.wait_for(lambda: publisher.get_subscription_count() > 0, f"a subscriber of {topic}")

    def meet(self) -> None:
        """Make sure that the node under test knows all publishers and subscribers of this side.

        Endpoints get known in the order in which they were made, those of the service call are the last.
        """
        self.call(GetState, f"{self._name}/get_state", GetState.Request())

    def send(self, topic: str, message: Any) -> None:
        self._publishers[topic].publish(message)

    def wait_for(self, condition: Callable[[], Any], what: str) -> Any:
        """Spin until the condition holds; its value."""
        deadline_s = time.monotonic() + WAIT_S
        while not (value := condition()):
            assert time.monotonic() < deadline_s, f"no {what}; the node said last: {self.message}"
            self._executor.spin_once(timeout_sec=0.05)
        return value

    def spin(self, seconds: float) -> None:
        """Listen for so long."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self._executor.spin_once(timeout_sec=0.05)

    def wait_for_stamp(self, topic: str, stamp_ns: int) -> Any:
        """The message of this stamp."""
        return self.wait_for(
            lambda: [m for m in self.heard[topic] if stamp_from_msg(m.header.stamp) == stamp_ns],
            f"message with stamp {stamp_ns} on {topic}",
        )[0]

    def count(self, name: str) -> int:
        """A counter as it was reported last."""
        return int(self.diagnostics.get(name, "0"))

    def wait_for_count(self, name: str, least: int = 1) -> None:
        self.wait_for(lambda: self.count(name) >= least, f"counter {name} = {least} in /diagnostics")

    def call(self, service_type: type, name: str, request: Any) -> Any:
        """Call a service of the node under test."""
        client = self._node.create_client(service_type, name)
        self.wait_for(client.service_is_ready, f"service {name}")
        self.spin(SETTLE_S)
        future = client.call_async(request)
        self.wait_for(future.done, f"answer of {name}")
        return future.result()

    def _hear_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name == self._name:
                self.diagnostics = {item.key: item.value for item in status.values}
                self.level, self.message = status.level, status.message
