"""Commands as the robot's driver takes them: torques, set-points with stiffness, or points of a trajectory."""

from __future__ import annotations

from array import array

from builtin_interfaces.msg import Duration
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from unifeed_ros.core.control.command import Command
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.nodes.conversions import NANOSECONDS, header
from unifeed_ros.nodes.joint_stream import JointWriter
from unifeed_ros.nodes.node import UnifeedNode

TOPIC_OF = {"effort": "joint_command", "setpoint": "joint_setpoint", "trajectory": "joint_trajectory"}
"""Topic of each kind of output."""


class CommandOutput:
    """Publishes commands of one kind, and looks for others who do.

    Args:
        node: Whose publisher it is.
        robot: The arm.
        kind: "effort", "setpoint" or "trajectory".
        period: Time between two commands [s].
    """

    def __init__(self, node: UnifeedNode, robot: RobotModel, kind: str, period: float) -> None:
        self._node, self._kind = node, kind
        self.topic = TOPIC_OF[kind]
        """Name of the topic that commands go out on."""
        publishers = {name: node.advertise(name) for name in TOPIC_OF.values()}
        self._publisher = publishers[self.topic]
        self._names = list(robot.joint_names)
        fields = ("effort",) if kind == "effort" else ("position", "velocity", "effort")
        self._writer = JointWriter(self._names, fields)
        self._ahead = Duration(nanosec=round(period * NANOSECONDS))

    def send(self, time: float, command: Command) -> bool:
        """Publish a command.

        Args:
            time: Stamp of the joint state that it answers [s].
            command: The command.

        Returns:
            False if there was nothing to send.
        """
        if command.torque is None or (command.setpoint is None and self._kind != "effort"):
            return False
        if self._kind == "effort":
            self._publisher.publish(self._writer.write(time, command.torque))
            return True
        assert command.setpoint is not None and command.stiffness is not None
        positions, velocities = command.setpoint.positions, command.setpoint.velocities
        if self._kind == "setpoint":
            self._publisher.publish(self._writer.write(time, positions, velocities, command.stiffness))
            return True
        point = JointTrajectoryPoint(positions=array("d", positions.tobytes()), time_from_start=self._ahead,
                                     velocities=array("d", velocities.tobytes()))
        self._publisher.publish(JointTrajectory(header=header(time), joint_names=self._names, points=[point]))
        return True

    def rivals(self) -> int:
        """Count the other publishers on the topic."""
        return self._node.count_publishers(self._publisher.topic_name) - 1
