"""Who leads: the robot's share of the command falls as a person pushes and comes back when they let go."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.types import Array, frozen_array


def share_of_level(level: float, config: ControlConfig) -> float:
    """Compute the share that the robot keeps at a level of touch.

    A smooth step down: 1 - u^2 (3 - 2 u) with u = (level - yield_start) / (yield_full - yield_start), held in [0, 1].

    Args:
        level: Largest external torque over the joints, each divided by its threshold [1].
        config: Settings.

    Returns:
        Share in [0, 1], never rising with the level [1].
    """
    u = (level - config.yield_start) / (config.yield_full - config.yield_start)
    u = min(1.0, max(0.0, u))
    return 1.0 - u * u * (3.0 - 2.0 * u)


class Arbitration:
    """The robot's share over time: falls fast, rises slowly, and stays low under a light hand once it has fallen.

    Args:
        thresholds: External torque that counts as a touch, shape (n,) [Nm].
        config: Settings.
    """

    def __init__(self, thresholds: Sequence[float], config: ControlConfig) -> None:
        self._config = config
        self._inverse = 1.0 / np.maximum(frozen_array("contact thresholds", thresholds, (None,)), 1e-6)
        self._filtered = np.zeros(len(self._inverse))
        self.authority = 1.0
        """Share of the robot, in [0, 1] [1]."""
        self.person_leads = False
        """True from the moment that a touch takes the share below one half until it is back above 0.9."""
        self.level = 0.0
        """Largest filtered external torque over the joints, each divided by its threshold [1]."""

    def reset(self, authority: float) -> None:
        """Set the share; the person's touch is judged anew from there."""
        self.authority, self.person_leads = authority, False

    def step(self, torque: Array, speed: float, dt: float) -> float:
        """Take in the external torque of one tick.

        Args:
            torque: External torque without bias, shape (n,) [Nm].
            speed: Speed of the fastest joint [rad/s].
            dt: Time since the last tick [s].

        Returns:
            The robot's share, in [0, 1] [1].
        """
        config = self._config
        self._filtered += (torque - self._filtered) * (1.0 - math.exp(-dt / config.level_time))
        scaled = (self._filtered * self._inverse).tolist()  # reductions of short arrays are slower than those of lists
        self.level = max(max(scaled), -min(scaled))
        level = self.level / (1.0 + config.moving_allowance * min(1.0, speed / config.moving_speed))
        target = share_of_level(level * config.held_gain if self.person_leads else level, config)
        if target < self.authority:
            self.authority = target + (self.authority - target) * math.exp(-dt / config.fall_time)
        else:
            self.authority = min(target, self.authority + dt / config.rise_time)
        self.person_leads = self.authority < 0.9 if self.person_leads else max(target, self.authority) < 0.5
        return self.authority
