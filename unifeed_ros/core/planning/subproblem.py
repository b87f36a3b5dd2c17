"""The quadratic model of a planning problem around way-points, with a trust region."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem
from unifeed_ros.core.planning.qp import WaypointQP
from unifeed_ros.core.planning.solvers import make_solver
from unifeed_ros.core.types import Array

_TOLERANCE = 1e-5
"""Of the quadratic programmes' solutions; a tighter one costs a tenth of the time and gains nothing."""

_MOST = 6
"""Clearances of one way-point that a model knows, the smallest ones, those of the goal on top; what it leaves out, the
merit function sees."""
_WIDTH = 3
"""Steps of the number of clearances that the programmes have room for: each new number lays out patterns anew."""


class Step(NamedTuple):
    """Solution of one quadratic model."""

    change: Array
    """Change of the free way-points, shape (m, n) [rad]."""
    cost: float
    """Change of the cost that the model expects [1]."""
    shortfalls: Array
    """Distance below the floor that the linearisation expects at each free way-point, shape (m,) [m]."""


class Subproblem:
    """Model of a planning problem: quadratic cost, linearised clearances, the problem's linear limits.

    Clearances may be missed for a penalty and staying is always allowed, so that it has a solution everywhere.
    """

    def __init__(self, problem: PlanningProblem) -> None:
        """Set up the parts that no iteration changes."""
        self._problem = problem
        self._solver = make_solver(problem.qp_solver, problem.qp_constants(), _TOLERANCE)
        self._fastest = float(np.abs(problem.velocity).sum(axis=1).max())
        self._width = _WIDTH
        self._most = _MOST + sum(len(one.names) for one in problem.bounds.constraints if one.at_end)

    def solve(self, at: Evaluation, blocks: Array, radius: float, penalty: float, *, rough: bool = False) -> Step:
        """Find the step that the model likes best.

        Args:
            at: The problem at the present way-points.
            blocks: Curvature of the reward's cost for each free way-point, shape (m, n, n), positive definite.
            radius: Largest change of any joint [rad].
            penalty: Cost of a metre below the floor at one way-point [1/m].
            rough: True: about that step will do.
        """
        problem = self._problem
        free, gradient = at.waypoints[problem.free], at.reward_gradients + at.roughness_gradient
        clearances, jacobians, by_rate = self._within_reach(at, radius)
        change = self._solver.solve(WaypointQP(
            gradient=gradient, blocks=blocks,
            lower=np.minimum(np.maximum(problem.lower - free, -radius), 0.0),
            upper=np.maximum(np.minimum(problem.upper - free, radius), 0.0),
            shares=np.clip(problem.rate_shares(at.waypoints), -1.0, 1.0),
            clearances=clearances, clearance_jacobians=jacobians, penalty=penalty, rate_jacobians=by_rate,
            rough=rough)).change
        curved = (blocks @ change[:, :, None])[:, :, 0]
        curved += (problem.roughness_hessian @ change) * problem.roughness_weights
        expected = at.clearances + (at.clearance_jacobians @ change[:, :, None])[:, :, 0]
        if at.rate_jacobians is not None:
            expected += (at.rate_jacobians @ (problem.velocity @ change)[:, :, None])[:, :, 0]
        return Step(change, float((change * (gradient + 0.5 * curved)).sum()), np.maximum(-expected.min(axis=1), 0.0))

    def _within_reach(self, at: Evaluation, radius: float) -> tuple[Array, Array, Array | None]:
        """Pick the clearances that a step can use up, at each way-point as many as where there are most."""
        by_rate = at.rate_jacobians
        reach = radius * np.abs(at.clearance_jacobians).sum(axis=2)
        if by_rate is not None:
            reach += radius * self._fastest * np.abs(by_rate).sum(axis=2)
        clearances = np.where(at.clearances > reach, np.inf, at.clearances)
        most = min(int(np.isfinite(clearances).sum(axis=1).max()), self._most)
        self._width = max(self._width, -(-most // _WIDTH) * _WIDTH)
        picked = np.argsort(clearances, axis=1)[:, : self._width]
        clearances, jacobians = np.take_along_axis(clearances, picked, 1), at.clearance_jacobians
        return (clearances, np.take_along_axis(jacobians, picked[..., None], 1),
                None if by_rate is None else np.take_along_axis(by_rate, picked[..., None], 1))
