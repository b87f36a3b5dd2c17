"""What the controller decides in one tick."""

from __future__ import annotations

from dataclasses import dataclass

from unifeed_ros.core.control.sampled_motion import Setpoint
from unifeed_ros.core.modes import Control, TeachingMode
from unifeed_ros.core.types import Array


@dataclass(frozen=True, kw_only=True, slots=True)
class Command:
    """What the controller decided in one tick."""

    torque: Array | None
    """Joint torques, without gravity where the robot's driver adds it, shape (n,) [Nm]; None: send nothing."""
    setpoint: Setpoint | None
    """The same for an arm that closes the loop itself: where its spring pulls to, within the limits; None: nothing."""
    stiffness: Array | None
    """Stiffness of that spring, shape (n,) [Nm/rad]."""
    mode: TeachingMode
    """What the controller does."""
    control: Control
    """Who leads."""
    authority: float
    """Share of the robot in the command, in [0, 1] [1]."""
    motion_id: str
    """Name of the motion that is tracked; empty otherwise."""
    motion_time: float
    """Time within that motion [s]."""
    force: float
    """Size of the person's force at the tool, estimated from external torque [N]."""
    message: str
    """A sentence for a person."""
    finished: bool
    """True once the tracked motion has ended and the arm rests at its end."""
