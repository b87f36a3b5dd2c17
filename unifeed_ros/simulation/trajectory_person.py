"""A simulated person who acts on trajectories: kinematics and a model of human error instead of an arm and a hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.feedback.deformation import deform_tool_states, sample_deformations
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.features import Feature, make_feature
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.simulation.person import PersonConfig, SimulatedPerson
from unifeed_ros.simulation.tasks import Yardstick

WORKSPACE = ((0.2, -0.5, 0.05), (0.75, 0.5, 0.6))
"""Corners of the box in which people show features [m]; the references' workspace."""
_POINTS = 61
"""Points of a motion that a person makes."""
_DAMPING = 1e-3
"""Damping of the joint displacements that move the tool as wanted [m^2]."""
_DESCENT = 0.01
"""Step along a feature's gradient while showing it [m, or about as many rad]."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryPersonConfig:
    """How good a simulated person is."""

    error: float = 0.02
    """Size of the smooth error of a demonstration, in each direction (RMS of the middle) [m]."""
    correcting_error: float = 0.01
    """The same for a correction, which minds a part of the motion only [m]."""
    axis_error: float = 0.03
    """Size of the smooth error in the tool's direction [rad]."""
    pace: float = 1.15
    """How much longer than the optimum a demonstration takes, at the median [1]."""
    pace_spread: float = 0.1
    """Standard deviation of the logarithm of the pace [1]."""
    correction_span: float = 1.5
    """Duration of a correction [s]."""
    ramp: float = 0.25
    """How long the person takes to bring the arm from its own motion to theirs, and back [s]."""
    trace_error: float = 0.01
    """Size of the smooth error of a feature trace, in each direction [m]."""
    trace_points: int = 15
    """States that a feature trace is kept as."""
    trace_starts: int = 30
    """Places that the person considers for the start of a trace, those where the feature is largest."""
    trace_ways: int = 5
    """Of these, how many the person looks on from, to choose the one from where the feature falls the farthest."""
    trace_tilt: float = 0.5
    """Standard deviation of the tilt of the tool at these places, in each direction [rad]."""

    def __post_init__(self) -> None:
        """Reject values that no person has."""
        for name in ("pace", "correction_span", "ramp"):
            if not getattr(self, name) > 0:
                raise ConfigError(f"{name} of the person", expected="> 0", got=getattr(self, name))
        for name in ("error", "correcting_error", "axis_error", "pace_spread", "trace_error", "trace_tilt"):
            if not getattr(self, name) >= 0:
                raise ConfigError(f"{name} of the person", expected=">= 0", got=getattr(self, name))
        if self.trace_points < 2 or not 1 <= self.trace_ways <= self.trace_starts:
            raise ConfigError("traces of the person", expected="2 points and 1 start at least",
                              got=(self.trace_points, self.trace_ways, self.trace_starts))


class TrajectoryPerson:
    """Knows the true reward and its optimum, and shows, corrects and ranks motions with human error.

    Noise model: an error is a smooth deformation (paper eqs. M1, M2, both ends fixed) of the tool's position and
    direction, drawn anew each time, which the joints follow by the damped least-squares inverse of the Jacobian. The
    same seed and the same calls give the same items. Known weakness: the optimum is known to the size of the error, and
    nobody gets tired or learns.
    """

    def __init__(self, yardstick: Yardstick, seed: Sequence[int], config: TrajectoryPersonConfig | None = None) -> None:
        """Make up the person's mind.

        Args:
            yardstick: The arm, the true reward, and the best motion for it.
            seed: Seed of everything that this person draws; each kind of feedback has a source of its own.
            config: How good the person is.
        """
        self.config = config or TrajectoryPersonConfig()
        self._yardstick = yardstick
        self._showing, self._correcting, self._tracing, ranking = (
            np.random.default_rng([*seed, k]) for k in range(4))
        self._ranker = SimulatedPerson(yardstick, int(ranking.integers(2**31)), PersonConfig())
        scene = yardstick.task.scene
        self._common: dict[str, Any] = {"robot": yardstick.robot.config.name, "context": scene.context()}

    def demonstrate(self, name: str) -> Demonstration:
        """Show a whole motion: the optimum, at a human pace, with human error.

        Args:
            name: Id of the item.

        Returns:
            The demonstration.
        """
        rng, config, optimum = self._showing, self.config, self._yardstick.optimum
        pace = config.pace * float(np.exp(rng.normal(scale=config.pace_spread)))
        shown = self._erring(optimum, config.error, rng)
        return Demonstration(id=name, **self._common, trajectory=Trajectory(
            joint_names=shown.joint_names, times=pace * shown.times, positions=shown.positions))

    def correct(self, name: str, planned: Trajectory) -> Correction:
        """Correct the part of a motion that falls furthest short of what the person wants, however near that is.

        The arm is brought from its motion to the person's own wish at that time, led along it, and let go.

        Args:
            name: Id of the item.
            planned: The robot's motion.

        Returns:
            The correction.
        """
        config, yardstick = self.config, self._yardstick
        wish = self._erring(yardstick.optimum, config.correcting_error, self._correcting)
        times = np.linspace(0.0, planned.duration, _POINTS)
        meant, wanted = planned.positions_at(planned.times[0] + times), wish.positions_at(times)
        width = min(round(config.correction_span / (times[1] - times[0])) + 1, _POINTS)
        short = [yardstick.task.rewards(yardstick.robot.tool_states(q)) for q in (wanted, meant)]
        worst = int(np.argmax(sliding_window_view(short[0] - short[1], width).mean(axis=1)))
        span = slice(worst, worst + width)
        within = times[span] - times[worst]
        grip = np.clip(np.minimum(within, within[-1] - within) / config.ramp, 0.0, 1.0)
        grip = (grip * grip * (3.0 - 2.0 * grip))[:, None]
        corrected = meant[span] + grip * (wanted[span] - meant[span])
        before, after = (Trajectory(joint_names=planned.joint_names, times=times[span], positions=q)
                         for q in (meant[span], corrected))
        return Correction(id=name, **self._common, planned=before, corrected=after,
                          span=(float(times[worst]), float(times[worst + width - 1])))

    def rank(self, name: str, options: Sequence[Trajectory]) -> Preference:
        """Rank motions, noisily rational (SimulatedPerson.rank).

        Args:
            name: Id of the item.
            options: Motions to compare, at least two.

        Returns:
            The ranking.
        """
        return Preference(id=name, **self._common, options=tuple(options), ranks=self._ranker.rank(options))

    def trace(self, feature: str) -> Array:
        """Show a feature: from where there is much of it straight to where there is least within reach.

        Args:
            feature: Name of the feature, as in core/reward/features.py.

        Returns:
            Tool states, shape (trace_points, 6) [m, 1].
        """
        rng, config = self._tracing, self.config
        measure = make_feature(feature, self._common["context"])
        starts = _random_states(rng, config.trace_starts, self._yardstick.task.scene.axis, config.trace_tilt)
        highest = starts[np.argsort(-measure(starts)[0], kind="stable")[:config.trace_ways]]
        path = max((_descend(measure, start) for start in highest),
                   key=lambda way: float(np.subtract(*measure(way[[0, -1]])[0])))
        even = np.linspace(0.0, len(path) - 1.0, config.trace_points)
        states = np.stack([np.interp(even, np.arange(len(path)), column) for column in path.T], axis=-1)
        return deform_tool_states(_unit(states), [config.trace_error], [config.axis_error], rng)[0]

    def _erring(self, motion: Trajectory, size: float, rng: np.random.Generator) -> Trajectory:
        """Add human error to a motion; times begin at zero."""
        times = np.linspace(0.0, motion.duration, _POINTS)
        positions = erring(self._yardstick.robot, motion.resampled(_POINTS), size, self.config.axis_error, rng)
        return Trajectory(joint_names=motion.joint_names, times=times, positions=positions)


def erring(robot: RobotModel, positions: Array, size: float, axis_size: float, rng: np.random.Generator) -> Array:
    """Deform a motion smoothly, both ends fixed, as a person would err.

    Args:
        robot: The arm.
        positions: Joint positions along the motion, evenly timed, shape (H, n) [rad].
        size: Root-mean-square error of the middle in each direction [m].
        axis_size: The same for the tool's direction [rad].
        rng: Source of randomness.

    Returns:
        Joint positions within their limits, shape (H, n) [rad].
    """
    _, jacobians = robot.tool_states_and_jacobians(positions)
    shifts = sample_deformations(len(positions), [*[size] * 3, *[axis_size] * 3], rng)
    damped = jacobians @ jacobians.transpose(0, 2, 1) + _DAMPING * np.eye(6)
    bends = jacobians.transpose(0, 2, 1) @ np.linalg.solve(damped, shifts[..., None])
    return np.clip(positions + bends[..., 0], robot.lower, robot.upper)


def _random_states(rng: np.random.Generator, count: int, axis: Array, tilt: float) -> Array:
    """Draw places in the workspace and directions near the given one."""
    places = rng.uniform(*WORKSPACE, size=(count, 3))
    return _unit(np.concatenate([places, axis + rng.normal(scale=tilt, size=(count, 3))], axis=1))


def _descend(feature: Feature, start: Array) -> Array:
    """Follow a feature's gradient down until it is least or the workspace ends; two states at least."""
    path = [start]
    while True:
        state = path[-1]
        (value,), (slope,) = feature(state[None])
        steep = float(np.linalg.norm(slope))
        if value <= 0.0 or steep == 0.0:
            break
        step = min(_DESCENT, float(value) / steep)
        following = state - step * slope / steep
        following[:3] = np.clip(following[:3], *WORKSPACE)
        following = _unit(following[None])[0]
        if feature(following[None])[0][0] > value - 0.1 * step * steep:
            break
        path.append(following)
    return np.stack([*path, path[-1]] if len(path) == 1 else path)


def _unit(states: Array) -> Array:
    """Bring the axes of tool states to unit length."""
    states[:, 3:] /= np.linalg.norm(states[:, 3:], axis=1, keepdims=True)
    return states
