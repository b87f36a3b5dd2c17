"""A sparse quadratic programme that is solved again and again with new numbers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import osqp
from scipy import sparse

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.types import Array


class QPSettings(NamedTuple):
    """How exactly OSQP solves."""

    tolerance: float = 1e-4
    """Absolute and relative tolerance of its residuals, in the rows' units."""
    max_iterations: int = 400
    """Largest number of its iterations; what is there then is used if it is finite."""


class QPSolution(NamedTuple):
    """What OSQP found."""

    x: Array
    """Variables, shape (N,)."""
    converged: bool
    """True if its residuals are below the tolerance."""
    iterations: int
    """Iterations of OSQP."""


class QuadraticProgram:
    """minimise 1/2 x'Px + q'x subject to l <= Ax <= u, warm-started, its matrices updated in place.

    The first solution sets OSQP up; the later ones only change numbers, so the matrices' patterns are fixed.
    """

    def __init__(self, hessian: sparse.csc_matrix, rows: sparse.csc_matrix, settings: QPSettings | None = None) -> None:
        """Keep the patterns.

        Args:
            hessian: Upper triangle of P with every entry that may ever be non-zero, shape (N, N).
            rows: A with every entry that may ever be non-zero, shape (M, N).
            settings: How exactly to solve.
        """
        self._hessian, self._rows = hessian, rows
        self._settings = settings or QPSettings()
        self._solver: osqp.OSQP | None = None

    def solve(self, hessian: Array, gradient: Array, rows: Array, lower: Array, upper: Array) -> QPSolution:
        """Solve with new numbers.

        Args:
            hessian: Entries of P in the pattern's order.
            gradient: q, shape (N,).
            rows: Entries of A in the pattern's order.
            lower: l, shape (M,); -inf for no bound.
            upper: u, shape (M,); inf for no bound.

        Raises:
            PlanningError: The constraints contradict each other, or numbers are not finite.
        """
        if self._solver is None:
            self._solver = osqp.OSQP()
            self._hessian.data, self._rows.data = hessian, rows
            self._solver.setup(
                self._hessian, gradient, self._rows, lower, upper, verbose=False, eps_abs=self._settings.tolerance,
                eps_rel=self._settings.tolerance, max_iter=self._settings.max_iterations, adaptive_rho_interval=50,
                check_termination=10, polishing=False)
        else:
            self._solver.update(Px=hessian, Ax=rows, q=gradient, l=lower, u=upper)
        result = self._solver.solve(raise_error=False)
        x = np.array(result.x, dtype=np.float64)
        if not np.isfinite(x).all():
            raise PlanningError("the quadratic programme has no solution", got=result.info.status)
        return QPSolution(x, result.info.status == "solved", int(result.info.iter))
