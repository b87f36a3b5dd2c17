"""The way-points' quadratic programme in sparse form, for the solvers of others.

Its variables are the spline's coefficients, way-point by way-point, each with its slack: in way-points themselves every
rate depends on all of them, in coefficients on four at most.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from unifeed_ros.core.planning.qp import SLACK_CURVATURE, QPConstants, WaypointQP
from unifeed_ros.core.types import Array

_NEGLIGIBLE = 1e-5
"""Share of the largest entry below which an entry is rounding: the limits' maps drop what is smaller."""
_BOUNDLESS = 1e30
_FAR = 10.0
"""Clearance of rows without a bound, whose coefficients are zero: solvers want one finite bound in every row [m]."""


class SparseForm:
    """minimise 1/2 x'P x + q'x subject to lower <= A x <= upper, its patterns fixed and its numbers filled in place.

    Rows are changes, slacks, rates over limits, clearances.

    Attributes:
        points: Number of clearances of each way-point.
        hessian: Upper triangle of P.
        rows: A.
        gradient, lower, upper: q and the rows' bounds.
    """

    def __init__(self, constants: QPConstants, points: int) -> None:
        """Lay out the patterns.

        Args:
            constants: What all programmes share.
            points: Number of clearances P of each way-point.
        """
        self._basis = _without_rounding(constants.basis)
        self._m, self._n = len(constants.basis), len(constants.coupling_weights)
        self._set_up_hessian(constants)
        self._set_up_rows(constants, points)
        self.points = points
        self.gradient = np.zeros(self._m * (self._n + 1))

    def fill(self, qp: WaypointQP) -> None:
        """Write a programme's numbers.

        Args:
            qp: What is to be solved.
        """
        m, n = self._m, self._n
        self.hessian.data[:] = self._constant
        by_pair = self._pair_shares @ qp.blocks.reshape(m, n * n)
        self.hessian.data[self._pair_places] += by_pair.ravel()[self._pair_entries]
        gradient = self.gradient.reshape(m, n + 1)
        gradient[:, :n], gradient[:, n] = self._basis.T @ qp.gradient, qp.penalty
        near = np.isfinite(qp.clearances)
        jacobians = np.where(near[:, :, None], qp.clearance_jacobians, 0.0)
        entries = self._clearance_shares * jacobians.ravel()[self._clearance_entries]
        if qp.rate_jacobians is not None:
            by_rate = np.where(near[:, :, None], qp.rate_jacobians, 0.0)
            entries += self._velocity_shares * by_rate.ravel()[self._clearance_entries]
        self.rows.data[self._clearance_places] = entries
        rates = qp.shares.ravel()
        self.lower = np.concatenate([
            qp.lower.ravel(), np.zeros(m), -1.0 - rates, np.where(near, -qp.clearances, -_FAR).ravel()])
        self.upper = np.concatenate([qp.upper.ravel(), np.full(m, _BOUNDLESS), 1.0 - rates,
                                     np.full(near.size, _BOUNDLESS)])

    def change(self, x: Array) -> Array:
        """Turn variables into changes of the way-points, shape (m, n)."""
        return self._basis @ x.reshape(self._m, self._n + 1)[:, : self._n]

    def _set_up_hessian(self, constants: QPConstants) -> None:
        m, n, basis = self._m, self._n, self._basis
        coupling = _without_rounding(basis.T @ constants.coupling @ basis)
        shares = basis.T[:, None, :] * basis.T[None]  # (m, m, m): of each block in each pair of coefficients
        first, second = np.nonzero(np.triu((np.abs(shares).sum(axis=2) > 0) | (coupling != 0)))
        self._pair_shares = shares[first, second]
        pair, i, j = (v.ravel() for v in np.meshgrid(np.arange(len(first)), np.arange(n), np.arange(n), indexing="ij"))
        kept = (first[pair] < second[pair]) | (i <= j)
        pair, i, j = pair[kept], i[kept], j[kept]
        constant = np.where(i == j, coupling[first[pair], second[pair]] * constants.coupling_weights[i], 0.0)
        slack = np.arange(m) * (n + 1) + n
        row = np.concatenate([first[pair] * (n + 1) + i, slack])
        column = np.concatenate([second[pair] * (n + 1) + j, slack])
        self.hessian, places = _pattern(row, column, (m * (n + 1), m * (n + 1)))
        self._constant = np.zeros(len(row))
        self._constant[places] = np.concatenate([constant, np.full(m, SLACK_CURVATURE)])
        self._pair_places, self._pair_entries = places[: len(pair)], (pair * n + i) * n + j

    def _set_up_rows(self, constants: QPConstants, points: int) -> None:
        m, n, basis = self._m, self._n, self._basis
        rates = _without_rounding(constants.rates @ basis)
        changes = _for_each_joint(basis, np.ones((m, n)))
        limited = _for_each_joint(rates, constants.rate_limits)
        slacks = (np.arange(m), np.arange(m) * (n + 1) + n, np.ones(m))
        velocity = _without_rounding(constants.velocity @ basis)
        way, near = np.nonzero((basis != 0) | (velocity != 0))
        at, point, joint = (v.ravel() for v in np.meshgrid(
            np.arange(len(way)), np.arange(points), np.arange(n), indexing="ij"))
        of_changes = (way[at] * points + point, near[at] * (n + 1) + joint, np.zeros(len(at)))
        of_slacks = (np.arange(m * points), np.repeat(slacks[1], points), np.ones(m * points))
        parts = [of_changes, changes, slacks, limited, of_slacks]
        begin = [m * n + m + rates.shape[0] * n, 0, m * n, m * n + m, m * n + m + rates.shape[0] * n]
        row = np.concatenate([part[0] + offset for part, offset in zip(parts, begin, strict=True)])
        count = begin[0] + m * points
        self.rows, places = _pattern(row, np.concatenate([p[1] for p in parts]), (count, m * (n + 1)))
        self.rows.data[places] = np.concatenate([p[2] for p in parts])
        self._clearance_places, self._clearance_shares = places[: len(at)], basis[way[at], near[at]]
        self._velocity_shares = velocity[way[at], near[at]]
        self._clearance_entries = (way[at] * points + point) * n + joint


def _pattern(row: Array, column: Array, shape: tuple[int, int]) -> tuple[sparse.csc_matrix, NDArray[np.intp]]:
    """Make a matrix with the given places, all different, and tell where in its data each of them is."""
    order = np.lexsort((row, column))
    places = np.empty(len(order), dtype=np.intp)
    places[order] = np.arange(len(order))
    starts = np.concatenate([[0], np.cumsum(np.bincount(column, minlength=shape[1]))])
    return sparse.csc_matrix((np.zeros(len(row)), row[order].astype(np.int32), starts.astype(np.int32)), shape), places


def _for_each_joint(matrix: Array, limits: Array) -> tuple[Array, Array, Array]:
    """Write rows (r, joint) of a map that is the same for all joints but for its limits: row, column, value."""
    n = limits.shape[1]
    row, column = np.nonzero(matrix)
    joint = np.tile(np.arange(n), len(row))
    row, column = np.repeat(row, n), np.repeat(column, n)
    return row * n + joint, column * (n + 1) + joint, matrix[row, column] / limits[row, joint]


def _without_rounding(matrix: Array) -> Array:
    return np.where(np.abs(matrix) < _NEGLIGIBLE * np.abs(matrix).max(), 0.0, matrix)
