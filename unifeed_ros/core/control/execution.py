"""What became of a motion: the way the arm really took, and how far that was from the plan."""

from __future__ import annotations

import numpy as np

from unifeed_ros.core.modes import Control
from unifeed_ros.core.types import Array, RobotState, Trajectory

SAMPLE_PERIOD = 0.01
"""Time between two samples of the executed motion [s]."""


class ExecutionRecord:
    """Collect samples of one motion while it is carried out.

    The record ends when the time within the motion reaches its duration; what the arm does while it settles at the end
    does not belong to the motion.

    Args:
        planned: The motion.
        began: Stamp of its start [s].
    """

    def __init__(self, planned: Trajectory, began: float) -> None:
        self._planned, self._began = planned, began
        self._times: list[float] = []
        self._positions: list[Array] = []
        self._squares, self._free = 0.0, 0
        self._over = False
        self.touched = False
        """True if a person led at any moment."""

    def observe(self, state: RobotState, motion_time: float, control: Control) -> None:
        """Take one sample; those that come faster than every 10 ms are left out.

        Args:
            state: Measured state.
            motion_time: Time within the motion [s].
            control: Who leads.
        """
        self.touched = self.touched or control is Control.PERSON
        time = state.time - self._began
        last = self._times[-1] if self._times else -np.inf
        if self._over or time - last < SAMPLE_PERIOD - 1e-6:
            return
        self._over = motion_time >= self._planned.duration
        self._times.append(time)
        self._positions.append(np.array(state.positions))
        if not self.touched:
            error = state.positions - self._planned.positions_at([motion_time])[0]
            self._squares += float(error @ error) / len(error)
            self._free += 1

    def executed(self) -> Trajectory | None:
        """Give the motion as the arm carried it out; None before there are two samples."""
        if len(self._times) < 2:
            return None
        return Trajectory(joint_names=self._planned.joint_names, times=np.array(self._times) - self._times[0],
                          positions=np.stack(self._positions))

    def tracking_rms(self) -> float:
        """Compute the root mean square over time and joints of the distance from the plan before any touch [rad]."""
        return float(np.sqrt(self._squares / self._free)) if self._free else 0.0
