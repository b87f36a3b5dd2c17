"""What a simulated person wants the tool to do: a tool path over time, with human error."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Trajectory, frozen_array


@dataclass(frozen=True, kw_only=True)
class Wish:
    """A tool path over time, which the person would like to see."""

    times: Array
    """Times from zero on, shape (N,) [s]."""
    positions: Array
    """Tool positions in the base frame, shape (N, 3) [m]."""
    axes: Array
    """Directions of the tool's z axis in the base frame, shape (N, 3)."""

    def __post_init__(self) -> None:
        """Check shapes and finiteness."""
        count = len(self.times)
        object.__setattr__(self, "times", frozen_array("times", self.times, (None,)))
        for name in ("positions", "axes"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (count, 3)))

    @property
    def duration(self) -> float:
        """Time of the last point [s]."""
        return float(self.times[-1])

    def states_at(self, times: ArrayLike) -> Array:
        """Interpolate tool states, holding the ends.

        Args:
            times: Times, shape (K,) [s].

        Returns:
            Tool states, shape (K, 6) [m, 1]; the axes are unit vectors.
        """
        columns = np.concatenate([self.positions, self.axes], axis=1).T
        at = np.asarray(times, dtype=np.float64)
        states = np.stack([np.interp(at, self.times, column) for column in columns], axis=-1)
        states[:, 3:] /= np.linalg.norm(states[:, 3:], axis=1, keepdims=True)
        return states

    def velocity_at(self, time: float) -> Array:
        """Estimate the tool's velocity by a difference over 20 ms.

        Args:
            time: Time [s].

        Returns:
            Velocity, shape (3,) [m/s].
        """
        before, after = self.states_at([time - 0.01, time + 0.01])[:, :3]
        return np.asarray((after - before) / 0.02)

    def slower(self, factor: float) -> Wish:
        """Stretch time.

        Args:
            factor: How much longer it takes [1].

        Returns:
            The same path at another pace.
        """
        return Wish(times=self.times * factor, positions=self.positions, axes=self.axes)

    def deviating(self, deviation: Callable[[Array], Array], turning: Callable[[Array], Array], lowest: float) -> Wish:
        """Add a deviation to the positions and one to the axes.

        Args:
            deviation: Gives the offsets, shape (N, 3) [m], at shares of the path's length, shape (N,), 0 to 1.
            turning: Gives what is added to the axes, shape (N, 3) [rad], before they are brought back to unit length.
            lowest: Height that the tool does not go below [m].

        Returns:
            The path with the deviation.
        """
        steps = np.linalg.norm(np.diff(self.positions, axis=0), axis=1)
        length = np.concatenate([[0.0], np.cumsum(steps)])
        shares = length / max(length[-1], 1e-9)
        positions, axes = self.positions + deviation(shares), self.axes + turning(shares)
        positions[:, 2] = np.maximum(positions[:, 2], lowest)
        return Wish(times=self.times, positions=positions, axes=axes / np.linalg.norm(axes, axis=1, keepdims=True))


def wish_along(robot: RobotModel, motion: Trajectory, axis: ArrayLike, goal: ArrayLike | None = None) -> Wish:
    """Take the path of the tool's position from a motion, the tool held upright all the way.

    No task is done better by tilting the tool, but an arm that moves as fast as it can may tilt it on the way; a person
    does not copy that.

    Args:
        robot: The arm.
        motion: Motion that the person wants.
        axis: Direction in which the person holds the tool's z axis, shape (3,).
        goal: Where to end, shape (3,) [m]: what comes after the tool has come within 1 cm for good is left out.

    Returns:
        The tool path, its times from zero on.
    """
    times = np.arange(0.0, motion.duration, 0.01)
    states = robot.tool_states(motion.positions_at(motion.times[0] + times))
    if goal is not None:
        far = np.flatnonzero(np.linalg.norm(states[:, :3] - np.asarray(goal), axis=1) > 0.01)
        end = min(int(far[-1]) + 2 if len(far) else 2, len(times))
        times, states = times[:end], states[:end]
    return Wish(times=times, positions=states[:, :3], axes=np.tile(np.asarray(axis, dtype=np.float64), (len(times), 1)))


def smooth_deviation(rng: np.random.Generator, size: float, start: ArrayLike = (0.0, 0.0, 0.0),
                     end: ArrayLike = (0.0, 0.0, 0.0), modes: int = 3) -> Callable[[Array], Array]:
    """Draw one smooth human error along a path.

    d(s) = (1 - s) start + s end + sum_k (c_k / k) sin(k pi s), with c_k normal in each direction.

    Args:
        rng: Source of randomness.
        size: Standard deviation of c_k [m].
        start: Offset at the start, shape (3,) [m].
        end: Offset at the end, shape (3,) [m].
        modes: Number of modes.

    Returns:
        The deviation by the share of the path's length, for Wish.deviating.
    """
    order = np.arange(1, modes + 1)
    amplitudes = rng.normal(scale=size, size=(modes, 3)) / order[:, None]
    ends = np.stack([np.asarray(start, dtype=np.float64), np.asarray(end, dtype=np.float64)])

    def deviation(share: Array) -> Array:
        waves = np.sin(np.pi * share[:, None] * order)
        return np.asarray(waves @ amplitudes + np.stack([1.0 - share, share], axis=1) @ ends)

    return deviation
