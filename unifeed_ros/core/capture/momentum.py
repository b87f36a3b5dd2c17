"""External torque from measured torque: the generalised-momentum observer (De Luca et al., IROS 2006)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, frozen_array


@dataclass(frozen=True, kw_only=True)
class MomentumConfig:
    """What the observer knows of the arm beyond its URDF; zeros fit torque sensors behind the gears, as Franka's."""

    gain: float = 60.0
    """Observer gain: external torque is followed with the time constant 1 / gain [1/s]."""
    dry_friction: Sequence[float] = ()
    """Dry friction between where torque is measured and the link, length n [Nm]; empty: 0."""
    viscous_friction: Sequence[float] = ()
    """Viscous friction there, length n [Nm s/rad]; empty: 0."""
    friction_speed: float = 0.02
    """Speed at which dry friction is almost (tanh 1) all there [rad/s]."""
    rotor_inertia: Sequence[float] = ()
    """Inertia of the rotors seen at the joints, where torque is measured before them, length n [kg m^2]; empty: 0."""
    payload_mass: float = 0.0
    """Mass held at the tool that the URDF lacks [kg]."""
    payload_center: Sequence[float] = (0.0, 0.0, 0.0)
    """Its centre of mass in the tool frame, length 3 [m]."""
    without_gravity: bool = False
    """True if the driver takes gravity off the torque that it reports."""
    longest_step: float = 0.05
    """Samples farther apart than this are not integrated across [s]."""

    def __post_init__(self) -> None:
        """Reject values that no arm has."""
        for name in ("gain", "friction_speed", "longest_step"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ConfigError(name, expected="> 0 and finite", got=getattr(self, name))
        for name in ("dry_friction", "viscous_friction", "rotor_inertia"):
            values = tuple(float(v) for v in getattr(self, name))
            if not np.isfinite(values).all() or min(values, default=0.0) < 0.0:
                raise ConfigError(name, expected=">= 0 and finite", got=values)
            object.__setattr__(self, name, values)
        if not 0.0 <= self.payload_mass < math.inf:
            raise ConfigError("payload_mass", expected=">= 0 kg and finite", got=self.payload_mass)
        frozen_array("payload_center", self.payload_center, (3,))


class MomentumObserver:
    """Tell what outside torque the arm's momentum shows, without measuring accelerations.

    With p = M(q) v and dp/dt = tau - friction(v) + C(q, v)^T v - g(q) + tau_ext, the residual r follows tau_ext as
    dr/dt = gain (tau_ext - r). Between samples this is solved exactly for the mean external torque of the step,

        r <- a r + (1 - a) ((p - p_before) / dt - mean of the known terms),  a = exp(-gain dt),

    which is stable for every gain and step.

    Known weakness: dry friction is unknown within its bounds while a joint rests, and shows as external torque.

    Args:
        robot: The arm.
        config: Gain, friction, payload.

    Raises:
        ConfigError: A list has another length than the arm has joints.
    """

    def __init__(self, robot: RobotModel, config: MomentumConfig | None = None) -> None:
        self.config = config or MomentumConfig()
        self._n = robot.n
        self._model = _with_payload(robot, self.config)
        self._data = self._model.createData()
        self._dry, self._viscous, self._rotor = (
            self._per_joint(name) for name in ("dry_friction", "viscous_friction", "rotor_inertia"))
        self.reset()

    def _per_joint(self, name: str) -> Array:
        values = getattr(self.config, name) or (0.0,) * self._n
        if len(values) != self._n:
            raise ConfigError(name, expected=f"{self._n} numbers, one a joint", got=len(values))
        return np.array(values)

    def reset(self) -> None:
        """Forget everything: the next sample is the first, and its residual zero."""
        self._residual = np.zeros(self._n)
        self._time: float | None = None
        self._momentum = self._known = self._residual

    def update(self, state: RobotState, torque: ArrayLike) -> Array:
        """Take in one sample.

        A sample whose stamp is not later than the one before changes nothing, unless it goes back by more than the
        longest step: then the observer begins anew.

        Args:
            state: Measured state.
            torque: Torque measured with it, shape (n,) [Nm].

        Returns:
            External torque, shape (n,) [Nm].

        Raises:
            ShapeError: Another number of torques, positions or velocities.
            InputError: Not finite; the observer is as it was before.
        """
        measured = self._checked(state, torque)
        step = math.inf if self._time is None else state.time - self._time
        if step < -self.config.longest_step:
            self.reset()
            step = math.inf
        elif step <= 0.0:
            return self._residual.copy()
        momentum, known = self._terms(state.positions, state.velocities, measured)
        if step <= self.config.longest_step:
            kept = math.exp(-self.config.gain * step)
            outside = (momentum - self._momentum) / step - 0.5 * (known + self._known)
            self._residual = kept * self._residual + (1.0 - kept) * outside
        self._time, self._momentum, self._known = state.time, momentum, known
        return self._residual.copy()

    def _checked(self, state: RobotState, torque: ArrayLike) -> Array:
        measured = np.array(torque, dtype=np.float64)
        shapes = (measured.shape, np.shape(state.positions), np.shape(state.velocities))
        if set(shapes) != {(self._n,)}:
            raise ShapeError("shapes of torque, positions and velocities", expected=f"({self._n},) each", got=shapes)
        if not math.isfinite(state.time + float(np.sum(measured) + np.sum(state.positions) + np.sum(state.velocities))):
            raise InputError("sample of the momentum observer is not finite", expected="numbers",
                             got=f"time {state.time}, torque {measured.tolist()}")
        return measured

    def _terms(self, q: Array, v: Array, torque: Array) -> tuple[Array, Array]:
        """Compute the momentum and the known part of its rate."""
        model, data = self._model, self._data
        mass = pin.crba(model, data, q)
        upper = np.triu(mass)
        momentum = upper @ v + np.triu(mass, 1).T @ v + self._rotor * v
        coriolis = pin.computeCoriolisMatrix(model, data, q, v)
        known = torque + coriolis.T @ v - self._dry * np.tanh(v / self.config.friction_speed) - self._viscous * v
        if not self.config.without_gravity:
            known -= pin.computeGeneralizedGravity(model, data, q)
        return momentum, known


def _with_payload(robot: RobotModel, config: MomentumConfig) -> pin.Model:
    model = pin.Model(robot.pin_model)
    frame = model.frames[model.getFrameId(robot.config.tool_frame)]
    center = frame.placement.act(np.array(config.payload_center, dtype=np.float64))
    model.inertias[frame.parentJoint] += pin.Inertia(config.payload_mass, center, np.zeros((3, 3)))
    return model
