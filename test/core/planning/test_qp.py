"""The way-points' quadratic programme against an independent solver."""

from __future__ import annotations

import numpy as np
import osqp
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import sparse

from unifeed_ros.core.planning.qp import WaypointQP, WaypointSolver


def _random_programme(seed: int, *, points: int = 2):
    rng = np.random.default_rng(seed)
    m, n, r = 6, 3, 9
    factors = rng.normal(size=(m, n, n))
    root = rng.normal(size=(m, m))
    solver = WaypointSolver(rng.normal(size=(r, m)), rng.uniform(0.5, 2.0, size=(r, n)), root @ root.T,
                            rng.uniform(0.1, 1.0, size=n), tolerance=1e-9, max_iterations=50)
    clearances = rng.uniform(-0.1, 0.5, size=(m, points))
    clearances[0] = np.inf
    qp = WaypointQP(gradient=rng.normal(size=(m, n)), blocks=factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(n),
                    lower=-rng.uniform(0.0, 0.5, size=(m, n)), upper=rng.uniform(0.0, 0.5, size=(m, n)),
                    shares=rng.uniform(-1.0, 1.0, size=(r, n)), clearances=clearances,
                    clearance_jacobians=rng.normal(size=(m, points, n)), penalty=20.0)
    return solver, qp


def _dense(solver: WaypointSolver, qp: WaypointQP):
    """Write the programme as P, q, A, l, u over changes and slacks."""
    m, n = qp.gradient.shape
    size = m * n
    hessian = np.zeros((size + m, size + m))
    hessian[:size, :size] = np.kron(solver._coupling, np.diag(solver._weights))
    for k in range(m):
        hessian[k * n:(k + 1) * n, k * n:(k + 1) * n] += qp.blocks[k]
    hessian[size:, size:] += 1e-3 * np.eye(m)
    rates = np.kron(solver._rates, np.eye(n)) / solver._limits.ravel()[:, None]
    heights = np.zeros((qp.clearances.size, size + m))
    for row, (k, p) in enumerate(np.ndindex(qp.clearances.shape)):
        heights[row, k * n:(k + 1) * n] = qp.clearance_jacobians[k, p]
        heights[row, size + k] = 1.0
    rows = np.vstack([np.eye(size + m), np.hstack([rates, np.zeros((len(rates), m))]), heights])
    shares = qp.shares.ravel()
    lower = np.concatenate([qp.lower.ravel(), np.zeros(m), -1.0 - shares, -qp.clearances.ravel()])
    upper = np.concatenate([qp.upper.ravel(), np.full(m, np.inf), 1.0 - shares, np.full(len(heights), np.inf)])
    return hessian, np.concatenate([qp.gradient.ravel(), np.full(m, qp.penalty)]), rows, lower, upper


def _least_slacks(qp: WaypointQP, change: np.ndarray) -> np.ndarray:
    heights = qp.clearances + (qp.clearance_jacobians @ change[:, :, None])[:, :, 0]
    return np.maximum(-heights.min(axis=1), 0.0)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_solution_is_that_of_osqp(seed):
    solver, qp = _random_programme(seed)
    solution = solver.solve(qp)
    assert solution.converged
    hessian, gradient, rows, lower, upper = _dense(solver, qp)
    reference = osqp.OSQP()
    reference.setup(sparse.csc_matrix(np.triu(hessian)), gradient, sparse.csc_matrix(rows), lower, upper, verbose=False,
                    eps_abs=1e-8, eps_rel=1e-8, max_iter=100_000)
    x = reference.solve(raise_error=True).x
    np.testing.assert_allclose(solution.change.ravel(), x[: solution.change.size], atol=1e-3)
    ours = np.concatenate([solution.change.ravel(), _least_slacks(qp, solution.change)])
    costs = [gradient @ y + 0.5 * y @ hessian @ y for y in (ours, x)]
    assert costs[0] == pytest.approx(costs[1], abs=1e-5)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_solution_keeps_every_bound(seed):
    solver, qp = _random_programme(seed)
    change = solver.solve(qp).change
    assert (change >= qp.lower - 1e-6).all() and (change <= qp.upper + 1e-6).all()
    assert np.abs(qp.shares + (solver._rates @ change) / solver._limits).max() <= 1 + 1e-6


def test_without_active_bounds_it_is_a_linear_system():
    solver, qp = _random_programme(0, points=0)
    qp = qp._replace(gradient=1e-3 * qp.gradient, lower=qp.lower - 1.0, upper=qp.upper + 1.0, shares=0.0 * qp.shares)
    hessian = _dense(solver, qp)[0][: qp.gradient.size, : qp.gradient.size]
    exact = -np.linalg.solve(hessian, qp.gradient.ravel())
    np.testing.assert_allclose(solver.solve(qp).change.ravel(), exact, atol=1e-7)


def test_contradictory_bounds_are_not_called_converged():
    solver, qp = _random_programme(0)
    assert not solver.solve(qp._replace(lower=qp.upper + 0.1)).converged


def test_a_clearance_that_cannot_be_had_is_missed_as_little_as_possible():
    solver, qp = _random_programme(1)
    qp = qp._replace(clearances=np.full(qp.clearances.shape, -5.0), shares=0.0 * qp.shares, gradient=0.0 * qp.gradient)
    change = solver.solve(qp).change
    gained = (qp.clearance_jacobians @ change[:, :, None])[:, :, 0].min(axis=1)
    assert (gained > -1e-6).all()
    assert gained.max() > 0.05
