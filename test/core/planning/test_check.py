"""The bounds of a motion and the check of every sample."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.errors import InputError, PlanningError, ShapeError
from unifeed_ros.core.planning.check import check_motion, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.sampling import rest_to_rest, sample_spline

CONFIG = PlannerConfig()


def _check(case, start, goal, duration=3.0, bounds=None):
    bounds = bounds or motion_bounds(case.robot, case.scene, case.start, case.goal, CONFIG)
    waypoints = start + rest_to_rest(20)[:, None] * (goal - start)
    motion = sample_spline(waypoints, duration, case.robot.joint_names, 100.0)
    return check_motion(motion, bounds)


def test_a_slow_line_between_the_ends_is_fine(case):
    check = _check(case, case.start, case.goal, duration=6.0)
    assert check.ok and check.slowdown == 1.0 and check.shortfall == 0.0


@pytest.mark.parametrize("duration", [0.5, 1.0, 1.5])
def test_slowing_down_as_told_cures_speed_and_acceleration(case, duration):
    check = _check(case, case.start, case.goal, duration)
    assert not check.ok and check.slowdown > 1.0
    assert any("rad/s" in problem for problem in check.problems)
    assert _check(case, case.start, case.goal, duration * check.slowdown).ok


def test_positions_outside_the_limits_name_the_joint(case):
    beyond = case.start.copy()
    beyond[0] = case.robot.upper[0] + 0.2
    check = _check(case, case.start, beyond, duration=60.0)
    assert check.position_excess[0] == pytest.approx(0.2, abs=1e-6)
    assert case.robot.joint_names[0] in check.problems[0]


def test_a_tool_that_dips_is_found(case):
    low = case.robot.inverse_kinematics((0.5, -0.2, 0.01), seed=case.goal)
    check = _check(case, case.start, low, duration=60.0)
    assert check.shortfall == pytest.approx(case.scene.floor - 0.01, abs=1e-3)
    assert case.robot.config.tool_frame in " ".join(check.problems)


def test_an_elbow_that_dips_is_found(case):
    bounds = motion_bounds(case.robot, case.scene, case.start, case.goal, CONFIG)
    heights = bounds.constraints[0]
    high = replace(heights, bounds=heights.bounds + np.eye(len(heights.bounds))[0] * 2.0)
    raised = replace(bounds, constraints=(high, *bounds.constraints[1:]))
    assert heights.names[0] in _check(case, case.start, case.goal, 6.0, raised).problems[0]


def test_a_start_close_to_a_limit_may_stay_as_close(panda):
    close = panda.start.copy()
    close[0] = panda.robot.upper[0] + 0.02
    bounds = motion_bounds(panda.robot, panda.scene, close, panda.goal, CONFIG)
    assert bounds.upper[0] == close[0] and bounds.upper[1] == panda.robot.upper[1]
    low = panda.robot.inverse_kinematics((0.5, 0.0, 0.02), seed=panda.start)
    heights = motion_bounds(panda.robot, panda.scene, low, panda.goal, CONFIG).constraints[0]
    assert heights.bounds[-1] == pytest.approx(0.02, abs=1e-3)


def test_ends_that_contradict_the_bounds_are_refused_with_numbers(case):
    robot, scene = case.robot, case.scene
    low = robot.inverse_kinematics((0.5, 0.0, 0.01), seed=case.start)
    with pytest.raises(PlanningError, match=r"goal .*comes down to 0\.010\d m, floor 0\.0500 m"):
        motion_bounds(robot, scene, case.start, low, CONFIG)
    with pytest.raises(PlanningError, match=r"start .*comes down to 0\.010\d m, floor 0\.0500 m"):
        motion_bounds(robot, replace(scene, table_height=0.05, clearance=0.0), low, case.goal, CONFIG)
    beyond = case.start.copy()
    beyond[0] = robot.upper[0] + 0.02
    with pytest.raises(PlanningError, match=f"goal .*{robot.joint_names[0]}.*limit"):
        motion_bounds(robot, scene, case.start, beyond, CONFIG)
    beyond[0] += 1.0
    with pytest.raises(InputError, match="outside its limits"):
        motion_bounds(robot, scene, beyond, case.goal, CONFIG)
    with pytest.raises(InputError, match="not finite"):
        motion_bounds(robot, scene, case.start, np.full(robot.n, np.nan), CONFIG)
    with pytest.raises(ShapeError):
        motion_bounds(robot, scene, case.start[:-1], case.goal, CONFIG)
