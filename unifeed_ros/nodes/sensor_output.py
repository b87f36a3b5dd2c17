"""What the simulated arm's driver says of touch: in the form that the section "external_torque" expects."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from unifeed_ros.core.capture.external_torque import FIELD, JOINT_STATE, WRENCH, ExternalTorqueConfig
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.nodes.conversions import header, wrench_to_msg
from unifeed_ros.nodes.joint_stream import JointWriter
from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.raw_input import import_type
from unifeed_ros.nodes.topics import publisher_qos
from unifeed_ros.nodes.torque_input import read_field
from unifeed_ros.simulation.arm import SimulatedArm


def make_sensor_output(node: UnifeedNode, arm: SimulatedArm, config: ExternalTorqueConfig) -> Callable[[], None]:
    """Build what publishes the arm's sense of touch once; nothing where joint states carry it.

    Args:
        node: The node that publishes.
        arm: The arm.
        config: The source that the other nodes listen to.

    Returns:
        A function to call after each step.

    Raises:
        ConfigError: The source wants what this arm has not.
    """
    robot, qos = arm.robot, publisher_qos("external_torques")
    if config.source == WRENCH:
        if config.frame not in ("", robot.config.tool_frame):
            raise ConfigError("frame of the simulated wrist sensor", expected=robot.config.tool_frame, got=config.frame)
        wrenches = node.create_publisher(import_type("geometry_msgs/msg/WrenchStamped"), config.topic, qos)
        return lambda: wrenches.publish(
            wrench_to_msg(config.sign * arm.wrist_wrench(), arm.time, robot.config.tool_frame))
    if config.source == FIELD:
        return _field_output(node, arm, config)
    if config.source == JOINT_STATE:
        writer = JointWriter(robot.joint_names, ("effort",))
        torques = node.create_publisher(import_type("sensor_msgs/msg/JointState"), config.topic, qos)
        return lambda: torques.publish(writer.write(arm.time, config.sign * arm.external_torque()))
    return lambda: None


def _field_output(node: UnifeedNode, arm: SimulatedArm, config: ExternalTorqueConfig) -> Callable[[], None]:
    kind = import_type(config.type)
    read_field(kind(), config.field)
    publisher = node.create_publisher(kind, config.topic, publisher_qos("external_torques"))
    *way, last = config.field.split(".")

    def publish() -> None:
        msg = kind()
        if hasattr(msg, "header"):
            msg.header = header(arm.time)
        inner = msg
        for name in way:
            inner = getattr(inner, name)
        setattr(inner, last, np.asarray(config.sign * arm.external_torque()).tolist())
        publisher.publish(msg)

    return publish
