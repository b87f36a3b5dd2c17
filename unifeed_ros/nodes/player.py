"""Feed recorded messages to live nodes, each alone in a namespace, no faster than they take them.

DDS promises no order between topics, and drops what a best-effort reader has no room for. Therefore the player asks a
node's parameter service, after at most half of what a subscription holds and after every latched message: the answer
comes when the node has taken what was sent before. This gives the same results again on every machine it was tried on;
the middleware does not promise it.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any

import rclpy
from rcl_interfaces.srv import GetParameters
from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.executors import SingleThreadedExecutor
from rclpy.publisher import Publisher
from rclpy.signals import SignalHandlerOptions
from rclpy.task import Future

from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.nodes.node import message_type
from unifeed_ros.nodes.topics import SENSOR, SUBSCRIBER_DEPTH, find_topic, publisher_qos, subscriber_qos

START_S = 60.0
"""Longest wait for a node to be there [s]."""
TAKEN_S = 20.0
"""Longest wait for a node to have taken what was sent [s]."""
LARGEST_BURST = 200
"""Most messages of a fast topic on their way at once, twice: the middleware's shared memory holds some 500."""


class ReplayError(UnifeedError):
    """A node that ended, or does not answer, while a recording is played to it."""


class PlayClock:
    """Recorded time against wall-clock time.

    Args:
        rate: Recorded seconds per second; 0: as fast as the nodes follow.
        wait: Spends wall-clock time [s].
    """

    def __init__(self, rate: float, wait: Callable[[float], object]) -> None:
        self._rate, self._wait = rate, wait
        self._began: tuple[float, int] | None = None

    def wait_until(self, moment: int) -> None:
        """Wait until a recorded time has come [ns since the epoch]."""
        if not self._rate:
            return
        if self._began is None:
            self._began = (time.monotonic(), moment)
        due = self._began[0] + (moment - self._began[1]) * 1e-9 / self._rate
        self._wait(max(0.0, due - time.monotonic()))

    def stand_still(self) -> None:
        """Let no recorded time pass until the next message: what took long was no part of the recording."""
        self._began = None


class Player:
    """Publishes to nodes and hears what they say; as a context manager it leaves nothing behind.

    Args:
        namespace: Beginning of the nodes' namespaces; each has one that ends with its name.
        alive: Raises ReplayError if a node has ended.
    """

    def __init__(self, namespace: str, alive: Callable[[], None]) -> None:
        self._namespace, self._alive = namespace, alive
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self._node = rclpy.create_node("player", namespace=namespace)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self._publishers: dict[tuple[str, str], Publisher] = {}
        self._barriers: dict[str, Client] = {}
        self._room: dict[str, dict[str, int]] = {}
        self._pending: Counter[tuple[str, str]] = Counter()
        self.sent = 0
        """Messages sent."""

    def __enter__(self) -> Player:
        """Use as a context manager: leaving it ends the player."""
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """End the player."""
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown()

    def connect(self, node: str, inputs: Iterable[str], fast: int = SUBSCRIBER_DEPTH[SENSOR]) -> None:
        """Wait until a node is there and hears every input.

        Args:
            node: Name of the node.
            inputs: Topics of the table that it is fed.
            fast: Messages of a fast topic that it keeps until it takes them.

        Raises:
            ReplayError: It does not come, or ended.
        """
        for topic in inputs:
            self._publishers[node, topic] = self._node.create_publisher(
                message_type(topic), self._name(node, topic), publisher_qos(topic))
        self._room[node] = {**SUBSCRIBER_DEPTH, SENSOR: min(fast, LARGEST_BURST)}
        self._barriers[node] = self._node.create_client(GetParameters, self._name(node, f"{node}/get_parameters"))
        mine = [p for (name, _), p in self._publishers.items() if name == node]
        self._spin_until(lambda: self._barriers[node].service_is_ready()
                         and all(p.get_subscription_count() for p in mine), START_S, f"{node} to start")

    def hear(self, node: str, topic: str, callback: Callable[[Any], None]) -> None:
        """Call back with every message that a node publishes on a topic of the table."""
        self._node.create_subscription(message_type(topic), self._name(node, topic), callback,
                                       subscriber_qos(topic, depth=1000))

    def send(self, node: str, topic: str, data: bytes) -> None:
        """Send a serialised message to a node, and wait for it where more would be lost.

        Raises:
            ReplayError: The node ended or does not answer.
        """
        self._publishers[node, topic].publish(data)
        self.sent += 1
        self._pending[node, topic] += 1
        kind = find_topic(topic)
        if kind.latched or 2 * self._pending[node, topic] >= self._room[node][kind.qos]:
            self.settle(node)

    def settle(self, node: str) -> None:
        """Wait until a node has taken everything that was sent to it.

        Raises:
            ReplayError: It ended or does not answer.
        """
        self._answer(self._barriers[node].call_async(GetParameters.Request()), TAKEN_S, f"{node} to take its messages")
        for key in [key for key in self._pending if key[0] == node]:
            self._pending[key] = 0

    def call(self, node: str, kind: type, service: str, request: Any, timeout: float) -> Any:
        """Call a service of a node and wait for the answer.

        Raises:
            ReplayError: It is not there, or does not answer in time [s].
        """
        client = self._node.create_client(kind, self._name(node, service))
        try:
            self._spin_until(client.service_is_ready, START_S, f"service {service}")
            return self._answer(client.call_async(request), timeout, f"service {service} to answer")
        finally:
            self._node.destroy_client(client)

    def act(self, node: str, kind: type, action: str, goal: Any, timeout: float) -> Any:
        """Send a goal to an action of a node and wait for its result.

        Raises:
            ReplayError: It is not there, refuses the goal, or does not end in time [s].
        """
        client = ActionClient(self._node, kind, self._name(node, action))
        try:
            self._spin_until(client.server_is_ready, START_S, f"action {action}")
            handle = self._answer(client.send_goal_async(goal), timeout, f"action {action} to take the goal")
            if not handle.accepted:
                raise ReplayError(f"action {action} refused the goal")
            return self._answer(handle.get_result_async(), timeout, f"action {action} to end").result
        finally:
            client.destroy()

    def spin(self, duration: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Take messages for a while; true as soon as the condition holds."""
        deadline = time.monotonic() + duration
        while not until():
            left = deadline - time.monotonic()
            if left <= 0.0:
                return False
            self._executor.spin_once(timeout_sec=min(0.05, left))
        return True

    def _answer(self, future: Future, timeout: float, what: str) -> Any:
        self._spin_until(future.done, timeout, what)
        return future.result()

    def _spin_until(self, condition: Callable[[], bool], timeout: float, what: str) -> None:
        deadline = time.monotonic() + timeout
        while not self.spin(0.2, condition):
            self._alive()
            if time.monotonic() > deadline:
                raise ReplayError(f"waited {timeout:.0f} s for {what}", mend="see its log")

    def _name(self, node: str, topic: str) -> str:
        return f"{self._namespace}/{node}/{topic.lstrip('/')}"
