"""Questions that tell the most about the reward (paper eqs. M7 and M8), and motions to ask about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.feedback.deformation import sample_deformations
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory

_BLOCK = 20
"""Candidates whose pairs with all others are weighed at once; their arrays then stay in the processor's cache."""


@dataclass(frozen=True, kw_only=True)
class QueryConfig:
    """How questions are chosen."""

    seed: int = 0
    """Seed of training and of the variations."""
    active: bool = True
    """True: the most informative question (paper eq. M7); false: a random one."""
    options: int = 2
    """Motions that a question compares."""
    candidates: int = 1000
    """Motions that a question is chosen from: those that are there, and variations of them."""
    variation_size: float = 0.10
    """Size of the variations at the tool [m]."""

    def __post_init__(self) -> None:
        """Reject values that would only fail when a question is asked."""
        if self.options < 2:
            raise ConfigError("options", expected="at least 2", got=self.options)
        if self.candidates < self.options:
            raise ConfigError("candidates", expected=f"at least {self.options}", got=self.candidates)
        if not 0.0 < self.variation_size < 10.0:
            raise ConfigError("variation_size", expected="above 0 and below 10", got=self.variation_size)


@dataclass(frozen=True, kw_only=True)
class Query:
    """Motions to compare."""

    indices: tuple[int, ...]
    """Which of the candidates, ascending."""
    information: float
    """Expected information of the answer, 0 to log2 of the number of motions [bit]."""


def information_gain(returns: ArrayLike) -> Array:
    """Compute how much the answer to each question would tell about the reward.

    I = 1/m sum_i sum_theta P(i | theta) log2(m P(i | theta) / sum_theta' P(i | theta')), P the softmax of the returns
    (paper eq. M8, for any number of options).

    Args:
        returns: Each member's return of each option, shape (..., m, K) [reward].

    Returns:
        Information, shape (...), 0 to log2(min(m, K)) [bit].

    Raises:
        ShapeError: Fewer than one member or two options.
        InputError: A return is not finite.
    """
    returns = np.asarray(returns, dtype=np.float64)
    if returns.ndim < 2 or returns.shape[-1] < 2 or returns.shape[-2] < 1:
        raise ShapeError("shape of returns", expected="(..., members, options >= 2)", got=returns.shape)
    if not np.isfinite(returns).all():
        raise InputError("a return is not finite", mend="train again")
    choice = np.exp(returns - returns.max(axis=-1, keepdims=True))
    choice /= choice.sum(axis=-1, keepdims=True)
    mean = choice.mean(axis=-2, keepdims=True)
    ratio = np.where(choice > 0.0, choice, 1.0) / np.where(choice > 0.0, mean, 1.0)  # p log p -> 0
    information: Array = (choice * np.log2(ratio)).sum(axis=(-2, -1)) / returns.shape[-2]
    return np.maximum(information, 0.0)


def select_query(ensemble: RewardEnsemble, candidates: Sequence[Trajectory], robot: RobotModel, context: Context, *,
                 waypoints: int, rationality: float, options: int = 2) -> Query:
    """Choose the candidates whose comparison tells the most: an active query (paper eq. M7).

    Args:
        ensemble: Learned reward.
        candidates: Motions to choose from, at least as many as options [rad].
        robot: Arm that the motions are of.
        context: Goal and objects.
        waypoints: States that a motion's return is summed over, as in training.
        rationality: How strongly returns decide an answer, as in training [1/reward].
        options: Motions to compare, at least 2.

    Returns:
        The query; the first best one where several tell the same.

    Raises:
        InputError: Fewer than two options, fewer candidates than options, or one of other joints.
    """
    returns = rationality * _returns(ensemble, candidates, robot, context, waypoints)
    return most_informative(returns, options)


def random_query(ensemble: RewardEnsemble, candidates: Sequence[Trajectory], robot: RobotModel, context: Context, *,
                 waypoints: int, rationality: float, rng: np.random.Generator, options: int = 2) -> Query:
    """Choose candidates at random: a passive query, to compare active ones with.

    Args:
        ensemble: Learned reward; says what the answer tells, and decides nothing.
        candidates: As for select_query.
        robot: As for select_query.
        context: As for select_query.
        waypoints: As for select_query.
        rationality: As for select_query [1/reward].
        rng: Source of randomness.
        options: Motions to compare, at least 2.

    Returns:
        The query.

    Raises:
        InputError: As for select_query.
    """
    _require_enough(len(candidates), options)
    indices = sorted(int(i) for i in rng.choice(len(candidates), options, replace=False))
    returns = _returns(ensemble, [candidates[i] for i in indices], robot, context, waypoints)
    return Query(indices=tuple(indices), information=float(information_gain(rationality * returns)))


def most_informative(returns: ArrayLike, options: int = 2) -> Query:
    """Find the candidates whose comparison tells the most (paper eq. M7).

    Two options: the best of all pairs. More: the best pair, grown by the candidate that adds the most, then improved
    by the best single swaps, because 1000 candidates make 166 million triples. Known weakness: a better set may be two
    swaps away.

    Args:
        returns: Each member's return of each candidate, times the rationality, shape (m, N) [1].
        options: Motions to compare, 2 to N.

    Returns:
        The query; the first best one where several tell the same.

    Raises:
        InputError: Fewer than two options, fewer candidates than options, or a return that is not finite.
    """
    returns = np.asarray(returns, dtype=np.float64)
    members, count = returns.shape
    _require_enough(count, options)
    chosen, information = (0, 1), -1.0
    for first in range(0, count - 1, _BLOCK):
        rows, columns = np.arange(first, min(first + _BLOCK, count - 1)), np.arange(first + 1, count)
        pairs = np.empty((members, 2, len(rows), len(columns)))
        pairs[:, 0], pairs[:, 1] = returns[:, rows, None], returns[:, None, columns]
        # members and options come first in memory: sums over them then run along the long axes
        gains = np.where(rows[:, None] < columns, information_gain(np.moveaxis(pairs, (0, 1), (-2, -1))), -1.0)
        row, column = np.unravel_index(np.argmax(gains), gains.shape)
        if gains[row, column] > information:
            chosen, information = (int(rows[row]), int(columns[column])), float(gains[row, column])
    return _widened(returns, chosen, information, options)


def _widened(returns: Array, pair: tuple[int, ...], information: float, options: int) -> Query:
    """Grow a pair by the candidate that adds the most, then make the best single swap while that tells more."""
    chosen, best = list(pair), information
    while len(chosen) < options:
        gains = _gains_with(returns, chosen)
        chosen.append(int(np.argmax(gains)))
        best = float(gains[chosen[-1]])
    while options > 2:
        kept = [chosen[:place] + chosen[place + 1:] for place in range(options)]
        gains = np.stack([_gains_with(returns, others) for others in kept])
        place, candidate = np.unravel_index(np.argmax(gains), gains.shape)
        if gains[place, candidate] < best + 1e-9:
            break
        chosen, best = [*kept[place], int(candidate)], float(gains[place, candidate])
    return Query(indices=tuple(sorted(chosen)), information=best)


def _gains_with(returns: Array, chosen: list[int]) -> Array:
    """Compute the information of the chosen candidates with each other one, -1 for themselves, shape (N,) [bit]."""
    count = returns.shape[1]
    sets = np.stack([*(np.repeat(returns[:, [i]], count, axis=1) for i in chosen), returns], axis=-1)
    gains = information_gain(sets.transpose(1, 0, 2))
    gains[chosen] = -1.0
    return gains


def vary_trajectory(robot: RobotModel, trajectory: Trajectory, size_m: float, count: int,
                    rng: np.random.Generator) -> list[Trajectory]:
    """Make motions that differ smoothly from a given one, between the same ends, and that the arm can carry out.

    A deformation of the tool's position (paper eq. M1, ends fixed) is carried over to the joints by the damped
    pseudo-inverse of the Jacobian, then scaled down until positions and velocities are within the arm's limits.

    Args:
        robot: The arm.
        trajectory: Motion to vary, within the limits itself, at least 3 points [rad].
        size_m: Root-mean-square deformation of the middle in each coordinate, before scaling [m].
        count: Number of variations.
        rng: Source of randomness.

    Returns:
        Variations at the same times, with velocities.
    """
    _, jacobians = robot.tool_states_and_jacobians(trajectory.positions)
    damped = jacobians @ jacobians.transpose(0, 2, 1) + 1e-2 * np.eye(6)
    inverses = jacobians.transpose(0, 2, 1) @ np.linalg.inv(damped)
    shifts = np.zeros((count, len(trajectory.times), 6))
    shifts[..., :3] = sample_deformations(len(trajectory.times), np.full((count, 3), size_m), rng)
    return _bent(robot, trajectory, (inverses @ shifts[..., None])[..., 0])


def with_variations(robot: RobotModel, given: Sequence[Trajectory], size_m: float, total: int,
                    rng: np.random.Generator) -> list[Trajectory]:
    """Add variations to motions, so that a query can choose among more than what is there.

    Args:
        robot: The arm.
        given: Motions, at least one: optima, past motions, or any others [rad].
        size_m: Size of the variations at the tool [m].
        total: Number of motions to end with, if more than given; the given ones are varied equally often.
        rng: Source of randomness.

    Returns:
        The motions, then their variations.
    """
    counts = np.diff(np.linspace(0, max(0, total - len(given)), len(given) + 1).astype(int))
    return [*given, *(variation for motion, count in zip(given, counts, strict=True)
                      for variation in vary_trajectory(robot, motion, size_m, int(count), rng))]


def _bent(robot: RobotModel, trajectory: Trajectory, bends: Array) -> list[Trajectory]:
    """Add as much of each joint-space deformation, shape (K, H, n) [rad], as the limits allow."""
    speeds, more = (np.gradient(p, trajectory.times, axis=-2) for p in (trajectory.positions, bends))
    shares = np.minimum(_share_within(trajectory.positions, bends, robot.lower, robot.upper),
                        _share_within(speeds, more, -robot.velocity_limits, robot.velocity_limits))[:, None, None]
    return [Trajectory(joint_names=trajectory.joint_names, times=trajectory.times, positions=p, velocities=v)
            for p, v in zip(trajectory.positions + shares * bends, speeds + shares * more, strict=True)]


def _share_within(values: Array, changes: Array, lower: Array, upper: Array) -> Array:
    """Find the largest share of each change, at most 1, that keeps values, shape (H, n), within limits; shape (K,)."""
    room = np.where(changes > 0.0, upper - values, values - lower)
    shares = np.maximum(room, 0.0) / np.maximum(np.abs(changes), 1e-12)
    # a hair less, since a share of exactly the room may end beyond the limit by rounding
    return np.asarray((1.0 - 1e-9) * np.minimum(shares.min(axis=(1, 2)), 1.0))


def _returns(ensemble: RewardEnsemble, candidates: Sequence[Trajectory], robot: RobotModel, context: Context,
             waypoints: int) -> Array:
    """Compute each member's return of each candidate, shape (m, N) [reward]."""
    for trajectory in candidates:
        if trajectory.joint_names != robot.joint_names:
            raise InputError("joints of a candidate", expected=robot.joint_names, got=trajectory.joint_names)
    if not candidates:
        return np.zeros((ensemble.members, 0))
    states = robot.tool_states(np.concatenate([t.resampled(waypoints) for t in candidates]))
    rewards = ensemble.bind(context).member_rewards(states)
    return np.asarray(rewards.reshape(ensemble.members, len(candidates), waypoints).sum(axis=2))


def _require_enough(candidates: int, options: int) -> None:
    if options < 2:
        raise InputError("options of a query", expected="at least two", got=options)
    if candidates < options:
        raise InputError("candidates for a query", expected=f"at least {options}", got=candidates)
