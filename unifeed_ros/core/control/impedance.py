"""Joint impedance: a spring and a damper around the reference, with the arm's own weight and inertia fed forward."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from unifeed_ros.core.control.reference import Setpoint
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array


class ImpedanceLaw:
    """Torques of a compliant arm.

    tau = M(q) s a_d + C(q, s v_d) s v_d + g(q) + s K (q_d - q) + D' (s v_d - v), with the share s of the robot and
    D' = s D + (1 - s) c D; without g where the robot's driver adds it. Beyond the velocity limits D more of damping
    acts on the excess; beyond the position limits K pushes back.

    Args:
        robot: The arm: model, gains, limits.
    """

    def __init__(self, robot: RobotModel) -> None:
        self._model = pin.Model(robot.pin_model)
        if robot.config.compensates_gravity:
            self._model.gravity = pin.Motion.Zero()
        self._data = self._model.createData()
        self.stiffness, self.damping = np.array(robot.config.stiffness), np.array(robot.config.damping)
        self._lower, self._upper, self._fastest = robot.lower, robot.upper, robot.velocity_limits
        self._zero = np.zeros(robot.n)

    def weight(self, positions: Array) -> Array:
        """Compute the torques that hold the arm; zero where the robot's driver adds them.

        Args:
            positions: Joint positions, shape (n,) [rad].

        Returns:
            Torques, shape (n,) [Nm].
        """
        return np.array(pin.computeGeneralizedGravity(self._model, self._data, positions))

    def torque(self, positions: Array, velocities: Array, setpoint: Setpoint, share: float,
               free_damping: float) -> Array:
        """Compute the torques towards a setpoint.

        Args:
            positions: Measured joint positions, shape (n,) [rad].
            velocities: Measured joint velocities, shape (n,) [rad/s].
            setpoint: What to reach.
            share: Share s of the robot, in [0, 1] [1]; at 0 the arm is weightless and lightly damped.
            free_damping: Damping c that is left when the robot has no share, as a part of the robot's [1].

        Returns:
            Torques, shape (n,) [Nm].
        """
        wanted = share * setpoint.velocities
        torque = pin.rnea(self._model, self._data, positions, wanted, share * setpoint.accelerations)
        spring = self.stiffness * (setpoint.positions - positions)
        damper = self.damping * (wanted - velocities)
        torque = torque + share * spring + (share + (1.0 - share) * free_damping) * damper
        return self._within(torque, positions, velocities)

    def soft_hold(self, positions: Array, velocities: Array, setpoint: Setpoint, part: float) -> Array:
        """Compute the torques that brake fully and hold a posture softly.

        Args:
            positions: Measured joint positions, shape (n,) [rad].
            velocities: Measured joint velocities, shape (n,) [rad/s].
            setpoint: Where and how fast the arm should be on its way to rest.
            part: Part of the robot's stiffness that holds [1].

        Returns:
            Torques, shape (n,) [Nm].
        """
        torque = pin.rnea(self._model, self._data, positions, self._zero, setpoint.accelerations)
        spring = part * self.stiffness * (setpoint.positions - positions)
        damper = self.damping * (setpoint.velocities - velocities)
        return self._within(torque + spring + damper, positions, velocities)

    def _within(self, torque: Array, positions: Array, velocities: Array) -> Array:
        excess = velocities - np.minimum(np.maximum(velocities, -self._fastest), self._fastest)
        beyond = positions - np.minimum(np.maximum(positions, self._lower), self._upper)
        return torque - self.damping * excess - self.stiffness * beyond
