"""Questions that tell the most about the reward (paper eqs. M7 and M8), and motions to ask about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import InputError, ShapeError
from unifeed_ros.core.feedback.deformation import sample_deformations
from unifeed_ros.core.reward.ensemble import RATIONALITY, RewardEnsemble
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory


@dataclass(frozen=True, kw_only=True)
class Query:
    """Two motions to compare."""

    indices: tuple[int, int]
    """Which of the candidates."""
    information: float
    """Expected information of the answer, 0 to 1 [bit]."""


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


def select_query(ensemble: RewardEnsemble, candidates: Sequence[Trajectory], robot: RobotModel, context: Context,
                 waypoints: int = 20, rationality: float = RATIONALITY) -> Query:
    """Choose the two candidates whose comparison tells the most (paper eq. M7, over every pair).

    Args:
        ensemble: Learned reward.
        candidates: Motions to choose from, at least two [rad].
        robot: Arm that the motions are of.
        context: Goal and objects.
        waypoints: States that a motion's return is summed over.
        rationality: How strongly returns decide an answer, as in training [1/reward].

    Returns:
        The query; the first best one where several tell the same.

    Raises:
        InputError: Fewer than two candidates, or one of other joints.
    """
    if len(candidates) < 2:
        raise InputError("candidates for a query", expected="at least two", got=len(candidates))
    for trajectory in candidates:
        if trajectory.joint_names != robot.joint_names:
            raise InputError("joints of a candidate", expected=robot.joint_names, got=trajectory.joint_names)
    reward = ensemble.bind(context)
    returns = np.stack([
        reward.member_rewards(robot.tool_states(t.resampled(waypoints))).sum(axis=1) for t in candidates], axis=-1)
    first, second = np.triu_indices(len(candidates), k=1)
    pairs = np.stack([returns[:, first], returns[:, second]], axis=-1).transpose(1, 0, 2)
    information = information_gain(rationality * pairs)
    best = int(np.argmax(information))
    return Query(indices=(int(first[best]), int(second[best])), information=float(information[best]))


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
    bends = np.einsum("hjs,khs->khj", inverses, shifts)
    return [_bent(robot, trajectory, bend) for bend in bends]


def with_variations(robot: RobotModel, given: Sequence[Trajectory], size_m: float, count: int,
                    rng: np.random.Generator) -> list[Trajectory]:
    """Add variations to motions, so that a query can choose among more than what is there.

    Args:
        robot: The arm.
        given: Motions, at least one.
        size_m: Size of the variations at the tool [m].
        count: Variations in all, shared evenly by the motions; at least one each.
        rng: Source of randomness.

    Returns:
        The motions, then their variations.
    """
    each = max(1, count // len(given))
    return [*given, *(variation for motion in given for variation in vary_trajectory(robot, motion, size_m, each, rng))]


def _bent(robot: RobotModel, trajectory: Trajectory, bend: Array) -> Trajectory:
    """Add as much of a joint-space deformation as the limits allow."""
    for scale in 0.8 ** np.arange(20):
        positions = trajectory.positions + scale * bend
        velocities = np.gradient(positions, trajectory.times, axis=0)
        within = (positions >= robot.lower).all() and (positions <= robot.upper).all()
        if within and (np.abs(velocities) <= robot.velocity_limits).all():
            break
    else:
        positions, velocities = trajectory.positions, np.gradient(trajectory.positions, trajectory.times, axis=0)
    return Trajectory(joint_names=trajectory.joint_names, times=trajectory.times, positions=positions,
                      velocities=velocities)
