"""Settings of the shared controller."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

from unifeed_ros.core.errors import ConfigError

CHOICES: Mapping[str, tuple[str, ...]] = {
    "impedance": ("joint", "tool"), "during_contact": ("wait", "follow", "retime"),
    "after_contact": ("rejoin", "continue"), "stop_category": ("hold", "gravity_compensation", "zero"),
    "output": ("effort", "setpoint", "trajectory")}
"""What the settings that are words may be."""


@dataclass(frozen=True, kw_only=True)
class ControlConfig:
    """How the arm yields, comes back and stops; gains and limits belong to the robot's own settings."""

    output: str = "effort"
    """What goes out: "effort", torques; "setpoint", joint set-points with stiffness, for an arm that closes the loop
    itself; "trajectory", points for a position servo, whose set-point follows the person's torque instead."""
    impedance: str = "joint"
    """Where the spring is: "joint", one a joint; "tool", one at the tool, and joint springs in what it leaves free."""
    inertia_compensation: bool = True
    """Whether the torques for the reference's acceleration are fed forward."""
    coriolis_compensation: bool = True
    """Whether the Coriolis and centrifugal torques of the reference's velocity are fed forward."""
    during_contact: str = "follow"
    """Motion time while a person leads: "wait", it stands still; "follow", it goes with the hand to the nearest point
    of what remains; "retime", it stands still, and the lost time is made up for afterwards, within the limits."""
    after_contact: str = "rejoin"
    """After a person has led: "rejoin", the arm comes back to the motion at once; "continue", it goes on from where it
    was left and meets the motion at its end."""
    stop_category: str = "hold"
    """What a stop does once the speed is gone: "hold", softly in place; "gravity_compensation", weightless and damped;
    "zero", no torque, so that an arm without brakes or gravity compensation of its own sinks."""
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
    following_error: float = 0.2
    """Distance of a joint from the reference that stops a motion while the robot leads [rad]."""
    goal_tolerance: float = 0.02
    """Largest distance of a joint from the end of a motion that counts as arrived [rad]."""
    torque_rate: float = 1000.0
    """Largest change of a torque command [Nm/s]."""
    stale_after: float = 0.1
    """Age of joint states or external torques that stops motion [s]."""
    tool_speed: float = 1.5
    """Speed of the tool that stops the arm [m/s]."""
    tool_force: float = 100.0
    """Estimated external force at the tool that stops the arm [N]."""
    workspace: Sequence[float] = ()
    """Box that the tool stays in, smallest x, y, z, then largest, length 6 [m]; empty: anywhere."""
    clock_step: float = 0.5
    """Leap of the stamps against the steady clock that stops the arm [s]."""
    energy_store: float = 3.0
    """Most energy that the arm may have to give away beyond what it was given [J]."""
    energy_low: float = 0.5
    """Store below which the robot's share shrinks, to nothing at none [J]."""
    energy_supply: float = 20.0
    """Power that refills the store while nobody touches [W]."""
    untouched_level: float = 0.4
    """Level of touch below which nobody counts as touching, for the supply of energy [1]."""
    admittance: float = 15.0
    """External torque that moves the set-point of a position servo by 1 rad/s [Nm s/rad]."""

    def __post_init__(self) -> None:
        """Reject values that would make the arm jump, stick or never stop."""
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name in CHOICES and value not in CHOICES[item.name]:
                raise ConfigError(item.name, expected=", ".join(CHOICES[item.name]), got=value)
            if isinstance(value, float) and not 0.0 < value < math.inf:
                raise ConfigError(item.name, expected="> 0 and finite", got=value)
        object.__setattr__(self, "workspace", tuple(float(v) for v in self.workspace))
        box = self.workspace
        if box and (len(box) != 6 or not all(low < high for low, high in zip(box[:3], box[3:], strict=False))):
            raise ConfigError("workspace", expected="smallest x, y, z, then larger x, y, z [m]", got=list(box))
        if self.energy_low > self.energy_store:
            raise ConfigError("energy_low", expected=f"at most energy_store, {self.energy_store}", got=self.energy_low)
        if self.yield_start >= self.yield_full:
            raise ConfigError("yield_start", expected=f"below yield_full, {self.yield_full}", got=self.yield_start)
        if self.held_gain < 1.0:
            raise ConfigError("held_gain", expected=">= 1", got=self.held_gain)
