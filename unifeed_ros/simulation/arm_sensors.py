"""Sensors that only some arms have: motor torque as a drive measures it, and a wrench at the tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from unifeed_ros.core.types import Array


class DriveSensor:
    """Noise on the torques of the motors.

    Args:
        noise: Standard deviation, shape (n,) [Nm].
        seed: Seed of the arm; the generator is this sensor's own.
    """

    def __init__(self, noise: Array, seed: int) -> None:
        self._noise, self._rng = noise, np.random.default_rng([seed, 1])

    def read(self, torque: Array) -> Array:
        """Give the torques, shape (n,) [Nm], with noise."""
        return torque + self._noise * self._rng.standard_normal(len(torque))


class WristSensor:
    """Offset and noise on a wrench, in the sensor's axes.

    Args:
        offset: Standard deviation of the constant offset: force [N], torque [Nm].
        noise: Standard deviation of the noise: force [N], torque [Nm].
        seed: Seed of the arm; the generator is this sensor's own.
    """

    def __init__(self, offset: Sequence[float], noise: Sequence[float], seed: int) -> None:
        self._rng = np.random.default_rng([seed, 2])
        self._offset = self._rng.normal(size=6) * np.repeat(offset, 3)
        self._noise = np.repeat(noise, 3)

    def read(self, wrench: Array) -> Array:
        """Give the wrench, shape (6,) [N, Nm], with offset and noise."""
        return wrench + self._offset + self._noise * self._rng.standard_normal(6)
