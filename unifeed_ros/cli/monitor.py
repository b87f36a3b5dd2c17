"""Listen to a session from outside: what state it is in, what was learned, how its loop runs."""

from __future__ import annotations

import errno
import socket
import time
from collections.abc import Callable
from types import TracebackType

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.executors import SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions
from std_srvs.srv import Trigger

from unifeed_msgs.msg import Interaction, LessonState
from unifeed_ros.nodes.node import DIAGNOSTICS_PREFIX
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos

DISCOVERY_S = 1.5
"""Time in which a running session is discovered [s]."""


class SessionMonitor:
    """A node that only listens, and can stop the arm."""

    def __init__(self, name: str = "unifeed_monitor") -> None:
        self.lesson = LessonState()
        self.interactions: list[Interaction] = []
        self.diagnostics: dict[str, DiagnosticStatus] = {}
        rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
        self.node = rclpy.create_node(name)
        """For clients of the session's services."""
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)
        self.node.create_subscription(LessonState, "lesson_state", self._on_lesson, subscriber_qos("lesson_state"))
        self.node.create_subscription(
            Interaction, "interaction", self.interactions.append, subscriber_qos("interaction")
        )
        self.node.create_subscription(
            DiagnosticArray, "/diagnostics", self._on_diagnostics, publisher_qos("diagnostics")
        )
        self._stop = self.node.create_client(Trigger, "stop")
        self._claim = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)

    def __enter__(self) -> SessionMonitor:
        """Use as a context manager: leaving it ends the node."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the node, and let the domain go."""
        self._claim.close()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown()

    def spin(self, duration: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Take messages for a while.

        Args:
            duration: Longest time [s].
            until: Ends it earlier when true.

        Returns:
            Whether `until` became true.
        """
        deadline = time.monotonic() + duration
        while time.monotonic() < deadline:
            if until():
                return True
            self._executor.spin_once(timeout_sec=0.05)
        return until()

    def session_is_running(self) -> bool:
        """Look for a session's nodes on this domain for a moment; if there are none, claim the domain until the end.

        The claim is a name that Linux gives back however this process ends: on a busy machine discovery may take
        longer than a moment, and two sessions must never drive one arm.
        """
        return not self._claims_domain() or self.spin(DISCOVERY_S, lambda: any(
            self.node.count_publishers(topic) for topic in ("joint_command", "lesson_state", "joint_states")))

    def _claims_domain(self) -> bool:
        try:
            self._claim.bind(f"\0unifeed-session-domain-{self.node.context.get_domain_id()}")
        except OSError as error:
            return error.errno != errno.EADDRINUSE  # a system without such names
        return True

    def stop_arm(self) -> bool:
        """Call the controller's stop; true if it answered within a second."""
        if not self._stop.service_is_ready():
            return False
        future = self._stop.call_async(Trigger.Request())
        return self.spin(1.0, future.done)

    def value(self, node: str, key: str) -> str:
        """Give one value that a node publishes on /diagnostics; empty where there is none yet."""
        status = self.diagnostics.get(node)
        return next((pair.value for pair in status.values if pair.key == key), "") if status else ""

    def figure(self, node: str, key: str) -> float:
        """Give one figure that a node publishes on /diagnostics; nan where there is none yet."""
        return float(self.value(node, key) or "nan")

    def _on_lesson(self, msg: LessonState) -> None:
        self.lesson = msg

    def _on_diagnostics(self, msg: DiagnosticArray) -> None:
        for status in msg.status:
            self.diagnostics[status.name.removeprefix(DIAGNOSTICS_PREFIX)] = status
