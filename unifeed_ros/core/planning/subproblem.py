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

    def solve(self, at: Evaluation, blocks: Array, radius: float, penalty: float) -> Step:
        """Find the step that the model likes best.

        Args:
            at: The problem at the present way-points.
            blocks: Curvature of the reward's cost for each free way-point, shape (m, n, n), positive definite.
            radius: Largest change of any joint [rad].
            penalty: Cost of a metre below the floor at one way-point [1/m].
        """
        problem = self._problem
        free, gradient = at.waypoints[problem.free], at.reward_gradients + at.roughness_gradient
        reach = radius * np.abs(at.clearance_jacobians).sum(axis=2)
        change = self._solver.solve(WaypointQP(
            gradient=gradient, blocks=blocks,
            lower=np.minimum(np.maximum(problem.bounds.lower - free, -radius), 0.0),
            upper=np.maximum(np.minimum(problem.bounds.upper - free, radius), 0.0),
            shares=np.clip(problem.rate_shares(at.waypoints), -1.0, 1.0),
            clearances=np.where(at.clearances > reach, np.inf, at.clearances),
            clearance_jacobians=at.clearance_jacobians, penalty=penalty)).change
        curved = (blocks @ change[:, :, None])[:, :, 0]
        curved += (problem.roughness_hessian @ change) * problem.roughness_weights
        expected = at.clearances + (at.clearance_jacobians @ change[:, :, None])[:, :, 0]
        return Step(change, float((change * (gradient + 0.5 * curved)).sum()), np.maximum(-expected.min(axis=1), 0.0))
