"""A trajectory as the controller carries it out: sampled finely, with velocities and accelerations, and checked."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Trajectory

GRID = 0.002
"""Spacing of the samples that a motion is kept in [s]."""
SEARCH_STRIDE = 5
"""Samples between candidates for the nearest point of a motion [1]."""
SEARCH_AHEAD = 0.6
"""Length of the piece of the motion, from the present time on, in which the nearest point is sought [s]."""
CHECKED_POINTS = 50
"""Points of a motion at which the tool is checked [1]."""


class Setpoint(NamedTuple):
    """What the impedance law is to reach at one moment."""

    positions: Array
    """Joint positions, shape (n,) [rad]."""
    velocities: Array
    """Joint velocities, shape (n,) [rad/s]."""
    accelerations: Array
    """Joint accelerations, shape (n,) [rad/s^2]."""


class SampledMotion:
    """A trajectory on a fine and even grid, with velocities and accelerations, starting at time zero.

    Between the points of the trajectory: cubic Hermite positions. Velocities that the trajectory lacks come from
    differences, zero at both ends; accelerations that it lacks come from differences of the velocities.

    Args:
        trajectory: Joint positions over time.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        times = trajectory.times - trajectory.times[0]
        velocities, accelerations = trajectory.velocities, trajectory.accelerations
        if velocities is None:
            velocities = np.gradient(trajectory.positions, times, axis=0)
            velocities[[0, -1]] = 0.0
        if accelerations is None:
            accelerations = np.gradient(velocities, times, axis=0)
        self.duration = trajectory.duration
        """Duration of the motion [s]."""
        self.n = len(trajectory.joint_names)
        """Number of joints."""
        count = max(2, int(np.ceil(self.duration / GRID)) + 1)
        grid = np.linspace(0.0, self.duration, count)
        self._spacing = self.duration / (count - 1)
        positions, slopes = _hermite(times, trajectory.positions, velocities, grid)
        curvatures = np.stack([np.interp(grid, times, column) for column in accelerations.T], axis=-1)
        self._rows = np.hstack([positions, slopes, curvatures])
        self._candidates = np.ascontiguousarray(positions[::SEARCH_STRIDE])
        self._stride = self._spacing * SEARCH_STRIDE

    def at(self, time: float) -> Setpoint:
        """Sample the motion, holding its ends.

        Args:
            time: Time within the motion [s].
        """
        n, place = self.n, min(max(time, 0.0), self.duration) / self._spacing
        index = min(int(place), len(self._rows) - 2)
        first, second = self._rows[index:index + 2]
        row = first + (place - index) * (second - first)
        return Setpoint(row[:n], row[n:2 * n], row[2 * n:])

    def fastest_rate(self, velocity_limits: Array, acceleration_limits: Array) -> float:
        """Compute how much faster the motion may run within the limits, at most half as fast again.

        Args:
            velocity_limits: Largest joint speeds, shape (n,) [rad/s].
            acceleration_limits: Largest joint accelerations, shape (n,) [rad/s^2].

        Returns:
            Rate of motion time, in [1, 1.5] [1].
        """
        largest = np.abs(self._rows[:, self.n:]).max(axis=0) + 1e-9
        speed = (velocity_limits / largest[:self.n]).min()
        sharpness = np.sqrt((acceleration_limits / largest[self.n:]).min())
        return float(min(1.5, max(1.0, min(speed, sharpness))))

    def nearest(self, positions: Array, time: float) -> float:
        """Find the nearest point of what remains of the motion, not far ahead.

        Args:
            positions: Joint positions, shape (n,) [rad].
            time: Present time within the motion [s].

        Returns:
            Time within the motion, not before the present one [s].
        """
        first = int(time / self._stride)
        window = self._candidates[first:first + int(SEARCH_AHEAD / self._stride) + 1]
        if len(window) == 0:
            return time
        gaps = window - positions
        best = int(np.einsum("ij,ij->i", gaps, gaps).argmin())
        return max(time, (first + best) * self._stride)


def _hermite(times: Array, positions: Array, velocities: Array, grid: Array) -> tuple[Array, Array]:
    index = np.clip(np.searchsorted(times, grid, side="right") - 1, 0, len(times) - 2)
    h = (times[index + 1] - times[index])[:, None]
    u = (grid - times[index])[:, None] / h
    p0, p1, m0, m1 = positions[index], positions[index + 1], velocities[index] * h, velocities[index + 1] * h
    c2, c3 = 3.0 * (p1 - p0) - 2.0 * m0 - m1, 2.0 * (p0 - p1) + m0 + m1
    return p0 + u * (m0 + u * (c2 + u * c3)), (m0 + u * (2.0 * c2 + 3.0 * u * c3)) / h


def require_motion(trajectory: Trajectory, joint_names: Sequence[str], lower: Array, upper: Array,
                   velocity_limits: Array) -> None:
    """Check that a motion is of this arm and within its limits.

    Args:
        trajectory: Motion to check.
        joint_names: Names of the arm's joints, in order.
        lower: Lowest joint positions, shape (n,) [rad].
        upper: Highest joint positions, shape (n,) [rad].
        velocity_limits: Largest joint speeds, shape (n,) [rad/s].

    Raises:
        InputError: Other joints, or a point beyond the limits.
    """
    if trajectory.joint_names != tuple(joint_names):
        raise InputError("joints of the motion", expected=", ".join(joint_names), got=", ".join(trajectory.joint_names))
    beyond = np.maximum(lower - trajectory.positions, trajectory.positions - upper).max(axis=0)
    if beyond.max() > 1e-3:
        joint = int(beyond.argmax())
        raise InputError(f"motion leaves the limits of {joint_names[joint]}", got=f"{beyond[joint]:.3f} rad beyond",
                         expected=f"{lower[joint]:.3f} to {upper[joint]:.3f} rad", mend="plan it again")
    speeds = np.abs(np.diff(trajectory.positions, axis=0) / np.diff(trajectory.times)[:, None]).max(axis=0)
    excess = speeds / velocity_limits
    if excess.max() > 1.05:
        joint = int(excess.argmax())
        raise InputError(f"motion is too fast for {joint_names[joint]}", got=f"{speeds[joint]:.2f} rad/s",
                         expected=f"at most {velocity_limits[joint]:.2f} rad/s", mend="give it more time")


def require_tool(robot: RobotModel, trajectory: Trajectory, config: ControlConfig) -> None:
    """Check that a motion keeps the tool in the workspace and below its largest speed, at some points of it.

    Args:
        robot: The arm.
        trajectory: Motion to check.
        config: Settings.

    Raises:
        InputError: The tool leaves the workspace, or is too fast.
    """
    times = np.linspace(trajectory.times[0], trajectory.times[-1], CHECKED_POINTS)
    places = robot.tool_states(trajectory.positions_at(times))[:, :3]
    speed = float(np.linalg.norm(np.diff(places, axis=0), axis=1).max() / (times[1] - times[0]))
    if speed > config.tool_speed:
        raise InputError("motion is too fast for the tool", expected=f"at most {config.tool_speed:.2f} m/s",
                         got=f"{speed:.2f} m/s", mend="give it more time")
    if config.workspace:
        low, high = np.array(config.workspace).reshape(2, 3)
        depth = float(np.maximum(low - places, places - high).max())
        if depth > 1e-3:
            raise InputError("motion leaves the workspace", got=f"{depth:.3f} m outside", mend="plan it again")
