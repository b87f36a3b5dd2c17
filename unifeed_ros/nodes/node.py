"""What all nodes share: topics by name, robot and scene from parameters, a status on /diagnostics."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib import import_module
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.service import Service
from rclpy.subscription import Subscription

from unifeed_ros.core.robot import RobotConfig, RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.nodes.answers import answer_until_seen
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.topics import find_topic, publisher_qos, subscriber_qos

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR

DIAGNOSTICS_PREFIX = "unifeed: "
"""Each node's status on /diagnostics is named by this and its node name."""


class UnifeedNode(Node):
    """A node that finds its topics in the project's table and says once a second how it is."""

    def __init__(self, name: str, **options: Any) -> None:
        """Create the node and its 1 Hz status."""
        super().__init__(name, automatically_declare_parameters_from_overrides=True, **options)
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._status = DiagnosticStatus(level=OK, name=DIAGNOSTICS_PREFIX + name, message="starting")
        self._diagnostics = self.advertise("diagnostics")
        self._status_timer = self.create_timer(1.0, self._publish_status, clock=self.steady)

    def create_service(self, *arguments: Any, **options: Any) -> Service:
        """Create a service whose answers also reach clients that this process has not discovered yet."""
        service = super().create_service(*arguments, **options)
        send = service.send_response
        service.send_response = lambda response, header: answer_until_seen(self, partial(send, response, header))
        return service

    def advertise(self, topic: str) -> Publisher:
        """Create the publisher of a topic of the table."""
        return self.create_publisher(message_type(topic), find_topic(topic).name, publisher_qos(topic))

    def listen(self, topic: str, callback: Callable[[Any], None], *, raw: bool = False,
               depth: int | None = None) -> Subscription:
        """Create the subscription of a topic of the table; raw gives the callback the bytes that were sent.

        A node that must see every message asks for a depth that outlasts the longest time that it gets no processor.
        """
        return self.create_subscription(
            message_type(topic), find_topic(topic).name, callback, subscriber_qos(topic, depth), raw=raw)

    def load_robot(self) -> RobotModel:
        """Build the robot model from the section "robot" of the parameters."""
        return RobotModel(settings(self, "robot", RobotConfig))

    def load_scene(self) -> Scene:
        """Build the scene from the section "scene" of the parameters."""
        return settings(self, "scene", Scene)

    def say(self, level: bytes, message: str, **values: object) -> None:
        """Set the status that goes out on /diagnostics; a change of message is logged too."""
        if message != self._status.message:
            self._log(level, message)
        self._status.level, self._status.message = level, message
        if values:
            self._status.values = [KeyValue(key=key, value=str(value)) for key, value in values.items()]

    def _log(self, level: bytes, message: str) -> None:
        """Log; rclpy allows one severity a place in the code."""
        if level == ERROR:
            self.get_logger().error(message)
        elif level == WARN:
            self.get_logger().warning(message)
        else:
            self.get_logger().info(message)

    def refresh_status(self) -> None:
        """Update the status just before it goes out; nodes with figures override this."""

    def close(self) -> None:
        """Leave things safe before the node is destroyed; nodes that move or record override this."""

    def _publish_status(self) -> None:
        self.refresh_status()
        array = DiagnosticArray(status=[self._status])
        array.header.stamp = self.get_clock().now().to_msg()
        self._diagnostics.publish(array)


def message_type(topic: str) -> type:
    """Import the message class of a topic of the table."""
    package, kind, name = find_topic(topic).type.split("/")
    return getattr(import_module(f"{package}.{kind}"), name)
