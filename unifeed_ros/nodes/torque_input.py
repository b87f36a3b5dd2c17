"""External torque from whatever the arm's driver publishes: the one adapter that capture and shared_control share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped

from unifeed_ros.core.capture.external_torque import FIELD, MOMENTUM, WRENCH, ExternalTorqueConfig, make_converter
from unifeed_ros.core.capture.stuck import StuckTorque
from unifeed_ros.core.errors import ConfigError, UnifeedError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState
from unifeed_ros.nodes.conversions import seconds, wrench_from_msg
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.parameters import settings
from unifeed_ros.nodes.raw_input import import_type
from unifeed_ros.nodes.topics import subscriber_qos


class TorqueInput:
    """Listen to the source that the section "external_torque" of the parameters names, and hand on joint torques.

    Samples that cannot be used are refused with a sentence; those that come before the first joint state, or during the
    tare of a wrist sensor, are left out.

    Args:
        node: The node that listens.
        robot: The arm.
        deliver: Called with the stamp [s] and the external torque, shape (n,) [Nm].
        refuse: Called with what is wrong with a sample.
        depth: Samples kept until the node takes them; by default those of the table of topics.

    Raises:
        ConfigError: The section cannot be used, or the type of the message is not installed or lacks the field.
    """

    def __init__(self, node: UnifeedNode, robot: RobotModel, deliver: Callable[[float, Array], None],
                 refuse: Callable[[str], None], depth: int | None = None) -> None:
        self._config = config = settings(node, "external_torque", ExternalTorqueConfig)
        self._robot, self._deliver, self._refuse = robot, deliver, refuse
        self._convert, self._stuck = make_converter(robot, config), StuckTorque(robot)
        self._reader = JointReader(robot.joint_names)
        self._state: RobotState | None = None
        qos = subscriber_qos("external_torques", depth)
        if config.source == WRENCH:
            node.create_subscription(WrenchStamped, config.topic, self._on_wrench, qos)
        elif config.source == FIELD:
            kind = import_type(config.type)
            read_field(kind(), config.field)
            node.create_subscription(kind, config.topic, self._on_field, qos)
        else:
            kind = import_type("sensor_msgs/msg/JointState")
            heard = self._on_measured if config.source == MOMENTUM else self._on_torques
            node.create_subscription(kind, config.topic, heard, qos, raw=True)

    def observe_state(self, state: RobotState) -> None:
        """Take the newest joint state: a wrench belongs to a posture, and a message without a stamp to a time."""
        self._state = state

    def _on_torques(self, data: bytes) -> None:
        if self._state is not None:
            self._hand_on(lambda state: (state, *self._reader.torques(data, "external torques")))

    def _on_measured(self, data: bytes) -> None:
        def read(_: RobotState) -> tuple[RobotState, float, Array]:
            state, torque = self._reader.state_and_torques(data, "measured torques")
            return state, state.time, torque
        self._hand_on(read)

    def _on_wrench(self, msg: WrenchStamped) -> None:
        self._hand_on(lambda state: (state, stamp_of(msg, state.time), wrench_from_msg(msg.wrench)))

    def _on_field(self, msg: Any) -> None:
        self._hand_on(lambda state: (state, stamp_of(msg, state.time),
                                     np.asarray(read_field(msg, self._config.field), dtype=np.float64)))

    def _hand_on(self, read: Callable[[RobotState], tuple[RobotState, float, Array]]) -> None:
        if self._state is None:
            return
        try:
            state, time, values = read(self._state)
            torque = self._convert(RobotState(time=time, positions=state.positions, velocities=state.velocities),
                                   values)
            if torque is not None:
                self._stuck.check(time, torque)
        except UnifeedError as error:
            self._refuse(str(error))
            return
        if torque is not None:
            self._deliver(time, torque)


def stamp_of(msg: Any, otherwise: float) -> float:
    """Give the stamp of a message's header [s], or another time where there is none."""
    header = getattr(msg, "header", None)
    time = seconds(header.stamp) if header is not None else 0.0
    return time or otherwise


def read_field(msg: Any, path: str) -> Any:
    """Read a field of a message.

    Args:
        msg: The message.
        path: Names with dots between them.

    Raises:
        ConfigError: There is no such field.
    """
    value = msg
    for name in path.split("."):
        if not hasattr(value, "get_fields_and_field_types") or name not in value.get_fields_and_field_types():
            known = getattr(value, "get_fields_and_field_types", dict)()
            raise ConfigError(f"field {path} of {type(msg).__name__}", expected=", ".join(known) or "a field",
                              got=name)
        value = getattr(value, name)
    return value
