"""Searching from several starts: the best way-points so far, and when to stop looking."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator
from typing import Literal, NamedTuple

import numpy as np

from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem
from unifeed_ros.core.planning.sqp import first_curvature, iterations, merit
from unifeed_ros.core.planning.subproblem import Subproblem
from unifeed_ros.core.types import Array

Status = Literal["solved", "time_budget", "infeasible", "canceled"]

_FEASIBLE = 3e-4
"""Distance below a bound at a way-point that still counts as feasible; the margins cover it [m]."""


class PlanProgress(NamedTuple):
    """Where a search stands."""

    iteration: int
    """Iterations so far, over all starts."""
    objective: float
    """Return less roughness of the present way-points [reward]."""
    violation: float
    """Largest distance of a constraint's value below its bound [m]."""
    best: float
    """Objective of the best feasible way-points so far, -inf before the first [reward]."""


class Search:
    """One search: its clock, its callbacks and its best way-points.

    Attributes:
        status: "solved", or what ended the search before that.
        count: Iterations so far, over all starts.
        first_feasible: Time until way-points first kept all constraints, nan before [s].
    """

    def __init__(self, config: PlannerConfig, on_iteration: Callable[[PlanProgress], None] | None = None,
                 should_stop: Callable[[], bool] | None = None) -> None:
        """Start the clock."""
        self._config, self._on_iteration, self._should_stop = config, on_iteration, should_stop
        self._began = time.perf_counter()
        self._best: Evaluation | None = None
        self.status: Status = "solved"
        self.count = 0
        self.first_feasible = float("nan")

    @property
    def best(self) -> Evaluation:
        """The problem at the best way-points so far, feasible ones before others."""
        assert self._best is not None, "improve comes first"
        return self._best

    @property
    def seconds(self) -> float:
        """Wall-clock time since the search began [s]."""
        return time.perf_counter() - self._began

    def has_ended(self) -> bool:
        """Poll the caller and the clock: True if the search was canceled or has used up its time."""
        if self.status == "solved":
            if self._should_stop is not None and self._should_stop():
                self.status = "canceled"
            elif self.seconds > self._config.time_budget:
                self.status = "time_budget"
        return self.status != "solved"

    def improve(self, problem: PlanningProblem, starts: Iterable[Array]) -> None:
        """Search a problem from several starts together; what was found for another problem is forgotten.

        All go on for a few iterations each, then the worse half is given up, until one is left (successive halving,
        Jamieson and Talwalkar 2016).

        Args:
            problem: What to solve.
            starts: Way-points that keep the linear constraints, shape (H, n) each [rad].

        Raises:
            PlanningError: The reward is not finite, or a start cannot be made feasible.
        """
        self._best = None
        subproblem, runs = Subproblem(problem), []
        for start in starts:
            first = problem.evaluate(start)
            self._keep(first)
            blocks = first_curvature(problem, first)
            runs.append(_Run(first, iterations(problem, subproblem, first, blocks, self._config)))
            if self.has_ended() or not self._go_on(problem, runs[-1]):
                return
        while runs := sorted((run for run in runs if not run.ended), key=lambda run: _rank(run.present)):
            runs = runs[: -(-len(runs) // 2)]
            if not all(self._go_on(problem, run) for run in runs):
                return

    def _go_on(self, problem: PlanningProblem, run: _Run) -> bool:
        """Take a start a few iterations further; false if the whole search has ended."""
        for _ in range(self._config.halving or self._config.max_iterations):
            if not run.go_on():
                break
            self.count += 1
            self._keep(run.present)
            self._report(problem, run.present)
            if self.has_ended():
                return False
        return True

    def _keep(self, present: Evaluation) -> None:
        if np.isnan(self.first_feasible) and present.violation <= _FEASIBLE:
            self.first_feasible = self.seconds
        if self._best is None or _rank(present) < _rank(self._best):
            self._best = present

    def _report(self, problem: PlanningProblem, present: Evaluation) -> None:
        if self._on_iteration is None or self._best is None:
            return
        feasible = self._best.violation <= _FEASIBLE
        self._on_iteration(PlanProgress(
            iteration=self.count, objective=-problem.scale * present.cost, violation=present.violation,
            best=-problem.scale * self._best.cost if feasible else -np.inf))


def _rank(at: Evaluation) -> tuple[bool, float]:
    """Order evaluations: feasible ones first, by cost; then the others, by the merit function."""
    infeasible = at.violation > _FEASIBLE
    return infeasible, merit(at) if infeasible else at.cost


class _Run:
    """The search from one start."""

    def __init__(self, first: Evaluation, steps: Iterator[Evaluation]) -> None:
        self.present, self.ended, self._steps = first, False, steps

    def go_on(self) -> bool:
        """Take one iteration; false if there is none any more."""
        following = next(self._steps, None)
        self.ended = following is None
        self.present = following or self.present
        return not self.ended
