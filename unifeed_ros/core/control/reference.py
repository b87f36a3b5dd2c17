"""What the arm should do at each moment: a motion whose time and place bend to the person's hand."""

from __future__ import annotations

import math

import numpy as np

from unifeed_ros.core.control.sampled_motion import SampledMotion, Setpoint
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState

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
CATCH_UP_TIME = 1.0
"""Lost time that is made up for at a rate one higher, before limits [s]."""
HANDED_BACK = 0.5
"""Share of the robot above which the person has let go [1]."""
SHIFTED = 0.03
"""Distance of a joint from the motion beyond which the person has changed it, and another one may come [rad]."""


class Reference:
    """A motion, or a posture to hold, that gives way to the person and takes the arm back without a jump.

    Position = motion(s) + offset. While the robot leads, s runs with time, slower while the offset is large, and the
    offset returns to zero like a critically damped spring with limited speed and acceleration; with "continue" it
    returns to the offset that the person left, fading over what remains of the motion. While the person leads, the
    offset follows the arm, and s runs to the nearest point of what remains of the motion, never back ("follow"), or
    stands still ("wait", "retime"; after "retime" it runs faster until the lost time is made up for). All blend with
    the robot's share, so the position never jumps.

    With a patience, an arm that was pushed aside waits there for another motion, as long as the patience lasts, before
    it does any of that.

    Args:
        start: Setpoint to go on from without a jump; its speed fades within the limits.
        motion: Motion to carry out; None to hold where the arm is, or where the person leaves it.
        robot: The arm, for its limits.
        config: Settings.
        patience: How long the arm waits where it was pushed to [s].
    """

    def __init__(self, start: Setpoint, motion: SampledMotion | None, robot: RobotModel, config: ControlConfig,
                 patience: float = 0.0) -> None:
        self._motion = motion
        self._zero = np.zeros(robot.n)
        self._anchor = Setpoint(np.array(start.positions), self._zero, self._zero)
        self._fastest, self._sharpest = RETURN_PART * robot.velocity_limits, RETURN_PART * robot.acceleration_limits
        self._frequency = 6.0 / config.rejoin_time
        self._config = config
        self._fastest_rate = 1.0
        if motion is not None and config.during_contact == "retime":
            self._fastest_rate = motion.fastest_rate(robot.velocity_limits, robot.acceleration_limits)
        self._lost = 0.0
        self._patience, self._waits = patience, 0.0
        self.time = 0.0
        """Time within the motion [s]."""
        self._rate = 1.0
        self.offset = start.positions - (self._anchor if motion is None else motion.at(0.0)).positions
        """Distance of the reference from the motion, shape (n,) [rad]."""
        self._offset_velocity = np.array(start.velocities)
        self._left, self._left_at = np.array(self.offset), 0.0
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
        distance = max(map(abs, (self.offset - self._left_now()).tolist())) / WAITING_OFFSET
        made_up = min(self._fastest_rate - 1.0, self._lost / CATCH_UP_TIME)
        rate = authority * (1.0 + made_up) / (1.0 + distance * distance) if self._waits == 0.0 else 0.0
        if authority < 0.99 and self._config.during_contact == "follow":
            ahead = self._motion.nearest(positions, self.time) - self.time
            rate += (1.0 - authority) * min(FASTEST_RATE, SEARCH_GAIN * ahead)
        change = (rate - self._rate) / RATE_TIME
        self._rate += change * dt
        self.time = min(self._motion.duration, self.time + self._rate * dt)
        self._lost = max(0.0, self._lost + (1.0 - self._rate) * dt)
        return change

    def _left_now(self) -> Array:
        """Give what is left of the offset that the person left, by how much of the motion remains."""
        if self._motion is None or self._config.after_contact == "rejoin" or self.time >= self._motion.duration:
            return self._zero
        u = (self._motion.duration - self.time) / max(self._motion.duration - self._left_at, 1e-9)
        return self._left * (u * u * (3.0 - 2.0 * u))

    def _bend(self, gap: Array, authority: float, dt: float) -> Array:
        """Let the offset follow the arm as far as the person leads, and return as far as the robot does."""
        if authority < 1.0:
            self.offset += (gap - self.offset) * min(1.0, (1.0 - authority) * FOLLOW_GAIN * dt)
            self._left, self._left_at = self.offset.copy(), self.time
        if authority < HANDED_BACK:
            self._waits = self._patience if max(map(abs, self.offset.tolist())) > SHIFTED else 0.0
        self._waits = max(0.0, self._waits - dt)
        if dt == 0.0:
            return self._zero
        w, before = self._frequency, self._offset_velocity
        pull = -2.0 * w * before
        if self._motion is not None and self._waits == 0.0:
            pull -= authority * w * w * (self.offset - self._left_now())
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
