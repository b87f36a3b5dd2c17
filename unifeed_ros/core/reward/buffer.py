"""The comparisons that the networks learn from: Algorithm 1's rankings buffer, as arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.deformation import (
    DeformationShape,
    Ends,
    Noise,
    Norm,
    deform_tool_states,
    delay,
    shortcuts,
)
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem
from unifeed_ros.core.reward.inputs import input_names, scene_inputs
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory

Inputs = NDArray[np.float32]
Indices = NDArray[np.int64]

SHORTEST_PATH = 0.005
"""Length of the tool's path below which it counts as standing still [m]."""


@dataclass(frozen=True, kw_only=True)
class AlternativesConfig:
    """How the alternatives of a shown motion are drawn (paper eq. M1)."""

    position_sizes: Sequence[float] = (0.02, 0.05, 0.1, 0.2, 0.3)
    """Sizes of the tool's displacement, one drawn for each alternative (RMS of the middle in each coordinate) [m]. A
    free end moves further than the middle: only the smallest size says where near the goal the best place is."""
    axis_sizes: Sequence[float] = (0.1, 0.3, 1.0)
    """Sizes of the tilt of the tool's axis, one drawn for each alternative that tilts [rad]. As large as an arm can
    tilt: a pushed arm tilts by 45 degrees, and beyond what was compared the reward runs on in that direction."""
    axis_share: float = 0.3
    """Share of alternatives that tilt the axis, half of them without moving the tool: what matters must show alone."""
    delay_sizes: Sequence[float] = (0.05, 0.1, 0.2)
    """Sizes of the delay, one drawn for each alternative that is delayed [share of the whole motion]."""
    delay_share: float = 0.3
    """Share of alternatives that follow the shown path but fall behind: without them the reward peaks somewhere on
    the path, and the planner waits there."""
    free_end_share: float = 0.5
    """Share of a demonstration's alternatives whose end moves too, so that the goal itself is learned."""
    shortcut_share: float = 0.3
    """Share of a demonstration's alternatives that cut one of its corners, if it has any: who led the arm around
    something did so on purpose."""
    shortcut_size: float = 0.2
    """Least displacement of a shortcut [m]: bends of less may be what a hand was off by."""
    norm: Norm = "acceleration"
    """What of an alternative's difference is small, as in eq. M2: its velocity, acceleration or jerk."""
    noise: Noise = "gaussian"
    """Whether an alternative is pushed everywhere (gaussian) or, in each coordinate, at one place (impulse)."""

    @property
    def shape(self) -> DeformationShape:
        """Norm and noise."""
        return DeformationShape(norm=self.norm, noise=self.noise)

    def __post_init__(self) -> None:
        """Reject words, sizes and shares that mean nothing."""
        DeformationShape(norm=self.norm, noise=self.noise)
        for name in ("position_sizes", "axis_sizes", "delay_sizes"):
            sizes = tuple(float(s) for s in getattr(self, name))
            if not sizes or not all(0.0 < s < 10.0 for s in sizes):
                raise ConfigError(name, expected="sizes above 0 and below 10", got=sizes)
            object.__setattr__(self, name, sizes)
        if not 0.0 < self.shortcut_size < 10.0:
            raise ConfigError("shortcut_size", expected="above 0 and below 10", got=self.shortcut_size)
        for name in ("axis_share", "delay_share", "free_end_share", "shortcut_share"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(name, expected="0 to 1", got=getattr(self, name))


@dataclass(frozen=True, kw_only=True)
class RankingsBuffer:
    """Motions as network inputs, and which is better than which (paper Algorithm 1's B).

    H states a motion, I inputs a state; A motions that people or the robot really showed.
    """

    inputs: tuple[str, ...]
    """Names of the inputs, length I."""
    shown: Inputs
    """Motions that were shown, shape (A, H, I)."""
    demonstrated: Indices
    """Which of them are demonstrations, shape (D,)."""
    corrected: Indices
    """Which are corrected spans, shape (C,)."""
    planned: Indices
    """What the robot meant to do in those spans, shape (C,)."""
    better: Indices
    """Better option of each ranked pair, shape (P,)."""
    worse: Indices
    """Worse option of each ranked pair, shape (P,)."""
    demonstration_alternatives: Inputs
    """Deformations of each demonstration, shape (D, N_d, H, I)."""
    correction_alternatives: Inputs
    """Deformations of each corrected span, shape (C, N_c, H, I)."""


def build_buffer(dataset: FeedbackDataset, robot: RobotModel, *, waypoints: int, demonstration_alternatives: int,
                 correction_alternatives: int, config: AlternativesConfig, rng: np.random.Generator,
                 features: Sequence[str] = ()) -> RankingsBuffer:
    """Fill Algorithm 1's buffer from everything that was taught.

    Each motion is sampled at evenly spaced times, each corrected span at evenly spaced lengths of its path, into the
    same number of states.

    Args:
        dataset: What was taught.
        robot: The arm that was taught.
        waypoints: States a motion H.
        demonstration_alternatives: Alternatives of each demonstration N_d.
        correction_alternatives: Alternatives of each correction N_c.
        config: How alternatives are drawn.
        rng: Source of randomness.
        features: Features that are given, as written in the settings.

    Returns:
        The buffer.

    Raises:
        TrainingError: Nothing was taught that a comparison can be made from.
    """
    return build_buffers(dataset, robot, waypoints=waypoints, config=config, rng=rng, features=features,
                         alternatives=[(demonstration_alternatives, correction_alternatives)])[0]


def build_buffers(dataset: FeedbackDataset, robot: RobotModel, *, waypoints: int, config: AlternativesConfig,
                  alternatives: Sequence[tuple[int, int]], rng: np.random.Generator,
                  features: Sequence[str] = ()) -> list[RankingsBuffer]:
    """Fill several buffers, alike but for the alternatives, which each draws anew.

    Args:
        dataset: What was taught.
        robot: The arm that was taught.
        waypoints: States a motion H.
        config: How alternatives are drawn.
        alternatives: Alternatives of each demonstration N_d and of each correction N_c, for each buffer.
        rng: Source of randomness.
        features: Features that are given, as written in the settings.

    Returns:
        The buffers.

    Raises:
        TrainingError: Nothing was taught that a comparison can be made from.
    """
    filler = _Filler(dataset.comparisons(), robot, waypoints, config, rng, features)
    return [filler.fill(*counts) for counts in alternatives]


class _Filler:
    """Collects motions one after the other, so that an item's motions and alternatives share its scene."""

    def __init__(self, items: Sequence[FeedbackItem], robot: RobotModel, waypoints: int, config: AlternativesConfig,
                 rng: np.random.Generator, features: Sequence[str]) -> None:
        self._items, self._robot, self._waypoints, self._config, self._rng = items, robot, waypoints, config, rng
        self._names = input_names([item.context for item in items], features)
        self._shown: list[Inputs] = []
        self._sampled: dict[tuple[int, str], Array] = {}

    def fill(self, demonstration_count: int, correction_count: int) -> RankingsBuffer:
        self._shown = []
        demonstrated, corrected, planned, better, worse = [], [], [], [], []
        demonstration_alternatives: list[Inputs] = []
        correction_alternatives: list[Inputs] = []
        for item in self._items:
            if isinstance(item, Demonstration):
                states = self._sample(item.trajectory, self._states)
                demonstrated.append(self._show(states, item.context))
                cut = self._cut(states, item.context, demonstration_count)
                demonstration_alternatives += [cut, *self._vary(
                    states, item.context, demonstration_count - len(cut), self._config.free_end_share)]
            elif isinstance(item, Correction):
                # by length: where a hand leads matters, how long the arm waits for it does not
                by_hand, by_plan = (self._sample(t, self._states_by_length) for t in (item.corrected, item.planned))
                corrected.append(self._show(by_hand, item.context))
                planned.append(self._show(by_plan, item.context))
                correction_alternatives += self._vary(by_hand, item.context, correction_count, 0.0)
            else:
                options = [self._show(self._sample(option, self._states), item.context) for option in item.options]
                better += [options[i] for i, _ in item.ranked_pairs]
                worse += [options[j] for _, j in item.ranked_pairs]
        return RankingsBuffer(
            inputs=self._names, shown=np.stack(self._shown), demonstrated=_indices(demonstrated),
            corrected=_indices(corrected), planned=_indices(planned), better=_indices(better), worse=_indices(worse),
            demonstration_alternatives=self._stack(demonstration_alternatives, demonstration_count),
            correction_alternatives=self._stack(correction_alternatives, correction_count))

    def _show(self, states: Array, context: Context) -> int:
        self._shown.append(self._inputs(states, context))
        return len(self._shown) - 1

    def _sample(self, trajectory: Trajectory, sampler: Callable[[Trajectory], Array]) -> Array:
        """Sample a motion once, however many buffers hold it."""
        key = (id(trajectory), sampler.__name__)
        if key not in self._sampled:
            self._sampled[key] = sampler(trajectory)
        return self._sampled[key]

    def _states(self, trajectory: Trajectory) -> Array:
        return self._robot.tool_states(trajectory.resampled(self._waypoints))

    def _states_by_length(self, trajectory: Trajectory) -> Array:
        """Sample tool states at evenly spaced lengths of the tool's path; at even times where it hardly moves."""
        dense = self._robot.tool_states(trajectory.resampled(5 * self._waypoints))
        length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(dense[:, :3], axis=0), axis=1))])
        if length[-1] < SHORTEST_PATH:
            return self._states(trajectory)
        even = np.linspace(0.0, length[-1], self._waypoints)
        states = np.stack([np.interp(even, length, column) for column in dense.T], axis=-1)
        states[:, 3:] /= np.linalg.norm(states[:, 3:], axis=1, keepdims=True)
        return states

    def _inputs(self, states: Array, context: Context) -> Inputs:
        return scene_inputs(self._names, context).values(states).astype(np.float32)

    def _vary(self, states: Array, context: Context, count: int, free_share: float) -> list[Inputs]:
        free = round(free_share * count)
        parts: list[tuple[Ends, int]] = [("free", free), ("fixed", count - free)]
        return [self._inputs(drawn, context) for ends, part in parts for drawn in self._draw(states, part, ends)]

    def _cut(self, states: Array, context: Context, count: int) -> Inputs:
        config = self._config
        drawn = shortcuts(states, round(config.shortcut_share * count), config.shortcut_size, self._rng)
        return self._inputs(drawn, context)

    def _draw(self, states: Array, count: int, ends: Ends) -> tuple[Array, Array]:
        rng, config = self._rng, self._config
        delayed = round(config.delay_share * count)
        count -= delayed
        tilts = rng.random(count) < config.axis_share
        moves = ~tilts | (rng.random(count) < 0.5)
        position_sizes = np.where(moves, rng.choice(config.position_sizes, count), 0.0)
        axis_sizes = np.where(tilts, rng.choice(config.axis_sizes, count), 0.0)
        # delays may never arrive, whatever the ends: otherwise nothing says that the end is better than the way to it
        return (delay(states, rng.choice(config.delay_sizes, delayed), rng, ends="free",
                      shape=config.shape),
                deform_tool_states(states, position_sizes, axis_sizes, rng, ends=ends, shape=config.shape))

    def _stack(self, alternatives: list[Inputs], count: int) -> Inputs:
        shape = (-1 if alternatives else 0, count, self._waypoints, len(self._names))
        return np.concatenate([np.zeros((0, *shape[2:]), dtype=np.float32), *alternatives]).reshape(shape)


def _indices(values: list[int]) -> Indices:
    return np.array(values, dtype=np.int64)
