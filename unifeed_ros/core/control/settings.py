"""Settings of the shared controller."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

from unifeed_ros.core.errors import ConfigError


@dataclass(frozen=True, kw_only=True)
class ControlConfig:
    """How the arm yields, comes back and stops; gains and limits belong to the robot's own settings."""

    yield_start: float = 0.6
    """Level of touch at which the robot's share begins to fall [1]; 1 is the robot's contact threshold."""
    yield_full: float = 1.3
    """Level of touch at which the robot has no share left [1]."""
    moving_allowance: float = 0.3
    """Rise of both levels while the arm moves, as a part of them: external torque is known less well then [1]."""
    moving_speed: float = 0.1
    """Speed of the fastest joint at which the whole moving allowance holds [rad/s]."""
    held_gain: float = 2.0
    """Factor on the level of touch while a person leads: a light hand keeps an arm that has given way [1]."""
    level_time: float = 0.015
    """Time constant of the filter on the external torque [s]."""
    fall_time: float = 0.04
    """Time constant with which the robot's share falls [s]."""
    rise_time: float = 0.5
    """Time in which the robot's share rises from 0 to 1 after the release [s]."""
    rejoin_time: float = 0.8
    """Time in which the arm comes back from where it was left to its motion, to about 2 percent of the way [s]."""
    guide_damping: float = 0.2
    """Damping while a person guides the weightless arm, as a part of the robot's damping [1]."""
    yield_damping: float = 0.25
    """Damping while the arm yields on its way, as a part of the robot's [1]; more keeps a push from throwing it."""
    stop_time: float = 0.06
    """Time constant with which a stop takes away the arm's speed [s]."""
    stop_stiffness: float = 0.5
    """Stiffness while stopped, as a part of the robot's stiffness [1]."""
    stop_slack: float = 0.05
    """Displacement while stopped beyond which the arm gives way without pulling harder [rad]."""
    start_tolerance: float = 0.1
    """Largest distance of a joint from the start of a motion [rad]."""
    goal_tolerance: float = 0.02
    """Largest distance of a joint from the end of a motion that counts as arrived [rad]."""
    torque_rate: float = 1000.0
    """Largest change of a torque command [Nm/s]."""
    stale_after: float = 0.1
    """Age of joint states or external torques that stops motion [s]."""

    def __post_init__(self) -> None:
        """Reject values that would make the arm jump, stick or never stop."""
        for item in fields(self):
            value = getattr(self, item.name)
            if not 0.0 < value < math.inf:
                raise ConfigError(item.name, expected="> 0 and finite", got=value)
        if self.yield_start >= self.yield_full:
            raise ConfigError("yield_start", expected=f"below yield_full, {self.yield_full}", got=self.yield_start)
        if self.held_gain < 1.0:
            raise ConfigError("held_gain", expected=">= 1", got=self.held_gain)
