"""Where the external torque comes from, chosen by configuration: what an arm's driver offers becomes joint torque."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from unifeed_ros.core.capture.momentum import MomentumConfig, MomentumObserver
from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, RobotState, frozen_array

JOINT_STATE, FIELD, WRENCH, MOMENTUM = "joint_state", "field", "wrench", "momentum"
SOURCES = (JOINT_STATE, FIELD, WRENCH, MOMENTUM)
DEFAULT_TOPICS = {JOINT_STATE: "external_torques", FIELD: "external_torques", WRENCH: "wrench",
                  MOMENTUM: "joint_states"}


@dataclass(frozen=True, kw_only=True)
class ExternalTorqueConfig:
    """What the arm's driver offers, and how it becomes external torque."""

    source: str = JOINT_STATE
    """What the topic carries: "joint_state", external torque in `effort` by joint name (franka_ros2); "field", one
    number a joint in a message of any type (multipanda_ros2); "wrench", a WrenchStamped at the tool (UR); "momentum", a
    joint state with measured torque in `effort`, from which a momentum observer takes the arm's own part off."""
    topic: str = ""
    """Topic; empty: external_torques, wrench or joint_states, whichever fits the source."""
    type: str = ""
    """Source "field": type of the message, as "package/msg/Type"; it must be installed."""
    field: str = ""
    """Source "field": name of the numbers in it, with dots into messages inside (for example tau_ext_hat_filtered)."""
    frame: str = ""
    """Source "wrench": frame of the URDF in whose origin and axes the wrench is given; empty: the tool frame."""
    sign: float = 1.0
    """1, or -1 for a driver that gives all values the other way round."""
    tare_time: float = 0.3
    """Source "wrench": time at the start whose median is taken off the wrench, in the sensor's axes [s]."""
    momentum: MomentumConfig = dataclasses.field(default_factory=MomentumConfig)
    """Source "momentum": gain, friction and payload of the observer."""

    def __post_init__(self) -> None:
        """Reject a source that is unknown or lacks what it needs."""
        if self.source not in SOURCES:
            raise ConfigError("source of external torque", expected=", ".join(SOURCES), got=self.source)
        if self.source == FIELD and not (self.type.count("/") == 2 and self.field):
            raise ConfigError('external torque from a "field"', expected="type package/msg/Type and a field's name",
                              got=f'type "{self.type}", field "{self.field}"')
        if self.sign not in (1.0, -1.0):
            raise ConfigError("sign of external torque", expected="1 or -1", got=self.sign)
        if not 0.0 <= self.tare_time < math.inf:
            raise ConfigError("tare_time", expected=">= 0 s and finite", got=self.tare_time)
        if not self.topic:
            object.__setattr__(self, "topic", DEFAULT_TOPICS[self.source])


Converter: TypeAlias = Callable[[RobotState, Array], Array | None]
"""Turns the arm's state at a sample's time and the values that came into external torque, shape (n,) [Nm]; None while
that is not known yet."""


def make_converter(robot: RobotModel, config: ExternalTorqueConfig) -> Converter:
    """Build what turns the values of a source into external torque.

    The values are shape (n,) [Nm], or (6,) for a wrench: force [N], then torque [Nm]. Every converter raises ShapeError
    for another shape and InputError for values that are not finite.

    Args:
        robot: The arm.
        config: The source.

    Returns:
        The converter.

    Raises:
        ConfigError: The arm's model lacks the wrench's frame, or a setting of the observer has the wrong length.
    """
    if config.source == WRENCH:
        mapping = WrenchMapping(robot, config.frame or robot.config.tool_frame, config.tare_time)
        return lambda state, values: mapping.torque(state, config.sign * np.asarray(values))
    if config.source == MOMENTUM:
        observer = MomentumObserver(robot, config.momentum)
        return lambda state, values: observer.update(state, config.sign * np.asarray(values))
    return lambda _, values: config.sign * frozen_array("external torque", values, (robot.n,))


class WrenchMapping:
    """Turn the wrench that a sensor at the tool measures into joint torque, tau = J(q)^T F.

    The sensor's offset is the median of its first moments, in its own axes, so that it does not turn with the arm.

    Known weakness: a touch between base and sensor does not show; the weight of a tool behind the sensor turns with the
    arm unless the sensor's driver takes it off.

    Args:
        robot: The arm.
        frame: Frame of the arm's URDF in whose origin and axes the wrench is given.
        tare_time: Time of the first samples [s].

    Raises:
        ConfigError: The arm has no such frame.
    """

    def __init__(self, robot: RobotModel, frame: str, tare_time: float) -> None:
        if not robot.pin_model.existFrame(frame):
            raise ConfigError(f"frame {frame} of a wrench", got=f"a URDF of {robot.config.name} without it",
                              expected=", ".join(f.name for f in robot.pin_model.frames[1:]))
        self._model, self._data = robot.pin_model, robot.pin_model.createData()
        self._frame, self._tare_time = self._model.getFrameId(frame), tare_time
        self._first: list[Array] = []
        self._start: float | None = None
        self._offset: Array | None = None

    @property
    def offset(self) -> Array | None:
        """Offset of the sensor, shape (6,) [N, Nm]; None while it is not known."""
        return self._offset

    def torque(self, state: RobotState, wrench: ArrayLike) -> Array | None:
        """Map one sample.

        Args:
            state: Measured state at the sample's time.
            wrench: Force [N], then torque [Nm], on the arm, origin and axes of the frame, shape (6,).

        Returns:
            External torque, shape (n,) [Nm]; None during the tare.

        Raises:
            ShapeError: Another length.
            InputError: Not finite.
        """
        wrench = frozen_array("wrench", wrench, (6,))
        posture = frozen_array("joint positions", state.positions, (self._model.nq,))
        if self._offset is None:
            self._start = state.time if self._start is None else self._start
            self._first.append(wrench)
            if state.time - self._start < self._tare_time:
                return None
            self._offset, self._first = np.median(self._first, axis=0), []
        jacobian = pin.computeFrameJacobian(self._model, self._data, posture, self._frame, pin.LOCAL)
        return np.asarray(jacobian.T @ (wrench - self._offset))
