"""The best motion of a task, found by our planner from many starts and looked for again by an independent solver."""

from __future__ import annotations

from typing import NamedTuple

from unifeed_ros.baselines.slsqp import solve_with_slsqp
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.planning.sampling import sample_spline
from unifeed_ros.core.planning.starts import StartRepair
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, endpoints, measure

LIMIT = 20.0
"""Processor time that the other solver is given [s]."""


class ConfirmedOptimum(NamedTuple):
    """An optimum that regret is measured from, and what another solver says of it."""

    yardstick: Yardstick
    """The task with its optimum."""
    gap: float
    """Return of the optimum less that of SciPy's SLSQP, as a share of the straight line's regret [1]; negative where
    SLSQP found better."""


def confirmed_optimum(robot: RobotModel, task: TrueTask, config: PlannerConfig) -> ConfirmedOptimum:
    """Find the optimum of a task, and let SLSQP look for a better one under the same constraints.

    It starts from the straight line, where it sometimes gives up early, and from the optimum itself.

    Args:
        robot: The arm.
        task: True reward and scene.
        config: Settings of the planner.

    Returns:
        The optimum and the gap.

    Raises:
        PlanningError: No motion satisfies the constraints.
        UnreachableError: The arm cannot take the start or the goal.
    """
    yardstick = measure(robot, task, config)
    scene = task.scene
    start, goal = endpoints(robot, scene)
    bounds = motion_bounds(robot, scene, start, goal, config)
    problem = PlanningProblem(robot, task, start, goal, scene.duration, bounds, config)
    repair = StartRepair(problem)
    others = [solve_with_slsqp(problem, first, exact=True, limit=LIMIT).waypoints
              for first in (repair.line, repair(yardstick.optimum.resampled(problem.count)))]
    return ConfirmedOptimum(yardstick, min(yardstick.normalised_regret(sample_spline(
        waypoints, scene.duration, robot.joint_names, config.sample_rate)) for waypoints in others))
