"""Where a motion may end: a posture, a pose, a position, or wherever the reward leads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.errors import UnreachableError
from unifeed_ros.core.planning.constraints import Constraint
from unifeed_ros.core.planning.tool_limits import end_constraint
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, frozen_array

_TILTS = 0.8
"""Size of the tilts that are tried to reach a position whose direction is free [1]."""


@dataclass(frozen=True, kw_only=True)
class ToolGoal:
    """A place for the tool to end at; the posture is free."""

    position: Array
    """Tool position in the base frame, shape (3,) [m]."""
    axis: Array | None = None
    """Direction of the tool's z axis, shape (3,), made a unit vector; None: any."""

    def __post_init__(self) -> None:
        """Check shapes."""
        object.__setattr__(self, "position", frozen_array("position of the goal", self.position, (3,)))
        if self.axis is not None:
            axis = frozen_array("axis of the goal", self.axis, (3,))
            object.__setattr__(self, "axis", frozen_array("axis of the goal", axis / np.linalg.norm(axis), (3,)))

    def constraint(self, tolerance: float) -> Constraint:
        """Return the constraint on the last way-point.

        Args:
            tolerance: Largest distance by coordinate [m, 1].
        """
        return end_constraint(self.position, self.axis, tolerance)

    def guess(self, robot: RobotModel, start: Array) -> Array:
        """Find one posture that reaches it, near the start, shape (n,) [rad].

        Args:
            robot: The arm.
            start: Posture at the start, shape (n,) [rad].

        Raises:
            UnreachableError: No posture was found.
        """
        if self.axis is not None:
            return robot.inverse_kinematics(self.position, self.axis, seed=start)
        present = robot.tool_pose(start)[1][:, 2]
        for tilt in (np.zeros(3), *(sign * _TILTS * row for row in np.eye(3) for sign in (1, -1))):
            try:
                return robot.inverse_kinematics(self.position, present + tilt, seed=start)
            except UnreachableError as error:
                last = error
        raise last
