"""The last filter before the arm: whatever the layers above ask for, limits hold."""

from __future__ import annotations

import math

import numpy as np

from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState

LONGEST_TICK = 0.01
"""Longest time between ticks that torque may change over [s]."""


def all_finite(values: Array) -> bool:
    """Say whether all numbers of a short array are finite; faster than numpy's own way.

    Args:
        values: Numbers, shape (n,).

    Returns:
        True if none is NaN or infinite.
    """
    return all(map(math.isfinite, values.tolist()))


class SafetyFilter:
    """Limits on torque and its rate, and the checks that stop the arm.

    Args:
        robot: The arm.
        config: Settings.
    """

    def __init__(self, robot: RobotModel, config: ControlConfig) -> None:
        self._robot, self._config = robot, config
        self._limits = robot.torque_limits
        self._fastest = np.maximum(robot.pin_model.velocityLimit, robot.velocity_limits)
        self._last: Array | None = None

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
        return None

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
