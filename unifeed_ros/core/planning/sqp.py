"""Sequential quadratic programming on a planning problem, from one start."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem
from unifeed_ros.core.planning.subproblem import Subproblem
from unifeed_ros.core.types import Array

PENALTY = 50.0
"""Cost of a metre below a bound at one way-point, in the reward's spread [1/m]."""
_SAMPLED = 0.1
"""Distance over which the first curvature is measured: a learned reward's ridges count as curvature then [rad]."""
_LEAST_CURVATURE = 0.05
"""Smallest curvature that a search starts with [1/rad^2]."""
_SMALLEST_RADIUS = 1e-3
_FAR = 0.3
"""Expected gain of a step after which the next one need not be exact [1]."""
_POOR = 0.1
"""Share of the expected gain below which a shorter step is tried too: it costs a third of a quadratic programme."""
_SHORTER = 0.4
"""Length of that step over the whole one."""
_SHRINK = 0.7
"""Factor of the radius after steps that gained nothing; smaller ones get stuck on ridges before curvature is known."""
_LARGEST_RADIUS = 0.6
_LAST = 2
"""Iterations in a row that gain too little, with which a search ends."""
_SHARE, _FINEST = 2e-3, 0.02
"""Share of the cost that is too little where that is less than the tolerance, as near zero, and the part of the
tolerance that always is [1]."""


def first_curvature(problem: PlanningProblem, at: Evaluation) -> Array:
    """Measure each free way-point's curvature of the reward's cost, made positive by its magnitude.

    Args:
        problem: What is solved.
        at: Where.

    Returns:
        Shape (m, n, n) [1/rad^2].
    """
    values, axes = np.linalg.eigh(problem.reward_curvature(at, _SAMPLED))
    values = np.maximum(np.abs(values), _LEAST_CURVATURE)
    return np.asarray((axes * values[:, None]) @ axes.transpose(0, 2, 1))


def iterations(problem: PlanningProblem, subproblem: Subproblem, present: Evaluation, blocks: Array,
               config: PlannerConfig) -> Iterator[Evaluation]:
    """Improve way-points step by step.

    Damped BFGS curvature for each way-point, exact roughness, trust region, l1 merit function. A step that overshoots
    is cut short: a learned reward has ridges, and steps that cross them would be rejected every other time.

    Args:
        problem: What to solve.
        subproblem: Its quadratic model.
        present: The problem at way-points that keep the linear constraints.
        blocks: Curvature of the reward's cost for each free way-point, positive definite, shape (m, n, n) [1/rad^2];
            what is learned of it on the way is written into it.
        config: Settings.

    Yields:
        The problem at the present way-points, after each quadratic programme; ends when no step is worth while.

    Raises:
        PlanningError: The reward is not finite.
    """
    radius, small, predicted = config.trust_radius, 0, np.inf
    for _ in range(config.max_iterations):
        enough = config.tolerance * min(1.0, max(_FINEST, _SHARE * abs(present.cost) / config.tolerance))
        step = subproblem.solve(present, blocks, radius, PENALTY, rough=predicted > _FAR)
        predicted = PENALTY * float(present.shortfalls.sum() - step.shortfalls.sum()) - step.cost
        trial = problem.evaluate(_along(problem, present, step.change))
        ratio = (merit(present) - merit(trial)) / max(predicted, 1e-12)
        blocks[:] = updated_curvature(blocks, step.change, trial.reward_gradients - present.reward_gradients)
        if ratio < _POOR and predicted > enough:
            trial = min(trial, problem.evaluate(_along(problem, present, _SHORTER * step.change)), key=merit)
        achieved, largest = merit(present) - merit(trial), float(np.abs(step.change).max())
        if achieved > max(0.0, 1e-3 * predicted):
            present = trial
        small = small + 1 if max(predicted, achieved) < enough else 0
        if ratio < 0.25:
            radius = (1.0 if achieved > 0 else _SHRINK) * min(radius, largest)
        elif ratio > 0.75 and largest > 0.9 * radius:
            radius = min(2.0 * radius, _LARGEST_RADIUS)
        yield present
        if small >= _LAST or radius < _SMALLEST_RADIUS:
            return


def _along(problem: PlanningProblem, present: Evaluation, change: Array) -> Array:
    return problem.complete(present.waypoints[problem.free] + change)


def merit(at: Evaluation) -> float:
    """Compute the l1 merit function: cost and penalty for what is below its bound [1]."""
    return at.cost + PENALTY * float(at.shortfalls.sum())


def updated_curvature(blocks: Array, change: Array, gradient_change: Array) -> Array:
    """Update each way-point's curvature by damped BFGS (Powell), which keeps it positive definite.

    Args:
        blocks: Curvatures, shape (m, n, n) [1/rad^2].
        change: Changes of the way-points, shape (m, n) [rad].
        gradient_change: Changes of their gradients, shape (m, n) [1/rad].

    Returns:
        New curvatures, shape (m, n, n) [1/rad^2].
    """
    curved = np.einsum("kij,kj->ki", blocks, change)
    expected = (change * curved).sum(axis=1)
    measured = (change * gradient_change).sum(axis=1)
    moved = expected > 1e-10
    expected = np.where(moved, expected, 1.0)
    short = measured < 0.2 * expected
    share = np.where(short, 0.8 * expected / np.where(short, expected - measured, 1.0), 1.0)[:, None]
    damped = share * gradient_change + (1.0 - share) * curved
    product = np.where(moved, (change * damped).sum(axis=1), 1.0)
    updated = (blocks - curved[:, :, None] * curved[:, None, :] / expected[:, None, None]
               + damped[:, :, None] * damped[:, None, :] / product[:, None, None])
    return np.where(moved[:, None, None], updated, blocks)
