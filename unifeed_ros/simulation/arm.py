"""A simulated arm: physics at 1 kHz, a hand that pushes the tool, and the sensors of a real arm."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, frozen_array
from unifeed_ros.simulation.arm_model import ArmDynamics, build_arm_model
from unifeed_ros.simulation.arm_sensors import DriveSensor, WristSensor

TIMESTEP = 0.001
"""Step of the physics [s]."""
NOISE_BLOCK = 256
"""Steps that sensor noise is drawn for at once; drawing step by step costs more than the physics."""


@dataclass(frozen=True, kw_only=True)
class ArmConfig:
    """What the simulated arm has beyond its URDF: friction, rotors, sensors."""

    damping: Sequence[float] = (0.5,)
    """Viscous friction of the joints, length n or 1 [Nm s/rad]."""
    armature: Sequence[float] = (0.1,)
    """Inertia of the rotors seen at the joints, length n or 1 [kg m^2]."""
    position_noise: float = 2e-5
    """Standard deviation of the measured joint positions [rad]."""
    velocity_noise: float = 2e-3
    """Standard deviation of the measured joint velocities [rad/s]."""
    torque_noise: float = 0.05
    """Standard deviation of the external torque, as part of each joint's contact threshold [1]."""
    torque_bias: float = 0.15
    """Standard deviation of the constant bias of the external torque, as part of the contact threshold [1]."""
    torque_time: float = 0.005
    """Time constant of the filter that the external torque passes [s]."""
    friction_error: float = 0.15
    """Standard deviation of the part of each joint's friction that the estimate of external torque misses [1]."""
    payload: float = 0.0
    """Mass at the tool that the arm's own model lacks: it shows as external torque [kg]."""
    measured_noise: float = 0.05
    """Standard deviation of the measured motor torque, as part of each joint's contact threshold [1]."""
    wrench_noise: Sequence[float] = (0.3, 0.02)
    """Standard deviation of the wrist sensor's force [N] and torque [Nm]."""
    wrench_offset: Sequence[float] = (2.0, 0.1)
    """Standard deviation of the wrist sensor's constant offset, in its axes: force [N] and torque [Nm]."""
    hold_damping: float = 5.0
    """Damping of the arm's own gravity compensation, when no command comes [Nm s/rad]."""

    def __post_init__(self) -> None:
        """Reject negative values."""
        object.__setattr__(self, "damping", tuple(float(v) for v in self.damping))
        object.__setattr__(self, "armature", tuple(float(v) for v in self.armature))
        for name in ("wrench_noise", "wrench_offset"):
            object.__setattr__(self, name, tuple(float(v) for v in getattr(self, name)))
            if len(getattr(self, name)) != 2:
                raise ConfigError(name, expected="two numbers, force and torque", got=getattr(self, name))
        for name in self.__dataclass_fields__:
            values = np.atleast_1d(getattr(self, name))
            if not (np.isfinite(values).all() and (values >= 0.0).all()):
                raise ConfigError(name, expected=">= 0 and finite", got=getattr(self, name))


class SimulatedArm:
    """One arm in MuJoCo, 1 kHz, with a table that it can touch.

    The estimate of external torque is what a real arm would give: the torques of hand and table through a first-order
    filter, plus the friction and payload that the arm's model misses, a constant bias a joint, and noise. Every random
    number comes from the seed: the same calls give the same bytes.

    Args:
        robot: The arm.
        seed: Seed of noise, bias and friction error.
        table_height: Height of the table's plane in the base frame [m]; None for no table.
        config: Friction, rotors and sensors.

    Raises:
        ConfigError: A setting has the wrong length, or the URDF cannot be simulated.
    """

    def __init__(self, robot: RobotModel, *, seed: int, table_height: float | None = 0.0,
                 config: ArmConfig | None = None) -> None:
        self.robot, self.config = robot, config or ArmConfig()
        n = robot.n
        damping, armature = (self._per_joint(name) for name in ("damping", "armature"))
        dynamics = ArmDynamics(friction=robot.config.friction, damping=damping, armature=armature,
                               payload=self.config.payload)
        self.model = build_arm_model(robot, dynamics, table_height=table_height, timestep=TIMESTEP)
        self.data = mujoco.MjData(self.model)
        self._tool = self.model.site("tool").id
        self._rng = np.random.default_rng(seed)
        thresholds = np.array(robot.config.contact_thresholds)
        self._bias = self._rng.normal(size=n) * self.config.torque_bias * thresholds
        self._friction_error = self._rng.normal(size=n) * self.config.friction_error
        self._torque_sensor = DriveSensor(self.config.measured_noise * thresholds, seed)
        self._wrist = WristSensor(self.config.wrench_offset, self.config.wrench_noise, seed)
        self._dry, self._viscous = np.array(robot.config.friction), np.array(damping)
        self._noise_scales = np.concatenate([np.full(n, self.config.position_noise),
                                             np.full(n, self.config.velocity_noise),
                                             thresholds * self.config.torque_noise])
        self._jacobian = np.zeros((6, n))
        self._gain = 1.0 - math.exp(-TIMESTEP / self.config.torque_time) if self.config.torque_time > 0 else 1.0
        self.reset(robot.config.seed)

    def _per_joint(self, name: str) -> tuple[float, ...]:
        values = tuple(getattr(self.config, name))
        values = values * self.robot.n if len(values) == 1 else values
        if len(values) != self.robot.n:
            raise ConfigError(f"{name} of the simulated arm", expected=f"{self.robot.n} numbers or 1", got=len(values))
        return values

    def reset(self, positions: ArrayLike) -> None:
        """Put the arm at rest in a posture at time zero, without command and without push.

        Args:
            positions: Joint positions, shape (n,) [rad].

        Raises:
            ShapeError: Another number of joints.
            InputError: Not finite, or outside the limits.
        """
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = self.robot.require_state(positions)
        self._command: Array | None = None
        self._servo: tuple[Array, Array, Array, Array] | None = None
        self._hand: Array | None = None
        self._external = np.zeros(self.robot.n)
        self._motor = np.zeros(self.robot.n)
        self._draw_noise()
        mujoco.mj_step1(self.model, self.data)

    def command(self, torque: ArrayLike | None) -> None:
        """Take a torque command; it stays until the next.

        Args:
            torque: Joint torques, shape (n,) [Nm], without gravity if the robot compensates it itself. None: the arm
                holds itself in gravity compensation with some damping.

        Raises:
            ShapeError: Another number of joints.
            InputError: Not finite.
        """
        self._servo = None
        self._command = None if torque is None else frozen_array("torque command", torque, (self.robot.n,))

    def drive(self, target: ArrayLike, velocities: ArrayLike, stiffness: ArrayLike) -> None:
        """Take a set-point for the arm's own controller, which adds gravity itself; it stays until the next.

        Its damping grows with the root of the stiffness, from the robot's damping at the robot's stiffness, and is
        never less than half of that.

        Args:
            target: Joint positions, shape (n,) [rad].
            velocities: Joint velocities, shape (n,) [rad/s].
            stiffness: Stiffness, shape (n,) [Nm/rad]; many times the robot's makes a position servo.

        Raises:
            ShapeError: Another number of joints.
            InputError: Not finite.
        """
        n = (self.robot.n,)
        gains = frozen_array("stiffness of a set-point", stiffness, n)
        part = np.sqrt(np.maximum(gains, 0.0) / np.maximum(self.robot.config.stiffness, 1e-9))
        damping = np.maximum(part, 0.5) * np.array(self.robot.config.damping)
        self._servo = (frozen_array("set-point", target, n), frozen_array("its velocities", velocities, n), gains,
                       damping)

    def push(self, wrench: ArrayLike) -> None:
        """Set the wrench of the hand at the tool; it stays until the next.

        Args:
            wrench: Force [N] and torque [Nm] at the tool's origin, axes of the base frame, shape (6,).

        Raises:
            ShapeError: Another length.
            InputError: Not finite.
        """
        hand = frozen_array("wrench", wrench, (6,))
        self._hand = hand if hand.any() else None

    def step(self) -> None:
        """Advance the physics by 1 ms."""
        model, data = self.model, self.data
        limits = self.robot.torque_limits
        self._motor = np.minimum(np.maximum(self._motor_torque(), -limits), limits)
        data.qfrc_applied[:] = self._motor
        hand = self._hand_torque()
        if hand is not None:
            data.qfrc_applied += hand
        mujoco.mj_step2(model, data)
        self._observe(hand)
        mujoco.mj_step1(model, data)  # kinematics and contacts of the new state, for whoever asks next
        self._next_noise += 1
        if self._next_noise == NOISE_BLOCK:
            self._draw_noise()

    def _motor_torque(self) -> Array:
        if self._servo is not None:
            target, velocities, gains, damping = self._servo
            weight = self.robot.gravity(self.data.qpos)
            return weight + gains * (target - self.data.qpos) + damping * (velocities - self.data.qvel)
        if self._command is not None and not self.robot.config.compensates_gravity:
            return self._command
        gravity = self.robot.gravity(self.data.qpos)
        if self._command is None:
            return gravity - self.config.hold_damping * self.data.qvel
        return gravity + self._command

    def _hand_torque(self) -> Array | None:
        if self._hand is None:
            return None
        mujoco.mj_jacSite(self.model, self.data, self._jacobian[:3], self._jacobian[3:], self._tool)
        return self._hand @ self._jacobian

    def _observe(self, hand: Array | None) -> None:
        """Low-pass filter the torques of hand and table; call it while contact forces and Jacobians are of one time."""
        external = self._external
        external -= self._gain * external
        if hand is not None:
            external += self._gain * hand
        if self.data.ncon > 0:
            external += self._gain * self.contact_torque()
        if self.config.payload > 0.0:
            external += self._gain * (self._payload_force() @ self._jacobian[:3])

    def _payload_force(self) -> Array:
        """Compute the payload's force on the arm, axes of the base frame, shape (3,) [N]; finds the Jacobian too."""
        mujoco.mj_jacSite(self.model, self.data, self._jacobian[:3], self._jacobian[3:], self._tool)
        mujoco.mj_rnePostConstraint(self.model, self.data)
        felt = np.zeros(6)
        mujoco.mj_objectAcceleration(self.model, self.data, mujoco.mjtObj.mjOBJ_SITE, self._tool, felt, 0)
        return -self.config.payload * felt[3:]  # MuJoCo counts gravity as an acceleration of the base

    def contact_torque(self) -> Array:
        """Compute the joint torques of the table's contact forces in the last step.

        Returns:
            Torques, shape (n,) [Nm].
        """
        data = self.data
        first = data.ne + data.nf + data.nl
        if first == data.nefc:
            return np.zeros(self.robot.n)
        rows = data.efc_J.reshape(data.nefc, self.robot.n)[first:]
        return data.efc_force[first:] @ rows

    def state(self) -> RobotState:
        """Measure joint positions and velocities, with noise; the same sample until the next step."""
        n, noise = self.robot.n, self._noise[self._next_noise]
        return RobotState(time=self.data.time, positions=self.data.qpos + noise[:n],
                          velocities=self.data.qvel + noise[n:2 * n])

    def external_torque(self) -> Array:
        """Estimate the external torque as a real arm would; the same sample until the next step.

        Returns:
            Torques of hand and table, filtered, with friction error, bias and noise, shape (n,) [Nm].
        """
        velocities = self.data.qvel
        missed = self._friction_error * (self._dry * np.tanh(velocities / 0.02) + self._viscous * velocities)
        return self._external - missed + self._bias + self._noise[self._next_noise, 2 * self.robot.n:]

    def measured_torque(self) -> Array:
        """Measure the motors' torques, friction and rotors included, as a drive does.

        Returns:
            Torques of the last step with noise, shape (n,) [Nm].
        """
        return self._torque_sensor.read(self._motor)

    def wrist_wrench(self) -> Array:
        """Measure the wrench of hand and payload with a sensor at the tool.

        Returns:
            Force [N], then torque [Nm], at the tool's origin in its axes, with offset and noise, shape (6,).
        """
        wrench = np.zeros(6) if self._hand is None else self._hand.copy()
        if self.config.payload > 0.0:
            wrench[:3] += self._payload_force()
        rotation = self.data.site_xmat[self._tool].reshape(3, 3)
        return self._wrist.read(np.concatenate([wrench[:3] @ rotation, wrench[3:] @ rotation]))

    @property
    def time(self) -> float:
        """Time since the reset [s]."""
        return float(self.data.time)

    @property
    def true_positions(self) -> Array:
        """Joint positions without noise, shape (n,) [rad]."""
        return self.data.qpos.copy()

    @property
    def true_velocities(self) -> Array:
        """Joint velocities without noise, shape (n,) [rad/s]."""
        return self.data.qvel.copy()

    @property
    def tool_position(self) -> Array:
        """Position of the tool without noise, base frame, shape (3,) [m]."""
        return self.data.site_xpos[self._tool].copy()

    @property
    def energy(self) -> float:
        """Kinetic and potential energy, without noise [J]."""
        mujoco.mj_energyPos(self.model, self.data)
        mujoco.mj_energyVel(self.model, self.data)
        return float(self.data.energy.sum())

    def _draw_noise(self) -> None:
        shape = (NOISE_BLOCK, len(self._noise_scales))
        self._noise, self._next_noise = self._rng.standard_normal(shape) * self._noise_scales, 0
