"""The quadratic programme of way-points, and the solvers that stand behind it."""

from __future__ import annotations

from typing import Literal, NamedTuple, Protocol

from unifeed_ros.core.types import Array

SolverName = Literal["own", "osqp", "piqp"]
SOLVERS: tuple[SolverName, ...] = ("own", "osqp", "piqp")
"""Names of the solvers: the project's interior-point method, OSQP (first order) and PIQP (sparse interior point)."""

SLACK_CURVATURE = 1e-3
"""Curvature of a slack, which makes every programme strictly convex [1]."""


class QPConstants(NamedTuple):
    """What the programmes of one planning problem share."""

    rates: Array
    """T, from changes of the way-points of any joint to its rates, shape (R, m)."""
    rate_limits: Array
    """Limits of the rates, shape (R, n)."""
    coupling: Array
    """R for a joint of unit weight, positive semi-definite, shape (m, m)."""
    coupling_weights: Array
    """Weight of each joint, shape (n,)."""
    basis: Array
    """S, invertible: in coefficients c of d = S c both T S and S'R S are narrow bands, shape (m, m)."""
    velocity: Array
    """V, from changes of the way-points of any joint to velocities at them, in c a narrow band too, shape (m, m)."""


class WaypointQP(NamedTuple):
    """minimise g'd + 1/2 d'(B + R)d + penalty 1's + 1/2 1e-3 s's over changes d, shape (m, n), and slacks s, (m,).

    subject to lower <= d <= upper, |shares + T d / limits| <= 1, c_k + G_k d_k + F_k (V d)_k + s_k >= 0 and s >= 0,
    where R couples the way-points of one joint.
    """

    gradient: Array
    """g, shape (m, n)."""
    blocks: Array
    """B, one positive definite block a way-point, shape (m, n, n)."""
    lower: Array
    """Smallest changes, not positive, shape (m, n)."""
    upper: Array
    """Largest changes, not negative, shape (m, n)."""
    shares: Array
    """Present rates over their limits, shape (R, n)."""
    clearances: Array
    """c, shape (m, P); inf where there is no bound."""
    clearance_jacobians: Array
    """G, shape (m, P, n)."""
    penalty: float
    """Cost of a unit of slack."""
    rate_jacobians: Array | None = None
    """F, shape (m, P, n); None: zero."""
    rough: bool = False
    """True: a rough solution will do; solvers may take it."""


class QPSolution(NamedTuple):
    """Solution of one quadratic programme."""

    change: Array
    """d, shape (m, n)."""
    converged: bool
    """True if the residuals are below the tolerance."""


class QPSolver(Protocol):
    """Solves programmes that share their constants."""

    def solve(self, qp: WaypointQP) -> QPSolution:
        """Solve one programme; the last iterate is returned where it does not converge.

        Args:
            qp: What to solve.
        """
        ...
