"""The last filter before the arm: whatever the layers above ask for, limits hold."""

from __future__ import annotations

import math

import numpy as np

from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState

LONGEST_TICK = 0.01
"""Longest time between ticks that torque may change over [s]."""
BEYOND_JOINT = 0.05
"""Way beyond a joint's limit in the URDF that stops the arm [rad]."""
LEAVING_JOINT = 0.02
"""Speed away from the limits, beyond them, that stops the arm [rad/s]."""
BEYOND_WORKSPACE = 0.02
"""Way beyond the workspace that stops the arm [m]."""
LEAVING = 0.02
"""Speed of the tool away from the workspace, outside it, that stops the arm [m/s]."""
TARGET_SPEED = 1.5
"""Largest speed of set-points, as a part of the joints' limits [1]."""


def all_finite(values: Array) -> bool:
    """Say whether all numbers of a short array are finite; faster than numpy's own way.

    Args:
        values: Numbers, shape (n,).

    Returns:
        True if none is NaN or infinite.
    """
    return all(map(math.isfinite, values.tolist()))


class SafetyFilter:
    """Limits on torques, set-points and their rates, and the checks that stop the arm.

    Args:
        robot: The arm.
        config: Settings.
    """

    def __init__(self, robot: RobotModel, config: ControlConfig) -> None:
        self._robot, self._config = robot, config
        self._limits = robot.torque_limits
        self._fastest = np.maximum(robot.pin_model.velocityLimit, robot.velocity_limits)
        margin = robot.config.position_margin
        self._lowest, self._highest = robot.lower - margin, robot.upper + margin
        box = np.array(config.workspace).reshape(-1, 3) if config.workspace else None
        self._corners = None if box is None else (box[0], box[1])
        self._last: Array | None = None
        self._last_target: Array | None = None
        self.jacobian = np.zeros((6, robot.n))
        """Jacobian of the tool at the last checked state, shape (6, n) [m/rad, rad/rad]."""

    def fault_of(self, state: RobotState) -> str | None:
        """Say what is wrong with a state, if anything.

        Args:
            state: Measured state.

        Returns:
            A clause for a person; None if nothing is wrong.
        """
        n = self._robot.n
        if state.positions.shape != (n,) or state.velocities.shape != (n,):
            return (f"joint state has {state.positions.size} positions and {state.velocities.size} velocities, "
                    f"not {n} each")
        if not self.readable(state):
            return "joint state is not finite"
        relative = (state.velocities / self._fastest).tolist()
        if max(relative) > 1.0 or min(relative) < -1.0:
            joint = int(np.abs(relative).argmax())
            return (f"{self._robot.joint_names[joint]} moves at {abs(state.velocities[joint]):.2f} rad/s, "
                    f"above the arm's limit of {self._fastest[joint]:.2f}")
        return self._joint_fault(state) or self._tool_fault(state)

    def _joint_fault(self, state: RobotState) -> str | None:
        """Say which joint leaves its limits, if any; one that comes back is let."""
        beyond = np.maximum(self._lowest - state.positions, state.positions - self._highest).tolist()
        if max(beyond) <= BEYOND_JOINT:
            return None
        joint = max(range(len(beyond)), key=beyond.__getitem__)
        up = state.positions[joint] > self._highest[joint]
        if (state.velocities[joint] if up else -state.velocities[joint]) < LEAVING_JOINT:
            return None
        return f"{self._robot.joint_names[joint]} is {beyond[joint]:.2f} rad beyond its limit and goes on"

    def _tool_fault(self, state: RobotState) -> str | None:
        """Say whether the tool is too fast, or leaves the workspace; one that comes back is let."""
        self.jacobian = self._robot.tool_jacobian(state.positions)
        velocity = self.jacobian[:3] @ state.velocities
        speed = math.sqrt(float(velocity @ velocity))
        if speed > self._config.tool_speed:
            return f"the tool moves at {speed:.2f} m/s, above the limit of {self._config.tool_speed:.2f}"
        if self._corners is None:
            return None
        place = self._robot.tool_pose(state.positions)[0]
        out = place - np.minimum(np.maximum(place, self._corners[0]), self._corners[1])
        depth = math.sqrt(float(out @ out))
        if depth > BEYOND_WORKSPACE and float(velocity @ out) > LEAVING * depth:
            return f"the tool is {depth:.2f} m outside the workspace and goes on"
        return None

    def force_fault(self, force: float) -> str | None:
        """Say whether the force at the tool is too large.

        Args:
            force: Estimated external force at the tool [N].
        """
        limit = self._config.tool_force
        return None if force <= limit else f"the force at the tool is {force:.0f} N, above the limit of {limit:.0f}"

    def readable(self, state: RobotState) -> bool:
        """Say whether a state has the right number of numbers, all finite, so that torques can be computed from it.

        Args:
            state: Measured state.
        """
        return (state.positions.shape == state.velocities.shape == (self._robot.n,) and all_finite(state.positions)
                and all_finite(state.velocities) and math.isfinite(state.time))

    @property
    def started(self) -> bool:
        """True once there is a last command that the next one must be close to."""
        return self._last is not None

    def start_from(self, torque: Array | None) -> None:
        """Take a torque as the last command: what the arm itself does before the first one; None: forget it."""
        self._last = None if torque is None else np.array(torque)
        self._last_target = None

    def limited(self, torque: Array, dt: float) -> Array:
        """Limit a torque and its change since the last one.

        Args:
            torque: Wanted torques, shape (n,) [Nm]; where not finite, the last command stays.
            dt: Time since the last command [s].

        Returns:
            Torques to send, shape (n,) [Nm].
        """
        last = self._last if self._last is not None else np.zeros(self._robot.n)
        if not all_finite(torque):
            torque = np.where(np.isfinite(torque), torque, last)
        step = self._config.torque_rate * min(max(dt, 0.0), LONGEST_TICK)
        torque = np.minimum(np.maximum(torque, last - step), last + step)
        self._last = np.minimum(np.maximum(torque, -self._limits), self._limits)
        return self._last

    def limited_target(self, positions: Array, measured: Array, dt: float) -> Array:
        """Limit the set-point of an arm that closes the loop itself, and its change since the last one.

        Args:
            positions: Wanted joint positions, shape (n,) [rad]; where not finite, the last ones stay.
            measured: Measured joint positions, where the first set-point begins, shape (n,) [rad].
            dt: Time since the last command [s].

        Returns:
            Joint positions to send, shape (n,) [rad].
        """
        last = measured if self._last_target is None else self._last_target
        if not all_finite(positions):
            positions = np.where(np.isfinite(positions), positions, last)
        step = self._robot.velocity_limits * (TARGET_SPEED * min(max(dt, 0.0), LONGEST_TICK))
        positions = np.minimum(np.maximum(positions, last - step), last + step)
        self._last_target = np.minimum(np.maximum(positions, self._lowest), self._highest)
        return self._last_target
