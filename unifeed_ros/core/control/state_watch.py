"""Joint states beside the ones before: what jumps or freezes is not what an arm does."""

from __future__ import annotations

import numpy as np

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import RobotState

JUMP = 0.05
"""Way beyond what the speed limits allow that counts as a jump of the sensor [rad]."""
TRUSTED_S = 0.05
"""Time for which the speed limits are allowed for when states after a jump are compared with the last one before it:
what is farther away is still wrong, however long ago that was [s]."""
FROZEN_S = 0.03
"""Time in which the states of a driven arm must change: a spring that pulls at an arm it does not see throws it, and a
joint at the speed below moves by many times what encoders resolve [s]."""
MOVING = 0.05
"""Speed of the reference at which an arm that does not move at all is taken for a frozen driver [rad/s]."""


class StateWatch:
    """Notice joint states that jump, and those that repeat to the last bit while the arm is driven.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._names = robot.joint_names
        self._fastest = 2.0 * np.maximum(robot.pin_model.velocityLimit, robot.velocity_limits)
        self._last: RobotState | None = None
        self._unchanged = 0.0
        self.doubted = False
        """True from a jump on until states are near the last one before it again, or one is accepted."""
        self.frozen = False
        """True from when states have repeated for too long until one is different, or one is accepted."""

    def accept(self, state: RobotState) -> None:
        """Take a state as true, whatever came before: somebody looked at the arm.

        Args:
            state: Measured state.
        """
        self._last, self._unchanged, self.doubted, self.frozen = state, 0.0, False, False

    def fault_of(self, state: RobotState, wanted_speed: float) -> str | None:
        """Take in one state.

        Args:
            state: Measured state, finite and of the right length.
            wanted_speed: Speed of the fastest joint of the reference [rad/s].

        Returns:
            What is wrong, as a clause for a person; None if nothing is.
        """
        last = self._last
        if last is None or state.time <= last.time:
            self._last = last if self.doubted else state
            return None
        dt = state.time - last.time
        moved = state.positions - last.positions
        beyond = np.abs(moved) - self._fastest * (min(dt, TRUSTED_S) if self.doubted else dt)
        self.doubted = max(beyond.tolist()) > JUMP
        if self.doubted:
            joint = int(beyond.argmax())
            return f"the position of {self._names[joint]} jumped by {moved[joint]:.2f} rad in {1e3 * dt:.0f} ms"
        self._last = state
        same = not moved.any() and np.array_equal(state.velocities, last.velocities)
        self._unchanged = self._unchanged + dt if same and wanted_speed > MOVING else 0.0
        self.frozen = same and (self.frozen or self._unchanged > FROZEN_S)
        if self._unchanged > FROZEN_S:
            return f"the joint states have not changed for {self._unchanged:.2f} s although the arm is driven"
        return None
