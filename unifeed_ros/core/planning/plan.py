"""From a reward to a motion that the arm can follow (paper eq. M10)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.check import TOLERANCE, MotionBounds, MotionCheck, check_motion, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.goals import ToolGoal
from unifeed_ros.core.planning.problem import Evaluation, PlanningProblem, StateReward
from unifeed_ros.core.planning.sampling import sample_spline, shortest_duration
from unifeed_ros.core.planning.search import PlanProgress, Search, Status
from unifeed_ros.core.planning.starts import StartRepair, start_motions
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory, frozen_array

__all__ = ["Plan", "PlanProgress", "PlannerConfig", "ToolGoal", "plan_motion"]

_SHORTEST = 0.5
"""Duration of a motion that hardly moves, where none is asked for [s]."""
_LONGER = 1.03
"""Factor by which a duration is lengthened until way-points can keep it [1]."""
_TRIALS = 12
_RAISES = 8
"""How often margins grow because the spline between way-points misses a bound."""
_DETOURS = 4
"""Deformed starts that are tried where the straight line and the seeds lead to no motion."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """A motion and how it was found."""

    trajectory: Trajectory
    """The motion with velocities and accelerations; only to be carried out on success."""
    waypoints: Array
    """The way-points that it goes through, shape (H, n) [rad]."""
    status: Status
    """How the search ended."""
    success: bool
    """True if every sample of the motion keeps to all limits."""
    message: str
    """What happened, for a person."""
    objective: float
    """Return less roughness [reward]."""
    violation: float
    """Largest distance of any sample below a constraint's bound [m]."""
    iterations: int
    """Quadratic programmes solved, over all starts."""
    seconds: float
    """Wall-clock time [s]."""
    first_feasible: float
    """Wall-clock time until way-points first kept all constraints; nan: never [s]."""


def plan_motion(
    robot: RobotModel,
    reward: StateReward | None,
    start: Array,
    goal: Array | ToolGoal | None,
    *,
    duration: float,
    scene: Scene,
    config: PlannerConfig,
    on_iteration: Callable[[PlanProgress], None] | None = None,
    should_stop: Callable[[], bool] | None = None,
    seeds: Sequence[Array] = (),
) -> Plan:
    """Find the motion of the largest return (paper eq. M10) that the arm can follow.

    Args:
        robot: The arm.
        reward: Reward of single states; None for the smoothest motion.
        start: Joint positions at the start, shape (n,) [rad].
        goal: Joint positions at the end, shape (n,) [rad]; or where the tool ends; None: wherever the reward leads.
        duration: Time from start to end [s]; 0: the shortest possible one times the configured slack.
        scene: Table, zones, cones, workspace and speed of the tool.
        config: Settings.
        on_iteration: Called after each iteration.
        should_stop: Polled before each iteration; True ends the search with status "canceled".
        seeds: Further way-points to start from, shape (H, n) each [rad].

    Returns:
        The best motion found. A duration that is too short is lengthened by up to the configured factor, and the
        message says so; the trajectory's duration is the one that holds.

    Raises:
        PlanningError: Start, goal, duration and limits contradict each other, or the reward is not finite.
        InputError: Start or goal is not finite or outside the URDF's limits.
        ShapeError: Start, goal or a seed has another shape.
    """
    start = frozen_array("start of the motion", start, (robot.n,))
    fixed = None if goal is None or isinstance(goal, ToolGoal) else frozen_array("goal of the motion", goal, (robot.n,))
    ends = (goal.constraint(config.goal_tolerance),) if isinstance(goal, ToolGoal) else ()
    bounds = motion_bounds(robot, scene, start, fixed, config, ends)
    aim = goal.guess(robot, start) if isinstance(goal, ToolGoal) else fixed
    search = Search(config, on_iteration, should_stop)
    first = _duration(start, aim, duration, bounds, config)
    problem, repair = _feasible_problem(robot, reward, start, fixed, aim, first, bounds, config)
    found = _search(search, problem, start_motions(problem, repair, seeds, config), config)
    if not found.check.ok and not search.has_ended():
        detours = replace(config, starts=1 + _DETOURS, seed=config.seed + 1)
        other = _search(search, problem, islice(start_motions(problem, repair, (), detours), 1, None), config)
        found = min(found, other, key=lambda one: (not one.check.ok, one.check.shortfall))
    return _plan(search, found, duration)


class _Found(NamedTuple):
    """The best way-points of a search, and the motion through them."""

    problem: PlanningProblem
    at: Evaluation
    trajectory: Trajectory
    check: MotionCheck


def _search(search: Search, problem: PlanningProblem, starts: Iterable[Array], config: PlannerConfig) -> _Found:
    """Improve starts, and give way-points larger margins where the spline between them misses a bound."""
    search.improve(problem, starts)
    found = _followable(problem, search.best, config)
    for _ in range(_RAISES):
        excess = np.maximum(found.check.position_excess, 0.0)
        if found.check.ok or max(found.check.shortfall, float(excess.max())) <= TOLERANCE or search.has_ended():
            break
        problem = problem.raised(search.best.waypoints, found.check.shortfalls, excess)
        search.improve(problem, [problem.within(search.best.waypoints)])
        found = _followable(problem, search.best, config)
    return found


def _duration(start: Array, goal: Array | None, asked: float, bounds: MotionBounds, config: PlannerConfig) -> float:
    """Choose a duration where none is asked for, and lengthen one that no motion could keep."""
    if not (np.isfinite(asked) and asked >= 0):
        raise PlanningError("duration of the motion", expected="0 or more seconds", got=asked)
    if goal is None:
        if asked == 0:
            raise PlanningError("duration of a motion without a goal", expected="> 0 s", got=asked)
        return asked
    shortest = shortest_duration(goal - start, bounds.velocity, bounds.acceleration)
    if asked == 0:
        return max(config.slack * shortest, _SHORTEST)
    if shortest > asked * config.max_slowdown:
        raise PlanningError("start and goal are too far apart for the duration", expected=f"{shortest:.2f} s or more",
                            got=f"{asked:.2f} s", mend="allow more time, or raise the robot's limits")
    return max(asked, shortest)


def _feasible_problem(robot: RobotModel, reward: StateReward | None, start: Array, goal: Array | None,
                      aim: Array | None, duration: float, bounds: MotionBounds,
                      config: PlannerConfig) -> tuple[PlanningProblem, StartRepair]:
    """Build the problem for the shortest duration, from the given one on, that way-points can keep."""
    for trial in range(_TRIALS):
        problem = PlanningProblem(robot, reward, start, goal, duration * _LONGER**trial, bounds, config, guess=aim)
        try:
            return problem, StartRepair(problem)
        except PlanningError:
            continue
    raise PlanningError("no motion from start to goal keeps the limits of speed and acceleration",
                        expected=f"a duration over {problem.duration:.2f} s", got=f"{duration:.2f} s",
                        mend="allow more time, or more way-points")


def _followable(problem: PlanningProblem, at: Evaluation, config: PlannerConfig) -> _Found:
    """Sample way-points, and slow them down where that keeps the limits of speed, acceleration and jerk."""
    waypoints, duration = at.waypoints, problem.duration
    check = _checked(problem, waypoints, duration, config)
    if not check.ok and 1.0 < check.slowdown <= config.max_slowdown:
        duration *= check.slowdown
        check = _checked(problem, waypoints, duration, config)
    motion = sample_spline(waypoints, duration, problem.joint_names, config.sample_rate)
    return _Found(problem, at, motion, check)


def _checked(problem: PlanningProblem, waypoints: Array, duration: float, config: PlannerConfig) -> MotionCheck:
    """Check a motion at the controller's rate."""
    return check_motion(sample_spline(waypoints, duration, problem.joint_names, config.check_rate), problem.bounds)


def _plan(search: Search, found: _Found, wanted: float) -> Plan:
    """Say how it went."""
    problem, at, trajectory, check = found
    success = check.ok and search.status != "canceled"
    status = search.status if check.ok or search.status == "canceled" else "infeasible"
    message = {
        "solved": f"solved in {search.count} iterations",
        "time_budget": f"the time budget ended the search after {search.count} iterations; this is the best so far",
        "canceled": f"canceled after {search.count} iterations",
        "infeasible": "no motion keeps all limits: " + "; ".join(check.problems),
    }[status]
    if success and wanted and trajectory.duration > wanted * (1 + 1e-9):
        message += f"; slowed down from {wanted:.2f} s to {trajectory.duration:.2f} s to keep the limits"
    return Plan(trajectory=trajectory, waypoints=at.waypoints, status=status, success=success, message=message,
                objective=-problem.scale * at.cost, violation=check.shortfall,
                iterations=search.count, seconds=search.seconds, first_feasible=search.first_feasible)
