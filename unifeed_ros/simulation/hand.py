"""A hand that holds the tool: spring and damper towards a wanted tool pose, never stronger than a person."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array


@dataclass(frozen=True, kw_only=True)
class HandConfig:
    """How a hand holds the tool."""

    stiffness: float = 300.0
    """Spring of the hand [N/m]."""
    damping: float = 40.0
    """Damper of the hand [N s/m]."""
    push: float = 600.0
    """How fast the hand adds force while it does not get its way [N/(m s)]."""
    largest_push: float = 15.0
    """Most force that the hand adds that way [N]."""
    largest_force: float = 30.0
    """Force that the hand never exceeds [N]."""
    turning_stiffness: float = 40.0
    """Spring that turns the tool's axis [Nm/rad]."""
    turning_damping: float = 1.5
    """Damper against turning [Nm s/rad]."""
    turning_push: float = 60.0
    """How fast the hand adds torque while the tool stays tilted: friction would hold it at 5 degrees [Nm/(rad s)]."""
    largest_turning_push: float = 3.0
    """Most torque that the hand adds that way [Nm]."""
    largest_torque: float = 5.0
    """Torque that the hand never exceeds [Nm]."""
    smoothing: float = 0.02
    """Time constant over which a hand feels speed [s]."""


class Hand:
    """Spring and damper between the tool and where the person wants it.

    Works from joint states alone, as a person's arm works from what it feels.

    Args:
        robot: The arm.
        config: How the hand holds the tool.
    """

    def __init__(self, robot: RobotModel, config: HandConfig) -> None:
        self._robot = robot
        self._config = config
        self.take()

    def take(self) -> None:
        """Take the tool anew: forget the added force and torque and the felt speed."""
        self._added = np.zeros(3)
        self._added_torque = np.zeros(3)
        self._felt: Array | None = None
        self._time: float | None = None

    def wrench(self, time: float, q: ArrayLike, v: ArrayLike, position: Array, axis: Array | None,
               velocity: Array, grip: float = 1.0) -> Array:
        """Compute force and torque of the hand on the tool.

        Args:
            time: Time of the joint state [s].
            q: Joint positions, shape (n,) [rad].
            v: Joint velocities, shape (n,) [rad/s].
            position: Wanted tool position, shape (3,) [m].
            axis: Wanted direction of the tool's z axis, shape (3,); None: the hand lets the tool turn as it likes.
            velocity: Wanted tool velocity, shape (3,) [m/s].
            grip: Share of the hand's strength, 0 to 1 [1].

        Returns:
            Wrench at the tool, axes of the base frame, shape (6,) [N, Nm].
        """
        config = self._config
        dt = 0.0 if self._time is None else max(time - self._time, 0.0)
        self._time = time
        here, rotation = self._robot.tool_pose(q)
        twist = self._robot.tool_jacobian(q) @ np.asarray(v, dtype=np.float64)
        if self._felt is None:
            self._felt = twist
        self._felt = self._felt + (twist - self._felt) * min(dt / config.smoothing, 1.0)
        error = position - here
        self._added = _limited(self._added + grip * config.push * error * dt, config.largest_push)
        force = config.stiffness * error + self._added + config.damping * (velocity - self._felt[:3])
        torque = np.zeros(3)
        if axis is not None:
            tilted = np.cross(rotation[:, 2], axis)
            self._added_torque = _limited(self._added_torque + grip * config.turning_push * tilted * dt,
                                          config.largest_turning_push)
            torque = (config.turning_stiffness * tilted + self._added_torque
                      - config.turning_damping * self._felt[3:])
        return grip * np.concatenate([_limited(force, config.largest_force), _limited(torque, config.largest_torque)])


def _limited(vector: Array, largest: float) -> Array:
    length = float(np.linalg.norm(vector))
    return vector if length <= largest else vector * (largest / length)
