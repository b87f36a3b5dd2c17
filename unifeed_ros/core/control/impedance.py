"""Impedance: a spring and a damper around the reference, with the arm's own weight and inertia fed forward."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from unifeed_ros.core.control.sampled_motion import Setpoint
from unifeed_ros.core.control.settings import ControlConfig
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array


class ImpedanceLaw:
    """Torques of a compliant arm.

    tau = M(q) s a_d + C(q, s v_d) s v_d + g(q) + s K (q_d - q) + D' (s v_d - v), with the share s of the robot and
    D' = s D + (1 - s) c D; without g where the robot's driver adds it, and without the first two terms where the
    settings say so. Beyond the velocity limits D more of damping acts on the excess; beyond the position limits K
    pushes back.

    Args:
        robot: The arm: model, gains, limits.
        config: Which terms are fed forward; all by default.
    """

    def __init__(self, robot: RobotModel, config: ControlConfig | None = None) -> None:
        config = config or ControlConfig()
        self._model = pin.Model(robot.pin_model)
        if robot.config.compensates_gravity:
            self._model.gravity = pin.Motion.Zero()
        self._data = self._model.createData()
        self._inertia, self._coriolis = float(config.inertia_compensation), float(config.coriolis_compensation)
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

    def braking(self, positions: Array, deceleration: Array) -> Array:
        """Compute torques that hold the weight and slow the arm down without looking at it.

        Args:
            positions: Where it was last seen, shape (n,) [rad].
            deceleration: Wanted, shape (n,) [rad/s^2].

        Returns:
            Torques, shape (n,) [Nm].
        """
        return np.array(pin.rnea(self._model, self._data, positions, self._zero, -deceleration))

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
        torque = pin.rnea(self._model, self._data, positions, self._coriolis * wanted,
                          self._inertia * share * setpoint.accelerations)
        free = (1.0 - share) * free_damping * self.damping * (wanted - velocities)
        if share > 0.0:
            torque = torque + share * self._pull(positions, velocities, setpoint.positions, wanted)
        return self._within(torque + free, positions, velocities)

    def _pull(self, positions: Array, velocities: Array, target: Array, wanted: Array) -> Array:
        """Compute spring and damper at full share; shapes (n,) [rad], [rad/s], [rad], [rad/s]."""
        return self.stiffness * (target - positions) + self.damping * (wanted - velocities)

    def soft_hold(self, positions: Array, velocities: Array, setpoint: Setpoint, part: float) -> Array:
        """Compute the torques that brake fully and hold a posture softly.

        Args:
            positions: Measured joint positions, shape (n,) [rad].
            velocities: Measured joint velocities, shape (n,) [rad/s].
            setpoint: Where and how fast the arm should be on its way to rest.
            part: Part of the robot's stiffness that holds [1]; 0: weightless at rest.

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


class ToolImpedanceLaw(ImpedanceLaw):
    """The same with the spring and the damper at the tool: F = K_x e + D_x (J (v_d - v)), tau = J^T F.

    The error e is the vector from the tool to where the reference's posture puts it, and the rotation vector between
    both, axes of the base frame. What the tool leaves free is held by the joint springs through I - J^T (J^T)^+, with
    a damped pseudo-inverse (static, not dynamically consistent: near a singular posture the two meet).

    Args:
        robot: The arm: model, gains, limits.
        config: Which terms are fed forward; all by default.
    """

    def __init__(self, robot: RobotModel, config: ControlConfig | None = None) -> None:
        super().__init__(robot, config)
        self._frame = robot.pin_model.getFrameId(robot.config.tool_frame)
        self._wanted_data = self._model.createData()
        self._tool_stiffness = np.array(robot.config.tool_stiffness)
        self._tool_damping = np.array(robot.config.tool_damping)
        self._regular = 1e-6 * np.eye(6)

    def _pull(self, positions: Array, velocities: Array, target: Array, wanted: Array) -> Array:
        jacobian = pin.computeFrameJacobian(self._model, self._data, positions, self._frame, pin.LOCAL_WORLD_ALIGNED)
        here = pin.updateFramePlacement(self._model, self._data, self._frame)
        pin.forwardKinematics(self._model, self._wanted_data, target)
        there = pin.updateFramePlacement(self._model, self._wanted_data, self._frame)
        turn = here.rotation @ pin.log3(here.rotation.T @ there.rotation)
        error = np.concatenate([there.translation - here.translation, turn])
        force = self._tool_stiffness * error + self._tool_damping * (jacobian @ (wanted - velocities))
        posture = super()._pull(positions, velocities, target, wanted)
        reach = np.linalg.solve(jacobian @ jacobian.T + self._regular, jacobian @ posture)
        return jacobian.T @ (force - reach) + posture


def make_law(robot: RobotModel, config: ControlConfig) -> ImpedanceLaw:
    """Give the impedance law that the settings ask for.

    Args:
        robot: The arm.
        config: Settings.
    """
    return (ToolImpedanceLaw if config.impedance == "tool" else ImpedanceLaw)(robot, config)
