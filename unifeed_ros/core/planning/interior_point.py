"""A dense interior-point method that uses the structure of the way-points' quadratic programme."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpotrf, dpotrs

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.planning.qp import SLACK_CURVATURE, QPConstants, QPSolution, WaypointQP
from unifeed_ros.core.types import Array

_CLOSE = 0.05
"""Distance from every bound, at least, of the first point's slacks."""
_FIRST_MU = 1.0
"""Complementarity of the first point; much smaller ones need twice the iterations."""
_BACK_OFF = 0.99
"""Share of the way to the nearest bound that a step goes."""


class InteriorPoint:
    """Mehrotra's predictor-corrector method for programmes that share their constant parts."""

    def __init__(self, constants: QPConstants, tolerance: float = 1e-6, max_iterations: int = 30) -> None:
        """Keep the constant parts.

        Args:
            constants: What all programmes share.
            tolerance: Largest residual and complementarity of a solution.
            max_iterations: Largest number of factorisations.
        """
        self._rates, self._limits, self._coupling, self._weights = constants[:4]
        m, n = len(self._coupling), len(self._weights)
        self._constant = np.zeros((m, n, m, n))
        _same_joint(self._constant)[:] = self._weights[:, None, None] * self._coupling
        self._tolerance, self._max_iterations = tolerance, max_iterations

    def solve(self, qp: WaypointQP) -> QPSolution:
        """Solve one programme; the last iterate is returned where it does not converge.

        Args:
            qp: What to solve.

        Raises:
            ConfigError: A clearance depends on velocities, which this method does not know.
        """
        if qp.rate_jacobians is not None:
            raise ConfigError("qp_solver", expected="piqp or osqp where the tool's speed is limited", got="own")
        rows = _Rows(self._rates, self._limits, qp)
        point = _first_point(rows, qp)
        gradient = np.concatenate([qp.gradient.ravel(), np.full(len(qp.gradient), qp.penalty)])
        for _ in range(self._max_iterations):
            residual = self._curved(qp, point.x) + gradient + rows.adjoint(point.dual)
            gap = rows.apply(point.x) + point.room - rows.limits
            mu = point.complementarity()
            converged = max(mu, float(np.abs(gap).max()), 0.01 * float(np.abs(residual).max())) < self._tolerance
            if converged:
                break
            system = _Factor(self._constant, qp.blocks, rows, point.dual / point.room)
            if not system.definite:
                break
            predictor = _direction(rows, system, point, residual, gap, point.dual * point.room)
            ahead = point.moved(predictor, 1.0).complementarity()
            target = point.dual * point.room + predictor.dual * predictor.room - (ahead / mu) ** 3 * mu
            point = point.moved(_direction(rows, system, point, residual, gap, target), _BACK_OFF)
        return QPSolution(point.x[: qp.gradient.size].reshape(qp.gradient.shape), converged)

    def _curved(self, qp: WaypointQP, x: Array) -> Array:
        m, n = qp.gradient.shape
        change = x[: m * n].reshape(m, n)
        curved = (qp.blocks @ change[:, :, None])[:, :, 0] + (self._coupling @ change) * self._weights
        return np.concatenate([curved.ravel(), SLACK_CURVATURE * x[m * n:]])


class _Point(NamedTuple):
    """Variables x, room h - C x left by the rows, and the rows' multipliers; or a direction for them."""

    x: Array
    room: Array
    dual: Array

    def complementarity(self) -> float:
        """Compute the mean product of room and multiplier."""
        return float(self.dual @ self.room) / len(self.room)

    def moved(self, direction: _Point, back_off: float) -> _Point:
        """Go along a direction, up to the given share of the way to where a room or multiplier vanishes."""
        nearest = min(_longest(self.room, direction.room), _longest(self.dual, direction.dual))
        share = min(1.0, back_off * nearest)
        return _Point(self.x + share * direction.x, self.room + share * direction.room,
                      self.dual + share * direction.dual)


class _Rows:
    """The rows C x <= h of a programme, and their products."""

    def __init__(self, rates: Array, rate_limits: Array, qp: WaypointQP) -> None:
        self.rates, self.rate_limits = rates, rate_limits
        self.shape = qp.gradient.shape
        self.near = np.isfinite(qp.clearances)
        self.jacobians = np.where(self.near[:, :, None], qp.clearance_jacobians, 0.0)
        self._size = self.shape[0] * self.shape[1]
        self.limits = np.concatenate([
            qp.upper.ravel(), (1.0 - qp.shares).ravel(), -qp.lower.ravel(), (1.0 + qp.shares).ravel(),
            np.zeros(self.shape[0]), qp.clearances[self.near]])
        self._two_sided = self._size + rate_limits.size

    def apply(self, x: Array) -> Array:
        """Compute C x."""
        change, slacks = x[: self._size].reshape(self.shape), x[self._size:]
        both = np.concatenate([x[: self._size], ((self.rates @ change) / self.rate_limits).ravel()])
        heights = (self.jacobians @ change[:, :, None])[:, :, 0] + slacks[:, None]
        return np.concatenate([both, -both, -slacks, -heights[self.near]])

    def adjoint(self, dual: Array) -> Array:
        """Compute C' dual."""
        both = dual[: self._two_sided] - dual[self._two_sided: 2 * self._two_sided]
        slacks, heights = self._one_sided(dual)
        change = both[: self._size].reshape(self.shape) + self.rates.T @ (
            both[self._size:].reshape(self.rate_limits.shape) / self.rate_limits)
        change -= (heights[:, None, :] @ self.jacobians)[:, 0]
        return np.concatenate([change.ravel(), -slacks - heights.sum(axis=1)])

    def split(self, weights: Array) -> tuple[Array, Array, Array, Array]:
        """Sort the rows' weights: changes (m, n), rates over limits (R, n), slacks (m,), clearances (m, P)."""
        both = weights[: self._two_sided] + weights[self._two_sided: 2 * self._two_sided]
        return (both[: self._size].reshape(self.shape), both[self._size:].reshape(self.rate_limits.shape),
                *self._one_sided(weights))

    def _one_sided(self, values: Array) -> tuple[Array, Array]:
        heights = np.zeros(self.near.shape)
        heights[self.near] = values[2 * self._two_sided + self.shape[0]:]
        return values[2 * self._two_sided: 2 * self._two_sided + self.shape[0]], heights


class _Factor:
    """Factorised P + C' W C, the slacks eliminated.

    Attributes:
        definite: False if rounding made the matrix indefinite; it cannot be solved with then.
    """

    def __init__(self, constant: Array, blocks: Array, rows: _Rows, weights: Array) -> None:
        m, n = rows.shape
        boxes, rates, slacks, heights = rows.split(weights)
        matrix = constant.copy()
        weighted = (rates / rows.rate_limits**2).T[:, :, None] * rows.rates
        _same_joint(matrix)[:] += rows.rates.T @ weighted
        self._pivots = SLACK_CURVATURE + slacks + heights.sum(axis=1)
        self._cross = (heights[:, None, :] @ rows.jacobians)[:, 0]
        by_way = _same_waypoint(matrix)
        by_way += blocks
        by_way += rows.jacobians.transpose(0, 2, 1) @ (heights[:, :, None] * rows.jacobians)
        by_way -= self._cross[:, :, None] * self._cross[:, None, :] / self._pivots[:, None, None]
        flat = matrix.reshape(m * n, m * n)
        flat.flat[:: m * n + 1] += boxes.ravel()
        self._factor, info = dpotrf(flat.T, overwrite_a=True)  # symmetric; the transpose is in LAPACK's order
        self.definite = info == 0

    def solve(self, right: Array) -> Array:
        """Solve for a right-hand side of changes and slacks."""
        m, n = self._cross.shape
        slacks = right[m * n:] / self._pivots
        reduced = right[: m * n].reshape(m, n) - self._cross * slacks[:, None]
        x, _ = dpotrs(self._factor, reduced.ravel())
        return np.concatenate([x, slacks - (self._cross * x.reshape(m, n)).sum(axis=1) / self._pivots])


def _same_joint(matrix: Array) -> Array:
    """View the entries of a matrix (m, n, m, n) that belong to one joint, shape (n, m, m)."""
    return np.einsum("kjlj->jkl", matrix)


def _same_waypoint(matrix: Array) -> Array:
    """View the entries of a matrix (m, n, m, n) that belong to one way-point, shape (m, n, n)."""
    return np.einsum("kikj->kij", matrix)


def _first_point(rows: _Rows, qp: WaypointQP) -> _Point:
    """Stay where the way-points are, with enough slack for the clearances."""
    missing = np.maximum(-qp.clearances.min(axis=1, initial=0.0), 0.0)
    x = np.concatenate([np.zeros(qp.gradient.size), missing + _CLOSE])
    room = np.maximum(rows.limits - rows.apply(x), _CLOSE)
    return _Point(x, room, _FIRST_MU / room)


def _direction(rows: _Rows, system: _Factor, point: _Point, residual: Array, gap: Array, target: Array) -> _Point:
    """Solve Newton's equations: residual and gap vanish, and products of room and multiplier fall by the target."""
    x = system.solve(-residual - rows.adjoint((point.dual * gap - target) / point.room))
    room = -gap - rows.apply(x)
    return _Point(x, room, -(target + point.dual * room) / point.room)


def _longest(values: Array, change: Array) -> float:
    """Find the longest step, up to 1, that keeps positive values from falling below zero."""
    shrinking = change < 0
    return min(1.0, float((-values[shrinking] / change[shrinking]).min(initial=1.0)))
