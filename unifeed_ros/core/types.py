"""Data that several layers share: frozen, checked when made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from unifeed_ros.core.errors import InputError, ShapeError

Array = NDArray[np.float64]


def frozen_array(what: str, values: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """Copy values into a read-only float array and check it.

    Args:
        what: Name of the values, for the error.
        values: Anything that numpy makes an array of.
        shape: Expected shape; None where any length will do.

    Returns:
        Read-only copy, shape as given.

    Raises:
        ShapeError: Another number of dimensions, or another length.
        InputError: A value is not finite.
    """
    array = np.array(values, dtype=np.float64)
    if array.ndim != len(shape) or any(s is not None and s != n for s, n in zip(shape, array.shape, strict=True)):
        wanted = "(" + ", ".join("any" if s is None else str(s) for s in shape) + ")"
        raise ShapeError(f"shape of {what}", expected=wanted, got=array.shape)
    if not np.isfinite(array).all():
        raise InputError(
            f"{what} is not finite", expected="numbers", got=f"{int((~np.isfinite(array)).sum())} NaN or inf"
        )
    array.flags.writeable = False
    return array


@dataclass(frozen=True, kw_only=True)
class Trajectory:
    """Joint positions over time."""

    joint_names: tuple[str, ...]
    """Names of the n joints, in the order of the columns."""
    times: Array
    """Time of each point, shape (N,), N >= 2, strictly increasing [s]."""
    positions: Array
    """Joint positions, shape (N, n) [rad]."""
    velocities: Array | None = None
    """Joint velocities, shape (N, n) [rad/s]."""
    accelerations: Array | None = None
    """Joint accelerations, shape (N, n) [rad/s^2]."""

    def __post_init__(self) -> None:
        """Check shapes, order and finiteness."""
        times = frozen_array("times", self.times, (None,))
        if len(times) < 2 or not (np.diff(times) > 0).all():
            raise InputError(
                "times of a trajectory", expected="at least two, strictly increasing", got=f"{len(times)} points"
            )
        shape = (len(times), len(self.joint_names))
        object.__setattr__(self, "joint_names", tuple(self.joint_names))
        object.__setattr__(self, "times", times)
        object.__setattr__(self, "positions", frozen_array("positions", self.positions, shape))
        for name in ("velocities", "accelerations"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, frozen_array(name, getattr(self, name), shape))

    @property
    def duration(self) -> float:
        """Time from the first point to the last [s]."""
        return float(self.times[-1] - self.times[0])

    def positions_at(self, times: ArrayLike) -> Array:
        """Interpolate the joint positions linearly, holding the ends.

        Args:
            times: Times, shape (K,) [s].

        Returns:
            Joint positions, shape (K, n) [rad].
        """
        times = np.asarray(times, dtype=np.float64)
        return np.stack([np.interp(times, self.times, column) for column in self.positions.T], axis=-1)

    def resampled(self, count: int) -> Array:
        """Sample the joint positions at evenly spaced times, both ends included.

        Args:
            count: Number of points, at least 2.

        Returns:
            Joint positions, shape (count, n) [rad].
        """
        return self.positions_at(np.linspace(self.times[0], self.times[-1], count))


@dataclass(frozen=True, kw_only=True)
class Context:
    """What the robot knows of the scene; part of the state that rewards are learned over."""

    goal: Array
    """Goal of the tool in the base frame, shape (3,) [m]."""
    task: str = ""
    """Name of the task."""
    objects: Mapping[str, Array] = field(default_factory=dict)
    """Positions of named objects in the base frame, shape (3,) each [m]."""

    def __post_init__(self) -> None:
        """Check shapes and finiteness."""
        object.__setattr__(self, "goal", frozen_array("goal", self.goal, (3,)))
        checked = {name: frozen_array(f"position of {name}", p, (3,)) for name, p in self.objects.items()}
        object.__setattr__(self, "objects", checked)


@dataclass(frozen=True, kw_only=True)
class RobotState:
    """One sample of the arm's sensors."""

    time: float
    """Stamp of the sample [s]."""
    positions: Array
    """Joint positions, shape (n,) [rad]."""
    velocities: Array
    """Joint velocities, shape (n,) [rad/s]."""
