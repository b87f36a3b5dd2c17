"""SciPy's SLSQP on a planning problem: what relatives of the paper plan with."""

from __future__ import annotations

import time
from typing import NamedTuple

import numpy as np
from scipy.optimize import LinearConstraint, NonlinearConstraint, minimize

from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem
from unifeed_ros.core.planning.sqp import merit
from unifeed_ros.core.types import Array

_FAR = 1.0
"""Clearance of what is far away [m]."""


class SlsqpResult(NamedTuple):
    """What SLSQP found."""

    waypoints: Array
    """Its best way-points by the l1 merit function, shape (H, n) [rad]."""
    seconds: float
    """Processor time [s]."""
    converged: bool
    """False if the time was up, or SLSQP gave up."""


class _TimeIsUpError(Exception):
    """Ends SLSQP from inside an evaluation."""


class _Evaluator:
    """The problem at flat vectors: each evaluated once, the best one kept, until the time is up."""

    def __init__(self, problem: PlanningProblem, limit: float) -> None:
        self.problem, self.shape = problem, (len(problem.free), problem.joints)
        self.end = time.thread_time() + limit
        self.last: tuple[Array, Evaluation] | None = None
        self.best: Evaluation | None = None
        self.near = np.zeros(0, dtype=np.intp)
        """Constraints that are near at the start; SLSQP, which is dense, is spared the others."""

    def __call__(self, x: Array) -> Evaluation:
        if time.thread_time() > self.end:
            raise _TimeIsUpError
        if self.last is None or not np.array_equal(self.last[0], x):
            at = self.problem.evaluate(self.problem.complete(x.reshape(self.shape)))
            self.last = (x.copy(), at)
            within = np.abs(self.problem.rate_shares(at.waypoints)).max() < 1.0 + 1e-4
            if within and (self.best is None or merit(at) < merit(self.best)):
                self.best = at
        return self.last[1]

    def gradient(self, x: Array) -> Array:
        at = self(x)
        return (at.reward_gradients + at.roughness_gradient).ravel()

    def clearances(self, x: Array) -> Array:
        return np.minimum(self(x).clearances[:, self.near], _FAR).ravel()

    def clearance_jacobian(self, x: Array) -> Array:
        at = self(x)
        jacobians = at.clearance_jacobians[:, self.near]
        m, points, n = jacobians.shape
        dense = np.zeros((m, points, m, n))
        dense[np.arange(m), :, np.arange(m)] = jacobians
        if at.rate_jacobians is not None:
            dense += at.rate_jacobians[:, self.near, None] * self.problem.velocity[:, None, :, None]
        return dense.reshape(m * points, m * n)


def solve_with_slsqp(problem: PlanningProblem, start: Array, *, exact: bool, limit: float = np.inf) -> SlsqpResult:
    """Solve a planning problem with SLSQP; linear constraints always have their exact Jacobian.

    Args:
        problem: What to solve.
        start: Way-points to start from, shape (H, n) [rad].
        exact: True for exact gradients of the objective and the heights; False for forward differences.
        limit: Processor time after which it is ended [s].
    """
    began = time.thread_time()
    at = _Evaluator(problem, limit)
    first = start[problem.free].ravel()
    zero = problem.rate_shares(problem.complete(np.zeros(at.shape))).ravel()
    rates = np.kron(problem.rates[:, problem.free], np.eye(problem.joints)) / problem.rate_limits.ravel()[:, None]
    lower, upper = (np.tile(b, at.shape[0]) for b in (problem.lower, problem.upper))
    heights = NonlinearConstraint(at.clearances, 0.0, np.inf, jac=at.clearance_jacobian if exact else "2-point")
    converged = False
    try:
        at.near = np.flatnonzero(np.isfinite(at(first).clearances).any(axis=0))
        converged = bool(minimize(
            lambda x: at(x).cost, first, method="SLSQP", jac=at.gradient if exact else "2-point",
            bounds=list(zip(lower, upper, strict=True)),
            constraints=[LinearConstraint(rates, -1.0 - zero, 1.0 - zero), heights],
            options={"maxiter": 1000, "ftol": 1e-6}).success)
    except _TimeIsUpError:
        pass
    waypoints = start if at.best is None else at.best.waypoints
    return SlsqpResult(waypoints, time.thread_time() - began, converged)
