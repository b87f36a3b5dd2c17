"""The tool's state and the arm's heights for many postures at once, with derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array


class ArmGeometry(NamedTuple):
    """Where the tool and the arm's points are, for N postures of n joints."""

    states: Array
    """Tool states, shape (N, 6) [m, 1]."""
    state_jacobians: Array
    """Their derivatives, shape (N, 6, n) [m/rad, 1/rad]."""
    heights: Array
    """Heights of the P points, the tool last, shape (N, P) [m]."""
    height_jacobians: Array
    """Their derivatives, shape (N, P, n) [m/rad]."""


class ArmPoints:
    """The points of an arm that must stay above the table: moving joints' centres and the tool.

    Attributes:
        names: Names of the P points, the tool last.
    """

    def __init__(self, robot: RobotModel) -> None:
        """Choose the points: each joint after the second whose centre differs from the one before."""
        self._model, self._data = robot.pin_model, robot.pin_model.createData()
        frame = robot.pin_model.frames[robot.pin_model.getFrameId(robot.config.tool_frame)]
        self._tool_joint, self._tool_in_joint = frame.parentJoint, frame.placement
        offsets = [float(np.linalg.norm(placement.translation)) for placement in robot.pin_model.jointPlacements]
        self._joints = [i for i in range(3, robot.n + 1) if offsets[i] > 1e-6]
        self.names = (*(robot.joint_names[i - 1] for i in self._joints), robot.config.tool_frame)
        owner = np.array([*self._joints, self._tool_joint])
        self._moved_by = owner[:, None] >= np.arange(1, robot.n + 1)  # (P, n): joints between base and point

    def evaluate(self, postures: Array) -> ArmGeometry:
        """Compute tool states, heights and derivatives.

        Args:
            postures: Joint positions, shape (N, n) [rad].
        """
        count, n = postures.shape
        jacobians = np.empty((count, 6, n))
        points, axis = np.empty((count, len(self.names), 3)), np.empty((count, 3))
        for k, posture in enumerate(postures):
            jacobians[k] = pin.computeJointJacobians(self._model, self._data, posture)
            for p, joint in enumerate(self._joints):
                points[k, p] = self._data.oMi[joint].translation
            tool = self._data.oMi[self._tool_joint] * self._tool_in_joint
            points[k, -1], axis[k] = tool.translation, tool.rotation[:, 2]
        linear, angular = jacobians[:, :3], jacobians[:, 3:]  # of the body point at the base's origin
        states = np.concatenate([points[:, -1], axis], axis=1)
        state_jacobians = np.concatenate([linear + _cross(angular, points[:, -1]), _cross(angular, axis)], axis=1)
        vertical = (linear[:, None, 2] + angular[:, None, 0] * points[:, :, 1, None]
                    - angular[:, None, 1] * points[:, :, 0, None])  # z of v + omega x p
        return ArmGeometry(states, state_jacobians, points[:, :, 2], vertical * self._moved_by)


def _cross(rates: Array, vectors: Array) -> Array:
    """Multiply angular rates, shape (N, 3, n), with vectors, shape (N, 3): omega x vector, shape (N, 3, n)."""
    x, y, z = vectors[:, 0, None], vectors[:, 1, None], vectors[:, 2, None]
    a, b, c = rates[:, 0], rates[:, 1], rates[:, 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=1)
