"""External torques beside the ones before: a sensor at the end of its range repeats itself, a hand never does."""

from __future__ import annotations

import numpy as np

from unifeed_ros.core.errors import InputError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

STUCK_S = 0.06
"""Time over which a torque that is a touch repeats to the last bit, from which on its sensor counts as stuck [s]: a
person's press changes within milliseconds, and a slow driver that repeats its values has new ones by then."""


class StuckTorque:
    """Notice torques above the threshold of a touch that stay the same to the last bit, as of a saturated sensor.

    Args:
        robot: The arm.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._names = robot.joint_names
        self._thresholds = np.asarray(robot.config.contact_thresholds)
        self._torque: Array | None = None
        self._since = np.zeros(robot.n)

    def check(self, time: float, torque: Array) -> None:
        """Take in one sample.

        Args:
            time: Stamp [s].
            torque: External torque, shape (n,) [Nm].

        Raises:
            InputError: A joint's sensor is stuck.
        """
        changed = np.ones(len(torque), bool) if self._torque is None else torque != self._torque
        self._since[changed | (self._since > time)] = time
        self._torque = np.array(torque)
        stuck = (time - self._since > STUCK_S) & (np.abs(torque) > self._thresholds)
        if stuck.any():
            raise InputError("external torques are stuck, as of a saturated sensor",
                             got=", ".join(f"{torque[k]:g} Nm at {self._names[k]}" for k in np.flatnonzero(stuck)),
                             mend="check the sensor, and what presses on the arm")
