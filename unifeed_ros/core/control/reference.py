"""What the arm should do at each moment: a motion whose time and place bend to the person's hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, Trajectory

GRID = 0.002
"""Spacing of the samples that a motion is kept in [s]."""
SEARCH_STRIDE = 5
"""Samples between candidates for the nearest point of a motion [1]."""
SEARCH_AHEAD = 0.6
"""Length of the piece of the motion, from the present time on, in which the nearest point is sought [s]."""
SEARCH_GAIN = 8.0
"""Rate at which motion time runs to the nearest point [1/s]."""
FASTEST_RATE = 2.0
"""Fastest rate of motion time while the person leads the arm along the motion [1]."""
RATE_TIME = 0.1
"""Time constant with which the rate of motion time changes [s]."""
FOLLOW_GAIN = 20.0
"""Rate at which the reference comes to the arm while the person leads [1/s]."""
RETURN_PART = 0.7
"""Largest speed and acceleration of the way back to the motion, as a part of the joints' limits [1]."""
WAITING_OFFSET = 0.3
"""Distance of a joint from the motion at which motion time runs at half its rate, to wait for the arm [rad]."""


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


class Reference:
    """A motion, or a posture to hold, that gives way to the person and takes the arm back without a jump.

    Position = motion(s) + offset. While the robot leads, s runs with time, slower while the offset is large, and the
    offset returns to zero like a critically damped spring with limited speed and acceleration. While the person leads,
    s runs to the nearest point of what remains of the motion, never back, and the offset follows the arm. Both blend
    with the robot's share, so the position never jumps.

    Args:
        start: Setpoint to go on from without a jump; its speed fades within the limits.
        motion: Motion to carry out; None to hold where the arm is, or where the person leaves it.
        robot: The arm, for its limits.
        config: Settings.
    """

    def __init__(self, start: Setpoint, motion: SampledMotion | None, robot: RobotModel, config: ControlConfig) -> None:
        self._motion = motion
        self._zero = np.zeros(robot.n)
        self._anchor = Setpoint(np.array(start.positions), self._zero, self._zero)
        self._fastest, self._sharpest = RETURN_PART * robot.velocity_limits, RETURN_PART * robot.acceleration_limits
        self._frequency = 6.0 / config.rejoin_time
        self.time = 0.0
        """Time within the motion [s]."""
        self._rate = 1.0
        self.offset = start.positions - (self._anchor if motion is None else motion.at(0.0)).positions
        """Distance of the reference from the motion, shape (n,) [rad]."""
        self._offset_velocity = np.array(start.velocities)
        self.setpoint = start
        """What the arm is to reach now."""

    @property
    def at_end(self) -> bool:
        """True once the motion's time has run out; never while holding."""
        return self._motion is not None and self.time >= self._motion.duration

    def step(self, positions: Array, authority: float, dt: float) -> Setpoint:
        """Advance by one tick.

        Args:
            positions: Measured joint positions, shape (n,) [rad].
            authority: Share of the robot, in [0, 1] [1].
            dt: Time since the last tick [s].

        Returns:
            What the arm is to reach now.
        """
        rate_change = self._advance(positions, authority, dt) if self._motion is not None else 0.0
        planned = self._anchor if self._motion is None else self._motion.at(self.time)
        acceleration = self._bend(positions - planned.positions, authority, dt)
        positions, velocities = planned.positions + self.offset, self._offset_velocity
        if self._motion is not None and self.time < self._motion.duration:
            velocities = velocities + self._rate * planned.velocities
            acceleration = acceleration + self._rate * self._rate * planned.accelerations
            acceleration += rate_change * planned.velocities
        self.setpoint = Setpoint(positions, velocities, acceleration)
        return self.setpoint

    def _advance(self, positions: Array, authority: float, dt: float) -> float:
        assert self._motion is not None
        distance = max(map(abs, self.offset.tolist())) / WAITING_OFFSET
        rate = authority / (1.0 + distance * distance)
        if authority < 0.99:
            ahead = self._motion.nearest(positions, self.time) - self.time
            rate += (1.0 - authority) * min(FASTEST_RATE, SEARCH_GAIN * ahead)
        change = (rate - self._rate) / RATE_TIME
        self._rate += change * dt
        self.time = min(self._motion.duration, self.time + self._rate * dt)
        return change

    def _bend(self, gap: Array, authority: float, dt: float) -> Array:
        """Let the offset follow the arm as far as the person leads, and return as far as the robot does."""
        if authority < 1.0:
            self.offset += (gap - self.offset) * min(1.0, (1.0 - authority) * FOLLOW_GAIN * dt)
        if dt == 0.0:
            return self._zero
        w, before = self._frequency, self._offset_velocity
        pull = -2.0 * w * before
        if self._motion is not None:
            pull -= authority * w * w * self.offset
        velocity = before + np.minimum(np.maximum(pull, -self._sharpest), self._sharpest) * dt
        self._offset_velocity = np.minimum(np.maximum(velocity, -self._fastest), self._fastest)
        self.offset += self._offset_velocity * dt
        return (self._offset_velocity - before) / dt


class Braking:
    """The reference of a stop: the arm's speed fades away, then it holds where it came to rest.

    Position and velocity follow v' = -v / stop_time; beyond stop_slack the reference is dragged along with the arm, so
    that it never pulls hard.

    Args:
        state: The arm when the stop came.
        robot: The arm, for its limits.
        config: Settings.
    """

    def __init__(self, state: RobotState, robot: RobotModel, config: ControlConfig) -> None:
        self._config = config
        self._positions = np.array(state.positions)
        self._velocities = np.minimum(np.maximum(state.velocities, -robot.velocity_limits), robot.velocity_limits)

    def step(self, positions: Array, dt: float) -> Setpoint:
        """Advance by one tick.

        Args:
            positions: Measured joint positions, shape (n,) [rad].
            dt: Time since the last tick [s].

        Returns:
            Where and how fast the arm should be.
        """
        slack, time = self._config.stop_slack, self._config.stop_time
        kept = math.exp(-dt / time)
        ahead = self._positions + self._velocities * (time * (1.0 - kept))
        self._velocities = self._velocities * kept
        self._positions = np.minimum(np.maximum(ahead, positions - slack), positions + slack)
        return Setpoint(self._positions, self._velocities, self._velocities * (-1.0 / time))


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
