"""The quadratic programme of one iteration: model of the cost, linearised constraints, trust region."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy import sparse

from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem
from unifeed_ros.core.planning.qp import QPSettings, QuadraticProgram
from unifeed_ros.core.types import Array

_SLACK_CURVATURE = 1e-2
"""Curvature of the slack variables, which keeps OSQP's steps bounded."""


class Step(NamedTuple):
    """Solution of one quadratic programme."""

    change: Array
    """Change of the free way-points, shape (m, n) [rad]."""
    cost: float
    """Change of the cost that the model expects [1]."""
    shortfalls: Array
    """Distance below the floor that the linearisation expects at each free way-point, shape (m,) [m]."""


class Subproblem:
    """Model of a planning problem around way-points, for steps d and slacks s.

    minimise g'd + 1/2 d'(B + roughness)d + penalty 1's, subject to the box of limits and trust region, the rates'
    limits, and clearances c_kp + G_kp d_k + s_k >= 0, s >= 0. With the slacks it always has a solution.
    """

    def __init__(self, problem: PlanningProblem, settings: QPSettings | None = None) -> None:
        """Lay out the sparse matrices once."""
        self._problem = problem
        m, n, p = len(problem.free), problem.joints, len(problem.points.names)
        self._shape = (m, n, p)
        self._lay_out_hessian(m, n)
        self._lay_out_rows(m, n, p)
        self._programme = QuadraticProgram(self._hessian, self._rows, settings)

    def solve(self, at: Evaluation, blocks: Array, radius: float, penalty: float) -> Step:
        """Find the step that the model likes best.

        Args:
            at: The problem at the present way-points.
            blocks: Curvature B of the reward's cost for each free way-point, shape (m, n, n), positive definite.
            radius: Largest change of any joint [rad].
            penalty: Cost of a metre below the floor at one way-point [1/m].
        """
        m, n, _ = self._shape
        hessian = self._roughness.copy()
        hessian[self._block_entries] += blocks[:, self._upper[0], self._upper[1]].ravel()
        gradient = at.reward_gradients + at.roughness_gradient
        self._entries[self._clearance_entries] = at.clearance_jacobians.ravel()
        lower, upper = self._bounds(at, radius)
        solution = self._programme.solve(
            hessian, np.concatenate([gradient.ravel(), np.full(m, penalty)]), self._entries, lower, upper)
        change = np.clip(solution.x[: m * n].reshape(m, n), -radius, radius)
        curved = np.einsum("kij,kj->ki", blocks, change)
        curved += (self._problem.roughness_hessian @ change) * self._problem.roughness_weights
        expected = at.clearances + np.einsum("kpj,kj->kp", at.clearance_jacobians, change)
        return Step(change, float((change * (gradient + 0.5 * curved)).sum()),
                    np.maximum(-expected.min(axis=1), 0.0))

    def _bounds(self, at: Evaluation, radius: float) -> tuple[Array, Array]:
        problem, (m, n, _) = self._problem, self._shape
        free = at.waypoints[problem.free]
        lower, upper = np.maximum(problem.bounds.lower - free, -radius), np.minimum(problem.bounds.upper - free, radius)
        shares = problem.rate_shares(at.waypoints)
        reach = radius * np.abs(at.clearance_jacobians).sum(axis=2)
        clearances = np.where(at.clearances > 2.0 * reach, -np.inf, -at.clearances)  # out of reach: no row
        endless = np.full(m, np.inf)
        # staying is always allowed, so that what OSQP left undone does not make the next programme impossible
        return (np.concatenate([np.minimum(lower, 0.0).ravel(), np.zeros(m), np.minimum(-1.0 - shares, 0.0),
                                clearances.ravel()]),
                np.concatenate([np.maximum(upper, 0.0).ravel(), endless, np.maximum(1.0 - shares, 0.0),
                                np.full(clearances.size, np.inf)]))

    def _lay_out_hessian(self, m: int, n: int) -> None:
        problem = self._problem
        self._upper = np.triu_indices(n)
        block_rows = (np.arange(m)[:, None] * n + self._upper[0]).ravel()
        block_columns = (np.arange(m)[:, None] * n + self._upper[1]).ravel()
        rough = sparse.triu(sparse.kron(problem.roughness_hessian, np.diag(problem.roughness_weights)), format="coo")
        slacks = m * n + np.arange(m)
        pattern = _pattern(np.concatenate([block_rows, rough.row, slacks]),
                           np.concatenate([block_columns, rough.col, slacks]), (m * n + m, m * n + m))
        self._hessian = pattern
        self._block_entries = _positions(pattern, block_rows, block_columns)
        self._roughness = np.zeros(pattern.nnz)
        self._roughness[_positions(pattern, rough.row, rough.col)] = rough.data
        self._roughness[_positions(pattern, slacks, slacks)] = _SLACK_CURVATURE

    def _lay_out_rows(self, m: int, n: int, p: int) -> None:
        rates = self._problem.rate_matrix().tocoo()
        constants = sparse.block_array([[sparse.eye_array(m * n + m)],
                                        [sparse.coo_array((rates.data, (rates.row, rates.col)),
                                                          shape=(rates.shape[0], m * n + m))]]).tocoo()
        first = constants.shape[0]
        point_rows = first + np.arange(m * p)
        clearance_rows = np.repeat(point_rows, n)
        clearance_columns = (np.arange(m)[:, None, None] * n + np.arange(n) + np.zeros((p, 1), dtype=int)).ravel()
        slack_columns = m * n + np.repeat(np.arange(m), p)
        pattern = _pattern(np.concatenate([constants.row, clearance_rows, point_rows]),
                           np.concatenate([constants.col, clearance_columns, slack_columns]),
                           (first + m * p, m * n + m))
        self._rows = pattern
        self._entries = np.zeros(pattern.nnz)
        self._entries[_positions(pattern, constants.row, constants.col)] = constants.data
        self._entries[_positions(pattern, point_rows, slack_columns)] = 1.0
        self._clearance_entries = _positions(pattern, clearance_rows, clearance_columns)


def _pattern(rows: Array, columns: Array, shape: tuple[int, int]) -> sparse.csc_matrix:
    """Make a sparse matrix with an entry wherever one is named, sorted as OSQP wants it."""
    pattern = sparse.csc_matrix((np.ones(len(rows)), (rows, columns)), shape=shape)
    pattern.sum_duplicates()
    return pattern


def _positions(pattern: sparse.csc_matrix, rows: Array, columns: Array) -> Array:
    """Find where entries lie in a pattern's data."""
    numbered = sparse.csc_matrix((np.arange(1, pattern.nnz + 1), pattern.indices, pattern.indptr), shape=pattern.shape)
    return np.asarray(numbered[rows, columns]).ravel() - 1
