"""What the estimate of external torque shows of an arm that nobody touches, learned while nobody does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array

FRICTION_SPEED = 0.02
"""Speed at which dry friction is almost (tanh 1) all there [rad/s]."""
GRAVITY = np.array([0.0, 0.0, -9.81])
"""Acceleration of free fall, base frame [m/s^2]."""
ACCELERATION_TIME = 0.03
"""Time constant of the filter on the tool's acceleration [s]."""
LONGEST_LOOK = 0.1
"""Looks farther apart than this tell no acceleration [s]."""


@dataclass(frozen=True, kw_only=True)
class UntouchedConfig:
    """How well the arm's own estimate of external torque is known, and how fast the rest is learned."""

    bias_time: float = 4.0
    """Time constant with which a constant bias follows while nobody touches [s]."""
    error: float = 0.3
    """Errors of the estimate that no term explains, as a part of each joint's threshold [1]."""
    error_time: float = 0.1
    """Time over which these errors stay alike [s]."""
    clip: float = 0.5
    """Part of a threshold that one sample counts for at most: a push hardly enters [1]."""
    payload: float = 0.7
    """Payload error to be expected [kg]; 0 where the robot's driver knows what it carries."""
    payload_lever: float = 0.05
    """Distance of its centre of mass from the tool to be expected [m]."""
    friction: float = 0.2
    """Error of dry friction to be expected, and of viscous friction at 1 rad/s, as a part of each threshold [1]."""

    def __post_init__(self) -> None:
        """Reject values that would learn nothing or everything."""
        for name in ("bias_time", "error", "error_time", "clip"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        for name in ("payload", "payload_lever", "friction"):
            if not 0.0 <= getattr(self, name) < math.inf:
                raise ConfigError(name, expected=">= 0 and finite", got=getattr(self, name))


class UntouchedModel:
    """Constant bias, friction error and payload error, by a Kalman filter.

    The torque of an untouched arm is b + D(v) f + G(q, a) w: a bias a joint, dry and viscous friction a joint, and the
    weight and inertia of w = (m, m c), a mass m at c in the tool frame, under gravity less the tool's acceleration a;
    all enter linearly and drift slowly. Where the arm rests only the sum shows; how far the sum is unknown at another
    posture or speed is the model's doubt, and a detector can wait until it has seen the arm move.

    Args:
        thresholds: Contact thresholds, shape (n,) [Nm].
        config: Settings.
        robot: The arm; without one there is no payload term.
    """

    def __init__(self, thresholds: Array, config: UntouchedConfig, robot: RobotModel | None = None) -> None:
        self.config, self._thresholds, n = config, thresholds, len(thresholds)
        self._n, self._robot = n, robot
        self._data = robot.pin_model.createData() if robot is not None else None
        self._tool = robot.pin_model.getFrameId(robot.config.tool_frame) if robot is not None else 0
        lever = config.payload * config.payload_lever
        weight = [config.payload] + 3 * [lever] if robot is not None else []
        friction = config.friction * thresholds
        self._prior = np.concatenate([1e3 * thresholds, friction, friction, weight]) ** 2
        noise = (config.error * thresholds) ** 2 * config.error_time
        drift = noise / config.bias_time**2
        slow = 1e-4 * self._prior[n:]
        self._noise, self._drift = noise, np.concatenate([drift, slow])
        self._regressor = np.zeros((n, len(self._prior)))
        self._regressor[:, :n] = np.eye(n)
        self.reset()

    def reset(self) -> None:
        """Forget everything learned."""
        self._mean = np.zeros(len(self._prior))
        self._cov = np.diag(self._prior)
        self.torque, self.doubt = np.zeros(self._n), np.zeros(self._n)
        self._looked = -math.inf
        self._tool_velocity, self._acceleration = np.zeros(3), np.zeros(3)

    @property
    def payload(self) -> float:
        """Payload error found so far [kg]; 0 without a robot."""
        return float(self._mean[3 * self._n]) if self._robot is not None else 0.0

    def look(self, time: float, positions: Array | None, velocities: Array) -> None:
        """Set torque and doubt, shape (n,) [Nm], to those of a moment; no payload without positions.

        Args:
            time: Stamp [s].
            positions: Joint positions, shape (n,) [rad], or None.
            velocities: Joint velocities, shape (n,) [rad/s].
        """
        n, y = self._n, self._regressor
        joints = np.arange(n)
        y[joints, n + joints] = np.tanh(velocities / FRICTION_SPEED)
        y[joints, 2 * n + joints] = velocities
        if self._robot is not None:
            y[:, 3 * n:] = 0.0 if positions is None else self._weight_columns(time, positions, velocities)
        self._spread = y @ self._cov
        self.torque = y @ self._mean
        self.doubt = np.sqrt(np.einsum("ij,ij->i", self._spread, y))

    def learn(self, free: Array, seconds: float, *, clipped: bool = True) -> None:
        """Learn from what is left of an untouched arm's torque at the posture last looked at.

        Args:
            free: Torque less that of the model, shape (n,) [Nm].
            seconds: Time that it stands for [s].
            clipped: False to believe it however large it is.
        """
        if clipped:
            most = self.config.clip * self._thresholds + self.doubt
            free = np.minimum(np.maximum(free, -most), most)
        innovation = self._spread @ self._regressor.T + np.diag(self._noise / seconds)
        gain = np.linalg.solve(innovation, self._spread).T
        self._mean = self._mean + gain @ free
        self._cov = self._cov - gain @ self._spread
        self._cov = 0.5 * (self._cov + self._cov.T)
        self._cov[np.diag_indices_from(self._cov)] += self._drift * seconds

    def shift(self, free: Array) -> None:
        """Take what is left as a bias or payload that changed at once, shape (n,) [Nm]."""
        n = self._n
        self._cov[np.arange(n), np.arange(n)] += free**2 + self._thresholds**2
        self._cov[np.arange(3 * n, len(self._prior)), np.arange(3 * n, len(self._prior))] += self._prior[3 * n:]
        self._spread = self._regressor @ self._cov
        self.learn(free, 1.0, clipped=False)

    def _weight_columns(self, time: float, positions: Array, velocities: Array) -> Array:
        """Torque of a unit mass at the tool's origin and of unit first moments along its axes, shape (n, 4)."""
        assert self._robot is not None
        model, data = self._robot.pin_model, self._data
        jacobian = pin.computeFrameJacobian(model, data, positions, self._tool, pin.LOCAL_WORLD_ALIGNED)
        rotation = pin.updateFramePlacement(model, data, self._tool).rotation
        felt = GRAVITY - self._follow_acceleration(time, jacobian[:3] @ velocities)
        columns = np.empty((self._n, 4))
        columns[:, 0] = jacobian[:3].T @ felt
        columns[:, 1:] = jacobian[3:].T @ (_cross_matrix(-felt) @ rotation)
        return columns

    def _follow_acceleration(self, time: float, velocity: Array) -> Array:
        step = time - self._looked
        if 0.0 < step < LONGEST_LOOK:
            now = (velocity - self._tool_velocity) / step
            self._acceleration = self._acceleration + (now - self._acceleration) * min(1.0, step / ACCELERATION_TIME)
        elif step != 0.0:
            self._acceleration = np.zeros(3)
        self._looked, self._tool_velocity = time, velocity
        return self._acceleration


def _cross_matrix(v: Array) -> Array:
    """Give the matrix of the product v x, shape (3, 3)."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])
