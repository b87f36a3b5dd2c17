"""The planner's benchmark: its own check of motions, and its figures."""

from __future__ import annotations

import numpy as np
import pytest

from unifeed_ros.baselines.slsqp import SlsqpResult
from unifeed_ros.cli.bench_planner import _line, _summary, _violation
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.planning.problem import PlanningProblem
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.tasks import endpoints


def test_the_independent_check_finds_what_a_shorter_duration_breaks():
    robot, scene = RobotModel(load_robot(config_path("robots", "panda"))), load_scene(config_path("tasks", "table"))
    start, goal = endpoints(robot, scene)
    config = PlannerConfig(time_budget=60.0, starts=1)
    bounds = motion_bounds(robot, scene, start, goal, config)
    for duration, broken in ((3.0, False), (1.0, True)):
        problem = PlanningProblem(robot, None, start, goal, 3.0, bounds, config)
        plan = plan_motion(robot, None, start, goal, duration=3.0, scene=scene, config=config)
        hurried = plan.trajectory.__class__(
            joint_names=plan.trajectory.joint_names, times=plan.trajectory.times * duration / 3.0,
            positions=plan.trajectory.positions)
        found = _violation(robot, scene, problem, hurried, plan.waypoints)
        assert (found > 0.5) if broken else (found < 1e-3)


def test_summary_takes_medians_and_counts():
    peers = {name: SlsqpResult(np.zeros((2, 1)), seconds, seconds < 5.0) for name, seconds in
             (("exact", 2.0), ("fd", 8.0))}
    problems = [{"seconds": s, "piqp_s": s, "solved": s < 0.3, "floor": 0.01, "violation": s / 100,
                 "first": s / 10, "first_share": s, "touching": 0, "cancel": s / 20, "message": "late"} for s in
                (0.1, 0.2, 0.3)]
    problems[1] |= {**peers, "gap": 0.01, "own_s": 0.4, "osqp_s": 1.0}
    problems[0] |= {"halved_share": 1.5, "halved_gain": 0.001, "full_share": 4.0, "full_gain": 0.002}
    summary = _summary(problems)
    assert (summary["median_s"], summary["own_s"], summary["solved"], summary["problems"]) == (0.2, 0.4, 2, 3)
    assert (summary["ratio_exact"], summary["ratio_fd"]) == pytest.approx((10.0, 40.0))
    assert (summary["slsqp_exact_converged"], summary["slsqp_fd_converged"], summary["fd_problems"]) == (1, 0, 1)
    assert (summary["first_feasible_s"], summary["touching"], summary["failures"]) == (pytest.approx(0.02), 0, ["late"])
    assert (summary["first_feasible_share"], summary["cancel_worst_s"]) == (0.2, pytest.approx(0.015))
    assert summary["worst_violation"] == pytest.approx(0.003)
    line = _line({"robot": "panda", "task": "table", "waypoints": 20, **summary})
    assert "x40" in line and "halved x1.50 of the time, objective +0.100%, full x4.00" in line
