"""Motions that the search starts from, all within the limits of speed and acceleration."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.planning.qp import QPSolver, WaypointQP
from unifeed_ros.core.planning.sampling import rest_to_rest
from unifeed_ros.core.planning.solvers import make_solver
from unifeed_ros.core.types import Array, frozen_array

_DEFORMATION = 0.5
"""Standard deviation of a joint in the middle of a deformed start, before it is made feasible [rad]."""
_FEASIBLE_SHARE = 1.005
"""Share of a rate limit, less the margin, that a repaired start may take for feasible [1]."""


class StartRepair:
    """Moves way-points as little as possible until they keep all linear limits.

    minimise ||Q - Q_wanted||^2 subject to the limits of position, velocity and acceleration.

    Attributes:
        line: The straight line from start to goal, repaired, shape (H, n) [rad].
    """

    def __init__(self, problem: PlanningProblem) -> None:
        """Set up the quadratic programme and find the straight line, from which all others are found.

        Raises:
            PlanningError: No way-points keep all limits between these ends in this time.
        """
        self._problem = problem
        line = straight_line(problem)
        self.line = self._nearest(line, line)

    @cached_property
    def _solver(self) -> QPSolver:
        """The solver, set up where a start needs it."""
        problem = self._problem
        m, n = len(problem.free), problem.joints
        return make_solver(problem.qp_solver, problem.qp_constants()._replace(
            coupling=np.zeros((m, m)), coupling_weights=np.zeros(n)))

    def __call__(self, waypoints: Array) -> Array:
        """Repair way-points.

        Args:
            waypoints: Wanted joint positions with the right ends, shape (H, n) [rad].

        Returns:
            Feasible joint positions, shape (H, n) [rad].
        """
        return self._nearest(waypoints, self.line)

    def _nearest(self, wanted: Array, base: Array) -> Array:
        """Find the feasible way-points nearest to wanted ones, starting from a base inside the position limits."""
        problem = self._problem
        inside = wanted[problem.free]
        if (np.abs(problem.rate_shares(wanted)).max() <= 1.0 and (inside >= problem.lower).all()
                and (inside <= problem.upper).all()):
            return wanted
        m, n = len(problem.free), problem.joints
        free, lower, upper = base[problem.free], problem.lower, problem.upper
        change = self._solver.solve(WaypointQP(
            gradient=free - inside, blocks=np.tile(np.eye(n), (m, 1, 1)), lower=lower - free,
            upper=upper - free, shares=problem.rate_shares(base), clearances=np.zeros((m, 0)),
            clearance_jacobians=np.zeros((m, 0, n)), penalty=1.0)).change
        nearest = problem.complete(np.clip(free + change, lower, upper))
        share = float(np.abs(problem.rate_shares(nearest)).max())
        if share > _FEASIBLE_SHARE:
            raise PlanningError("the limits of speed and acceleration allow no motion in this time",
                                expected="at most 1 of the limits", got=f"{share:.3f}")
        return nearest


def straight_line(problem: PlanningProblem) -> Array:
    """Go from start to goal on a joint-space line, speeding up and slowing down, shape (H, n) [rad]."""
    goal = problem.start if problem.aim is None else problem.aim
    return problem.start + rest_to_rest(problem.count)[:, None] * (goal - problem.start)


def start_motions(problem: PlanningProblem, repair: StartRepair, seeds: Sequence[Array],
                  config: PlannerConfig) -> Iterator[Array]:
    """Yield the straight line, then the given seeds, then deformed lines, repaired.

    Args:
        problem: What is to be solved.
        repair: Makes a start feasible.
        seeds: Way-points that are likely good, shape (H, n) each [rad]; their ends are bent to the problem's.
        config: Number of starts and the deformations' seed.

    Yields:
        Way-points, shape (H, n) [rad].

    Raises:
        ShapeError: A seed of another shape.
        InputError: A seed that is not finite.
    """
    line = repair.line
    yield line
    for seed in seeds:
        yield repair(_with_ends(frozen_array("seed of the search", seed, line.shape), problem))
    rng = np.random.default_rng(config.seed)
    share = rest_to_rest(problem.count)[:, None]
    bump = share if problem.aim is None else 4.0 * share * (1.0 - share)
    for _ in range(config.starts - 1 - len(seeds)):
        yield repair(line + bump * rng.normal(scale=_DEFORMATION, size=problem.joints))


def _with_ends(waypoints: Array, problem: PlanningProblem) -> Array:
    """Bend way-points so that they begin at the start and end at the goal."""
    share = rest_to_rest(problem.count)[:, None]
    bent = waypoints + (1.0 - share) * (problem.start - waypoints[0])
    return bent if problem.goal is None else bent + share * (problem.goal - waypoints[-1])
