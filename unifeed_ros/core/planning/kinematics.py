"""Where the arm is for many postures at once: joints' frames, the tool, and derivatives, without a loop over them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array


@dataclass(frozen=True)
class ArmPose:
    """Frames of an arm of n joints at N postures, base frame; derivatives are computed where they are asked for."""

    rotations: Array
    """Orientation of the base and of each joint's body, shape (n + 1, N, 3, 3)."""
    origins: Array
    """Their origins, shape (n + 1, N, 3) [m]."""
    axes: Array
    """Axes that the joints turn about, shape (N, n, 3)."""
    tool: Array
    """Tool position, shape (N, 3) [m]."""
    tool_axis: Array
    """Direction of the tool's z axis, shape (N, 3)."""
    tool_body: int
    """Joint that moves the tool."""

    @cached_property
    def tool_jacobian(self) -> Array:
        """Derivative of the tool's position, shape (N, 3, n) [m/rad]."""
        return self._turned(self.tool[:, None] - self.origins[1:].transpose(1, 0, 2))

    @cached_property
    def axis_jacobian(self) -> Array:
        """Derivative of its z axis, shape (N, 3, n) [1/rad]."""
        return self._turned(self.tool_axis[:, None])

    @property
    def states(self) -> Array:
        """Tool states, shape (N, 6) [m, 1]."""
        return np.concatenate([self.tool, self.tool_axis], axis=1)

    @property
    def state_jacobians(self) -> Array:
        """Derivatives of the tool states, shape (N, 6, n) [m/rad, 1/rad]."""
        return np.concatenate([self.tool_jacobian, self.axis_jacobian], axis=1)

    def _turned(self, arms: Array) -> Array:
        """Multiply the joints' axes by arms, shape (N, n or 1, 3), for the joints that move the tool."""
        turned = cross_products(self.axes, arms).transpose(0, 2, 1)
        turned[:, :, self.tool_body:] = 0.0
        return turned

    @cached_property
    def _moments(self) -> Array:
        """Moments of the joints' axes about the base, shape (N, n, 3) [m]."""
        return cross_products(self.origins[1:].transpose(1, 0, 2), self.axes)

    def moved(self, samples: NDArray[np.intp], points: Array, directions: Array) -> Array:
        """Compute how fast points move along directions as the joints turn that move them, d (a x (p - o)).

        Args:
            samples: Postures that the points belong to, K indices.
            points: Positions, shape (K, 3) [m].
            directions: Shape (K, 3).

        Returns:
            Derivatives by each of the joints, as if all moved the point, shape (K, n) [m/rad].
        """
        turning, moving = cross_products(points, directions)[:, :, None], directions[:, :, None]
        return np.asarray((self.axes[samples] @ turning + self._moments[samples] @ moving)[:, :, 0])


class Kinematics:
    """A chain of revolute joints, as pinocchio's model describes it."""

    def __init__(self, robot: RobotModel) -> None:
        """Take the constant parts out of pinocchio's model.

        Raises:
            ConfigError: A joint that does not turn, or a branch.
        """
        model = robot.pin_model
        if [int(p) for p in model.parents[1:]] != list(range(robot.n)):
            raise ConfigError("joints of the arm", expected="one chain", got=list(model.parents))
        axes, placements = [], []
        for k in range(1, robot.n + 1):
            subspace = np.array(model.joints[k].createData().S).reshape(6, -1)
            if subspace.shape[1] != 1 or np.abs(subspace[:3]).max() > 0:
                raise ConfigError(f"joint {model.names[k]}", expected="revolute", got=model.joints[k].shortname())
            axes.append(subspace[3:, 0])
            placements.append(model.jointPlacements[k])
        first = np.array([place.rotation for place in placements])[:, None]  # (n, 1, 3, 3)
        cross = np.array([pin.skew(axis) for axis in axes])[:, None]
        self._turns = first, first @ cross, first @ cross @ cross  # Rodrigues: of 1, of sin q and of 1 - cos q
        self._offsets = np.array([place.translation for place in placements])[:, None, :, None]
        self._axes = np.array(axes)[:, None, :, None]
        frame = model.frames[model.getFrameId(robot.config.tool_frame)]
        self.tool_body = int(frame.parentJoint)
        self._tool = frame.placement
        self.joints = robot.n

    def evaluate(self, postures: Array) -> ArmPose:
        """Compute all frames and the tool's derivatives.

        Args:
            postures: Joint positions, shape (N, n) [rad].
        """
        count, n = postures.shape
        first, by_sine, by_cosine = self._turns
        angles = postures.T[:, :, None, None]
        local = first + np.sin(angles) * by_sine + (1.0 - np.cos(angles)) * by_cosine
        rotations, origins = np.empty((n + 1, count, 3, 3)), np.zeros((n + 1, count, 3))
        rotations[0] = np.eye(3)
        for k in range(n):
            np.matmul(rotations[k], local[k], out=rotations[k + 1])
        np.cumsum((rotations[:-1] @ self._offsets)[..., 0], axis=0, out=origins[1:])
        axes = np.ascontiguousarray((rotations[1:] @ self._axes)[..., 0].transpose(1, 0, 2))
        turn = rotations[self.tool_body]
        return ArmPose(rotations, origins, axes, turn @ self._tool.translation + origins[self.tool_body],
                       turn @ self._tool.rotation[:, 2], self.tool_body)


def cross_products(one: Array, two: Array) -> Array:
    """Multiply vectors, shape (..., 3); np.cross takes several times as long."""
    a, b, c = one[..., 0], one[..., 1], one[..., 2]
    x, y, z = two[..., 0], two[..., 1], two[..., 2]
    return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=-1)
