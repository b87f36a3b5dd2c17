"""The arm as pinocchio sees it: kinematics, Jacobians, gravity, limits, inverse kinematics."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from unifeed_ros.core.config import load_settings
from unifeed_ros.core.errors import ConfigError, InputError, ShapeError, UnreachableError
from unifeed_ros.core.types import Array, frozen_array

TOOL_STATE = ("x", "y", "z", "axis_x", "axis_y", "axis_z")
"""Names of the six numbers of a tool state: position [m] and direction of the tool's z axis, base frame."""


@dataclass(frozen=True, kw_only=True)
class RobotConfig:
    """One arm: model, tool, limits and gains."""

    name: str
    """Name of the robot, for example "panda"."""
    urdf: str
    """URDF file: an absolute path, or a path below the robots folder of example-robot-data."""
    base_frame: str
    """Frame that positions refer to."""
    tool_frame: str
    """Frame that the person holds and that tasks are about."""
    joints: Sequence[str]
    """Names of the n joints that move, from the base to the tool."""
    seed: Sequence[float]
    """Posture that inverse kinematics starts from, length n [rad]."""
    position_margin: float = 0.05
    """Distance kept from the URDF's position limits [rad]."""
    velocity_limits: Sequence[float] = ()
    """Largest joint speeds while teaching, length n [rad/s]; empty: the URDF's."""
    acceleration_limits: Sequence[float] = ()
    """Largest joint accelerations while teaching, length n [rad/s^2]; empty: 4 rad/s^2."""
    torque_limits: Sequence[float] = ()
    """Largest joint torques, length n [Nm]; empty: the URDF's."""
    stiffness: Sequence[float] = ()
    """Joint stiffness of the impedance controller, length n [Nm/rad]; empty: 100."""
    damping: Sequence[float] = ()
    """Joint damping of the impedance controller, length n [Nm s/rad]; empty: 2 sqrt(stiffness)."""
    tool_stiffness: Sequence[float] = (2500.0, 2500.0, 2500.0, 150.0, 150.0, 150.0)
    """Stiffness at the tool where the impedance is there, three [N/m], then three [Nm/rad]."""
    tool_damping: Sequence[float] = (70.0, 70.0, 70.0, 4.0, 4.0, 4.0)
    """Damping at the tool where the impedance is there, three [N s/m], then three [Nm s/rad]."""
    contact_thresholds: Sequence[float] = ()
    """External torque that counts as a touch, length n [Nm]; empty: 2."""
    friction: Sequence[float] = ()
    """Dry friction of the joints in simulation, length n [Nm]; empty: 0.3."""
    compensates_gravity: bool = False
    """True if the robot's driver adds gravity itself, so that commands go out without it."""

    def __post_init__(self) -> None:
        """Check lengths and fill in the defaults."""
        n = len(self.joints)
        if n == 0:
            raise ConfigError("joints", expected="at least one name", got="none")
        defaults = {"acceleration_limits": 4.0, "stiffness": 100.0, "contact_thresholds": 2.0, "friction": 0.3}
        for name in ("seed", "velocity_limits", "acceleration_limits", "torque_limits", "stiffness", "damping",
                     "contact_thresholds", "friction"):
            values = tuple(float(v) for v in getattr(self, name))
            if not values and name in defaults:
                values = (defaults[name],) * n
            if not values and name == "damping":
                values = tuple(2.0 * float(np.sqrt(k)) for k in self.stiffness)
            if values and len(values) != n:
                raise ConfigError(f"{name} of robot {self.name}", expected=f"{n} numbers, one a joint", got=len(values))
            if not np.isfinite(values).all() or (name != "seed" and min(values, default=1.0) < 0):
                raise ConfigError(f"{name} of robot {self.name}", expected="finite, not negative", got=values)
            object.__setattr__(self, name, values)
        for name in ("tool_stiffness", "tool_damping"):
            values = tuple(float(v) for v in getattr(self, name))
            if len(values) != 6 or not all(0.0 <= v < np.inf for v in values):
                raise ConfigError(f"{name} of robot {self.name}", expected="6 finite numbers, not negative", got=values)
            object.__setattr__(self, name, values)
        object.__setattr__(self, "joints", tuple(self.joints))


def load_robot(path: Path) -> RobotConfig:
    """Read a robot's settings from a ROS 2 parameter file with the group ``robot``.

    Args:
        path: YAML file, for example config/robots/panda.yaml.

    Returns:
        The settings.

    Raises:
        ConfigError: The file is missing or malformed, or a value cannot be used; the message names the file.
    """
    return load_settings(RobotConfig, path, "robot")


def find_urdf(urdf: str) -> Path:
    """Find a URDF file by absolute path or inside the installed example-robot-data.

    Args:
        urdf: Absolute path, or a path below the package's robots folder.

    Returns:
        Path of an existing file.

    Raises:
        ConfigError: No such file.
    """
    roots = [Path(p) for p in sys.path if p]
    candidates = [Path(urdf)] if Path(urdf).is_absolute() else [
        folder / "share/example-robot-data/robots" / urdf
        for root in roots for folder in (root / "cmeel.prefix", root.parents[2] if len(root.parents) > 2 else root)
    ]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise ConfigError(f"URDF {urdf} is missing", mend="install example-robot-data, or give an absolute path")


class RobotModel:
    """Kinematics and dynamics of one arm, all other joints of its URDF locked at their neutral position.

    Attributes:
        config: The settings that it was built from.
        lower, upper: Joint limits with the margin taken off, shape (n,) [rad].
        velocity_limits, acceleration_limits, torque_limits: Shape (n,) [rad/s], [rad/s^2], [Nm].
    """

    def __init__(self, config: RobotConfig) -> None:
        """Load the URDF.

        Raises:
            ConfigError: The URDF is missing or unreadable, or lacks a joint or the tool frame.
        """
        self.config = config
        self.urdf_path = find_urdf(config.urdf)
        try:
            full = pin.buildModelFromUrdf(str(self.urdf_path))
        except Exception as error:  # pinocchio raises ValueError and RuntimeError, by the parser's mood
            raise ConfigError(f"URDF {self.urdf_path} cannot be read", got=str(error)) from error
        missing = [j for j in config.joints if not full.existJointName(j)]
        if missing or not full.existFrame(config.tool_frame):
            raise ConfigError(f"URDF {self.urdf_path} lacks", got=", ".join(missing) or config.tool_frame)
        locked = [i for i, name in enumerate(full.names) if i > 0 and name not in config.joints]
        self.pin_model = pin.buildReducedModel(full, locked, pin.neutral(full))
        if tuple(self.pin_model.names[1:]) != tuple(config.joints):
            raise ConfigError("order of joints", expected=tuple(self.pin_model.names[1:]), got=tuple(config.joints))
        self._data = self.pin_model.createData()
        self._tool = self.pin_model.getFrameId(config.tool_frame)
        model = self.pin_model
        self.lower = frozen_array("lower limits", model.lowerPositionLimit + config.position_margin, (self.n,))
        self.upper = frozen_array("upper limits", model.upperPositionLimit - config.position_margin, (self.n,))
        self.velocity_limits = frozen_array("velocity limits", config.velocity_limits or model.velocityLimit, (self.n,))
        self.acceleration_limits = frozen_array("acceleration limits", config.acceleration_limits, (self.n,))
        self.torque_limits = frozen_array("torque limits", config.torque_limits or model.effortLimit, (self.n,))

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.pin_model.nq)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the joints, from the base to the tool."""
        return tuple(self.config.joints)

    def tool_pose(self, q: ArrayLike) -> tuple[Array, Array]:
        """Compute the tool's pose in the base frame.

        Args:
            q: Joint positions, shape (n,) [rad].

        Returns:
            Position, shape (3,) [m], and rotation matrix, shape (3, 3).
        """
        pin.framesForwardKinematics(self.pin_model, self._data, np.asarray(q, dtype=np.float64))
        pose = self._data.oMf[self._tool]
        return pose.translation.copy(), pose.rotation.copy()

    def tool_jacobian(self, q: ArrayLike) -> Array:
        """Compute the Jacobian of the tool at its origin, axes of the base frame.

        Args:
            q: Joint positions, shape (n,) [rad].

        Returns:
            Jacobian, shape (6, n): linear rows [m/rad], then angular rows [rad/rad].
        """
        q = np.asarray(q, dtype=np.float64)
        return np.array(pin.computeFrameJacobian(self.pin_model, self._data, q, self._tool, pin.LOCAL_WORLD_ALIGNED))

    def tool_states(self, q: ArrayLike) -> Array:
        """Compute tool states (see TOOL_STATE) for many postures.

        Args:
            q: Joint positions, shape (N, n) [rad].

        Returns:
            Tool states, shape (N, 6) [m, 1].

        Raises:
            ShapeError: Another number of joints.
        """
        q = self._postures(q)
        states = np.empty((len(q), 6))
        for k, posture in enumerate(q):
            pin.framesForwardKinematics(self.pin_model, self._data, posture)
            pose = self._data.oMf[self._tool]
            states[k, :3] = pose.translation
            states[k, 3:] = pose.rotation[:, 2]
        return states

    def tool_states_and_jacobians(self, q: ArrayLike) -> tuple[Array, Array]:
        """Compute tool states and their derivatives for many postures.

        Args:
            q: Joint positions, shape (N, n) [rad].

        Returns:
            Tool states, shape (N, 6) [m, 1], and their Jacobians, shape (N, 6, n) [m/rad, 1/rad].

        Raises:
            ShapeError: Another number of joints.
        """
        q = self._postures(q)
        states, jacobians = np.empty((len(q), 6)), np.empty((len(q), 6, self.n))
        for k, posture in enumerate(q):
            jacobian = pin.computeFrameJacobian(
                self.pin_model, self._data, posture, self._tool, pin.LOCAL_WORLD_ALIGNED)
            pose = pin.updateFramePlacement(self.pin_model, self._data, self._tool)
            axis = pose.rotation[:, 2]
            states[k, :3], states[k, 3:] = pose.translation, axis
            jacobians[k, :3] = jacobian[:3]
            jacobians[k, 3:] = np.cross(jacobian[3:], axis, axisa=0, axisc=0)  # d(axis)/dt = omega x axis
        return states, jacobians

    def gravity(self, q: ArrayLike) -> Array:
        """Compute the torques that hold the arm against gravity.

        Args:
            q: Joint positions, shape (n,) [rad].

        Returns:
            Torques, shape (n,) [Nm].
        """
        torques = pin.computeGeneralizedGravity(self.pin_model, self._data, np.asarray(q, dtype=np.float64))
        return np.array(torques)

    def inverse_kinematics(self, position: ArrayLike, axis: ArrayLike = (0.0, 0.0, -1.0),
                           seed: ArrayLike | None = None) -> Array:
        """Find a posture that puts the tool at a position with its z axis along a direction.

        Damped least squares on the five task dimensions, with a weak pull towards the seed in the null space.

        Args:
            position: Tool position in the base frame, shape (3,) [m].
            axis: Direction of the tool's z axis in the base frame, shape (3,); the default is tool-down.
            seed: Posture to start from, shape (n,) [rad]; the robot's own seed by default.

        Returns:
            Joint positions inside the limits, shape (n,) [rad].

        Raises:
            UnreachableError: No posture within the limits comes closer than 0.1 mm and 1 mrad.
        """
        position, axis = frozen_array("position", position, (3,)), frozen_array("axis", axis, (3,))
        target = np.concatenate([position, axis / np.linalg.norm(axis)])
        start = np.array(self.config.seed if seed is None else seed, dtype=np.float64)
        rng = np.random.default_rng(0)
        error = np.full(6, np.inf)
        for attempt in range(12):
            q = start if attempt == 0 else start + rng.normal(scale=0.1 * attempt, size=self.n)
            q = np.clip(q, self.lower, self.upper)
            for _ in range(200):
                state, jacobian = self.tool_states_and_jacobians(q[None])
                error = target - state[0]
                if np.linalg.norm(error[:3]) < 1e-4 and np.linalg.norm(error[3:]) < 1e-3:
                    return q
                inverse = jacobian[0].T @ np.linalg.inv(jacobian[0] @ jacobian[0].T + 1e-4 * np.eye(6))
                step = inverse @ error + 0.05 * (np.eye(self.n) - inverse @ jacobian[0]) @ (start - q)
                q = np.clip(q + step * min(1.0, 0.3 / float(np.abs(step).max())), self.lower, self.upper)
        raise UnreachableError(
            f"position {np.round(position, 3).tolist()} m is out of reach of {self.config.name}",
            got=f"{np.linalg.norm(error[:3]):.3f} m short", mend="choose a position inside the arm's workspace")

    def require_state(self, q: ArrayLike, what: str = "joint positions") -> Array:
        """Check one posture: length, finiteness and the URDF's position limits.

        Args:
            q: Joint positions, shape (n,) [rad].
            what: Name of the posture, for the error.

        Returns:
            The posture, read-only, shape (n,) [rad].

        Raises:
            ShapeError: Another number of joints.
            InputError: Not finite, or outside the limits.
        """
        posture = frozen_array(what, q, (self.n,))
        margin = self.config.position_margin
        outside = np.maximum(self.lower - margin - posture, posture - self.upper - margin)
        worst = int(np.argmax(outside))
        if outside[worst] > 1e-6:
            raise InputError(f"{what}: joint {self.joint_names[worst]} is outside its limits",
                             expected=f"{self.lower[worst] - margin:.3f} to {self.upper[worst] + margin:.3f} rad",
                             got=f"{posture[worst]:.3f} rad")
        return posture

    def _postures(self, q: ArrayLike) -> Array:
        q = np.asarray(q, dtype=np.float64)
        if q.ndim != 2 or q.shape[1] != self.n:
            raise ShapeError("shape of joint positions", expected=f"(any, {self.n})", got=q.shape)
        return q
