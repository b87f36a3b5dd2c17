"""The solvers that stand behind the quadratic programme of way-points."""

from __future__ import annotations

from typing import Any

import numpy as np
import osqp
import piqp

from unifeed_ros.core.planning.interior_point import InteriorPoint
from unifeed_ros.core.planning.qp import QPConstants, QPSolution, QPSolver, SolverName, WaypointQP
from unifeed_ros.core.planning.sparse_qp import SparseForm
from unifeed_ros.core.types import Array

_OSQP_ITERATIONS = 4000
_OSQP_TOLERANCE = 1e-4
_ROUGH_TOLERANCE = 1e-2


def make_solver(name: SolverName, constants: QPConstants, tolerance: float = 1e-6) -> QPSolver:
    """Choose a solver.

    Args:
        name: Which one.
        constants: What all programmes share.
        tolerance: Largest residual of a solution, and for the interior-point methods its largest complementarity.
    """
    if name == "own":
        return InteriorPoint(constants, tolerance)
    return _Sparse(constants, _Piqp(tolerance) if name == "piqp" else _Osqp(max(tolerance, _OSQP_TOLERANCE)))


class _Sparse:
    """A solver that takes the sparse form; its patterns are laid out anew where the number of clearances changes."""

    def __init__(self, constants: QPConstants, backend: _Piqp | _Osqp) -> None:
        self._constants, self._backend = constants, backend
        self._form: SparseForm | None = None

    def solve(self, qp: WaypointQP) -> QPSolution:
        """Solve one programme; no change is what comes of bounds that contradict each other."""
        if (qp.lower > qp.upper).any():
            return QPSolution(np.zeros_like(qp.gradient), False)
        if self._form is None or self._form.points != qp.clearances.shape[1]:
            self._form = SparseForm(self._constants, qp.clearances.shape[1])
            self._backend.forget()
        self._form.fill(qp)
        x, converged = self._backend.solve(self._form, qp.rough)
        if not np.isfinite(x).all():
            return QPSolution(np.zeros_like(qp.gradient), False)
        return QPSolution(np.minimum(np.maximum(self._form.change(x), qp.lower), qp.upper), converged)


class _Piqp:
    """A sparse interior-point method with proximal terms."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self.forget()

    def forget(self) -> None:
        """Make ready for programmes of other patterns."""
        self._solver: Any = piqp.SparseSolver()
        settings = self._solver.settings
        settings.kkt_solver = piqp.sparse_multistage
        settings.preconditioner_reuse_on_update = True
        self._solve_next = self._solver.setup

    def solve(self, form: SparseForm, rough: bool) -> tuple[Array, bool]:
        """Solve for the variables; true if converged."""
        tolerance, settings = max(self._tolerance, _ROUGH_TOLERANCE if rough else 0.0), self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = 10.0 * tolerance
        self._solve_next(P=form.hessian, c=form.gradient, G=form.rows, h_l=form.lower, h_u=form.upper)
        self._solve_next = self._solver.update
        converged = self._solver.solve() == piqp.PIQP_SOLVED
        return self._solver.result.x, converged


class _Osqp:
    """Operator splitting, which starts from the last solution."""

    def __init__(self, tolerance: float) -> None:
        self._tolerance = tolerance
        self.forget()

    def forget(self) -> None:
        """Make ready for programmes of other patterns."""
        self._solver: Any = None

    def solve(self, form: SparseForm, rough: bool) -> tuple[Array, bool]:
        """Solve for the variables; true if converged. It starts near the solution, and is never rough."""
        del rough
        if self._solver is None:
            self._solver = osqp.OSQP()
            self._solver.setup(form.hessian, form.gradient, form.rows, form.lower, form.upper, verbose=False,
                               eps_abs=self._tolerance, eps_rel=self._tolerance, max_iter=_OSQP_ITERATIONS)
        else:
            self._solver.update(q=form.gradient, l=form.lower, u=form.upper, Px=form.hessian.data, Ax=form.rows.data)
        result = self._solver.solve(raise_error=False)
        return result.x, result.info.status_val == osqp.SolverStatus.OSQP_SOLVED
