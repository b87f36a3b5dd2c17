"""A hand that a mouse moves: takes the place of a person at a simulated arm."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array
from unifeed_ros.simulation.hand import Hand, HandConfig

CLOSING_S = 0.25
"""Time in which the hand closes around the tool: a pull that begins at once would feel like a collision [s]."""
LARGEST_GAP = 0.05
"""Time between two looks at the arm beyond which the speed is not worked out [s]."""
MOUSE_HAND = HandConfig(largest_force=20.0, damping=50.0, turning_stiffness=8.0, turning_damping=0.4, turning_push=0.0,
                        largest_torque=1.5)
"""How the mouse holds the tool: gentler than a person, since it feels the arm only a hundred times a second; a wrist
that is turned hard on such late news swings until the controller stops it."""


class MouseHand:
    """Pulls the tool towards a place like a spring, and keeps its direction as it was gripped.

    Speeds are worked out from postures, since the page gets no others.

    Args:
        robot: The arm.
        config: How the hand holds the tool.
    """

    def __init__(self, robot: RobotModel, config: HandConfig | None = None) -> None:
        self._robot, self._hand = robot, Hand(robot, config or MOUSE_HAND)
        self._last: tuple[float, Array] | None = None
        self._gripped: float | None = None
        self._axis = np.array([0.0, 0.0, -1.0])

    def let_go(self) -> None:
        """Open the hand."""
        self._gripped = self._last = None

    def wrench(self, time: float, q: ArrayLike, target: ArrayLike) -> Array:
        """Compute force and torque on the tool.

        Args:
            time: Time of the posture [s].
            q: Joint positions, shape (n,) [rad].
            target: Where the tool is wanted, shape (3,) [m].

        Returns:
            Wrench at the tool, axes of the base frame, shape (6,) [N, Nm].
        """
        q = np.asarray(q, dtype=np.float64)
        if self._gripped is None or time < self._gripped:
            self._gripped, self._axis = time, self._robot.tool_pose(q)[1][:, 2]
            self._hand.take()
        v = np.zeros_like(q)
        if self._last is not None and 0.0 < time - self._last[0] < LARGEST_GAP:
            v = (q - self._last[1]) / (time - self._last[0])
        self._last = (time, q)
        grip = min((time - self._gripped) / CLOSING_S, 1.0)
        return self._hand.wrench(time, q, v, np.asarray(target, dtype=np.float64), self._axis, np.zeros(3), grip)
