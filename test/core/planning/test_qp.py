"""The way-points' quadratic programme against an independent solver."""

from __future__ import annotations

import numpy as np
import osqp
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import sparse

from unifeed_ros.core.planning.interior_point import InteriorPoint
from unifeed_ros.core.planning.qp import SOLVERS, QPConstants, WaypointQP
from unifeed_ros.core.planning.sampling import knot_maps, spline_basis
from unifeed_ros.core.planning.solvers import make_solver


def _random_programme(seed: int, *, points: int = 2):
    rng = np.random.default_rng(seed)
    m, n, r = 6, 3, 9
    factors = rng.normal(size=(m, n, n))
    root = rng.normal(size=(m, m))
    constants = QPConstants(rng.normal(size=(r, m)), rng.uniform(0.5, 2.0, size=(r, n)), root @ root.T,
                            rng.uniform(0.1, 1.0, size=n), np.eye(m) + 0.2 * rng.normal(size=(m, m)), np.eye(m))
    clearances = rng.uniform(-0.1, 0.5, size=(m, points))
    clearances[0] = np.inf
    qp = WaypointQP(gradient=rng.normal(size=(m, n)), blocks=factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(n),
                    lower=-rng.uniform(0.0, 0.5, size=(m, n)), upper=rng.uniform(0.0, 0.5, size=(m, n)),
                    shares=rng.uniform(-1.0, 1.0, size=(r, n)), clearances=clearances,
                    clearance_jacobians=rng.normal(size=(m, points, n)), penalty=20.0)
    return constants, qp


def _dense(constants: QPConstants, qp: WaypointQP):
    """Write the programme as P, q, A, l, u over changes and slacks."""
    m, n = qp.gradient.shape
    size = m * n
    hessian = np.zeros((size + m, size + m))
    hessian[:size, :size] = np.kron(constants.coupling, np.diag(constants.coupling_weights))
    for k in range(m):
        hessian[k * n:(k + 1) * n, k * n:(k + 1) * n] += qp.blocks[k]
    hessian[size:, size:] += 1e-3 * np.eye(m)
    rates = np.kron(constants.rates, np.eye(n)) / constants.rate_limits.ravel()[:, None]
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
    constants, qp = _random_programme(seed)
    solution = InteriorPoint(constants, tolerance=1e-9, max_iterations=50).solve(qp)
    assert solution.converged
    hessian, gradient, rows, lower, upper = _dense(constants, qp)
    reference = osqp.OSQP()
    reference.setup(sparse.csc_matrix(np.triu(hessian)), gradient, sparse.csc_matrix(rows), lower, upper, verbose=False,
                    eps_abs=1e-8, eps_rel=1e-8, max_iter=100_000)
    x = reference.solve(raise_error=True).x
    np.testing.assert_allclose(solution.change.ravel(), x[: solution.change.size], atol=1e-3)
    ours = np.concatenate([solution.change.ravel(), _least_slacks(qp, solution.change)])
    costs = [gradient @ y + 0.5 * y @ hessian @ y for y in (ours, x)]
    assert costs[0] == pytest.approx(costs[1], abs=1e-5)


@pytest.mark.parametrize(("name", "tolerance"), [("piqp", 1e-3), ("osqp", 2e-2)])
@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_other_solvers_agree(name, tolerance, seed):
    """Two programmes after each other, since the second one is filled into the first one's patterns."""
    constants, qp = _random_programme(seed)
    solver = make_solver(name, constants, tolerance=1e-9)  # where the cost is flat, a coarse one leaves changes open
    reference = InteriorPoint(constants, tolerance=1e-9, max_iterations=50)
    other = _random_programme(seed + 1)[1]
    for one in (qp, other._replace(shares=qp.shares)):
        solution = solver.solve(one)
        assume(name == "piqp" or solution.converged)  # operator splitting runs out of iterations at times, and says so
        assert solution.converged
        np.testing.assert_allclose(solution.change, reference.solve(one).change, atol=tolerance)


@pytest.mark.parametrize("ends_free", [False, True])
def test_rates_and_roughness_are_narrow_bands_in_spline_coefficients(ends_free):
    basis = spline_basis(12, ends_free=ends_free)
    velocity, acceleration = knot_maps(12, 3.0)
    free = np.arange(1, 12 if ends_free else 11)
    for rates in (velocity[:, free] @ basis, acceleration[:, free] @ basis):
        knot, coefficient = np.nonzero(np.abs(rates) > 1e-5 * np.abs(rates).max())
        assert np.abs(knot - 1 - coefficient).max() <= 1
    assert np.linalg.cond(basis) < 5.0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_solution_keeps_every_bound(seed):
    constants, qp = _random_programme(seed)
    change = make_solver("own", constants).solve(qp).change
    assert (change >= qp.lower - 1e-6).all() and (change <= qp.upper + 1e-6).all()
    assert np.abs(qp.shares + (constants.rates @ change) / constants.rate_limits).max() <= 1 + 1e-6


def test_without_active_bounds_it_is_a_linear_system():
    constants, qp = _random_programme(0, points=0)
    qp = qp._replace(gradient=1e-3 * qp.gradient, lower=qp.lower - 1.0, upper=qp.upper + 1.0, shares=0.0 * qp.shares)
    hessian = _dense(constants, qp)[0][: qp.gradient.size, : qp.gradient.size]
    exact = -np.linalg.solve(hessian, qp.gradient.ravel())
    own, piqp, osqp_ = (make_solver(name, constants, 1e-9).solve(qp).change.ravel() for name in ("own", "piqp", "osqp"))
    np.testing.assert_allclose(own, exact, atol=1e-7)
    np.testing.assert_allclose(piqp, exact, atol=1e-7)
    np.testing.assert_allclose(osqp_, exact, atol=1e-3)


@pytest.mark.parametrize("name", SOLVERS)
def test_contradictory_bounds_are_not_called_converged(name):
    constants, qp = _random_programme(0)
    assert not make_solver(name, constants).solve(qp._replace(lower=qp.upper + 0.1)).converged


@pytest.mark.parametrize("name", ["own", "piqp"])
def test_a_clearance_that_cannot_be_had_is_missed_as_little_as_possible(name):
    constants, qp = _random_programme(1)
    qp = qp._replace(clearances=np.full(qp.clearances.shape, -5.0), shares=0.0 * qp.shares, gradient=0.0 * qp.gradient)
    change = make_solver(name, constants).solve(qp).change
    gained = (qp.clearance_jacobians @ change[:, :, None])[:, :, 0].min(axis=1)
    assert (gained > -1e-6).all()
    assert gained.max() > 0.05
