"""From a reward to a motion that the arm can follow (paper eq. M10)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.planning.check import MotionBounds, MotionCheck, check_motion, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import PlanningProblem, StateReward
from unifeed_ros.core.planning.sampling import sample_spline, shortest_duration
from unifeed_ros.core.planning.search import PlanProgress, Search, Status
from unifeed_ros.core.planning.starts import StartRepair, start_motions
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory, frozen_array

__all__ = ["Plan", "PlanProgress", "PlannerConfig", "plan_motion"]

_SHORTEST = 0.5
"""Duration of a motion that hardly moves, where none is asked for [s]."""
_LONGER = 1.03
"""Factor by which a duration is lengthened until way-points can keep it [1]."""
_TRIALS = 12
_RAISES = 3
"""How often the floor is raised because the spline between way-points dips below it."""


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
    """Largest distance of any sample below the floor [m]."""
    iterations: int
    """Quadratic programmes solved, over all starts."""
    seconds: float
    """Wall-clock time [s]."""


def plan_motion(
    robot: RobotModel,
    reward: StateReward | None,
    start: Array,
    goal: Array | None,
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
        goal: Joint positions at the end, shape (n,) [rad]; None: wherever the reward leads.
        duration: Time from start to end [s]; 0: the shortest possible one times the configured slack.
        scene: Table and clearance.
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
    goal = None if goal is None else frozen_array("goal of the motion", goal, (robot.n,))
    bounds = motion_bounds(robot, scene, start, goal, config.arm_radius)
    search = Search(config, on_iteration, should_stop)
    problem, repair = _feasible_problem(robot, reward, start, goal, _duration(start, goal, duration, bounds, config),
                                        bounds, config)
    search.improve(problem, start_motions(problem, repair, seeds, config))
    trajectory, check = _followable(robot, problem, search.best, config)
    for _ in range(_RAISES):
        if check.ok or check.height_shortfall == 0.0 or search.has_ended():
            break
        problem = problem.raised(check.height_shortfall)
        search.improve(problem, [search.best])
        trajectory, check = _followable(robot, problem, search.best, config)
    return _plan(search, problem, trajectory, check, duration)


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


def _feasible_problem(robot: RobotModel, reward: StateReward | None, start: Array, goal: Array | None, duration: float,
                      bounds: MotionBounds, config: PlannerConfig) -> tuple[PlanningProblem, StartRepair]:
    """Build the problem for the shortest duration, from the given one on, that way-points can keep."""
    for trial in range(_TRIALS):
        problem = PlanningProblem(robot, reward, start, goal, duration * _LONGER**trial, bounds, config)
        try:
            return problem, StartRepair(problem)
        except PlanningError:
            continue
    raise PlanningError("no motion from start to goal keeps the limits of speed and acceleration",
                        expected=f"a duration over {problem.duration:.2f} s", got=f"{duration:.2f} s",
                        mend="allow more time, or more way-points")


def _followable(robot: RobotModel, problem: PlanningProblem, waypoints: Array,
                config: PlannerConfig) -> tuple[Trajectory, MotionCheck]:
    """Sample way-points, and slow them down where that keeps the limits of speed and acceleration."""
    trajectory = sample_spline(waypoints, problem.duration, robot.joint_names, config.sample_rate)
    check = check_motion(trajectory, problem.bounds, problem.points)
    if check.ok or not 1.0 < check.slowdown <= config.max_slowdown:
        return trajectory, check
    slower = problem.duration * check.slowdown
    trajectory = sample_spline(waypoints, slower, robot.joint_names, config.sample_rate)
    return trajectory, check_motion(trajectory, problem.bounds, problem.points)


def _plan(search: Search, problem: PlanningProblem, trajectory: Trajectory, check: MotionCheck, wanted: float) -> Plan:
    """Say how it went."""
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
    return Plan(trajectory=trajectory, waypoints=search.best, status=status, success=success, message=message,
                objective=-problem.scale * problem.evaluate(search.best).cost, violation=check.height_shortfall,
                iterations=search.count, seconds=search.seconds)
