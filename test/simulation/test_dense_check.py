"""The check apart from the planner: it finds what was broken on purpose, by as much, and nothing in plans."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.planning.check import TOLERANCE
from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.core.zones import Cone, Zone
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.dense_check import dense_excess
from unifeed_ros.simulation.planning_problems import random_pairs, with_tool_limits
from unifeed_ros.simulation.tasks import TrueTask


@pytest.fixture(scope="module")
def smooth():
    """A robot, a task and the smoothest motion, with nothing but the joints' limits and the table to keep to."""
    robot, scene = RobotModel(load_robot(config_path("robots", "panda"))), load_scene(config_path("tasks", "table"))
    config = PlannerConfig(time_budget=60.0)
    pair = next(random_pairs(robot, scene, config))
    plan = plan_motion(robot, None, pair.start, pair.goal, duration=3.0, scene=pair.scene, config=config)
    assert plan.success
    return robot, pair.scene, plan.waypoints


def test_a_motion_in_less_time_is_too_fast_by_the_factor(smooth):
    robot, scene, waypoints = smooth
    assert max(dense_excess(robot, scene, waypoints, 3.0).values()) == 0.0
    once, hurried = (dense_excess(robot, replace(scene, tool_speed=0.01), waypoints, t) for t in (3.0, 1.0))
    assert hurried["velocity"] > 0.5 and hurried["acceleration"] > 1.0
    assert hurried["tool_speed"] + 0.01 == pytest.approx(3.0 * (once["tool_speed"] + 0.01))


def test_each_limit_of_the_tool_is_missed_by_what_it_is_tightened(smooth):
    robot, scene, waypoints = smooth
    states = robot.tool_states(waypoints)
    tool, tilt = states[:, :3], float(np.arccos(states[:, 3]).max())
    box = (*tool.min(axis=0) - 0.02, *tool.max(axis=0) + np.array([0.02, 0.02, -0.05]))
    middle = tool[len(tool) // 2]
    for change, limit, expected in (
        ({"workspace": box}, "workspace", 0.05),
        ({"cones": {"aside": Cone(direction=(1.0, 0.0, 0.0), angle=1.0)}}, "cone", tilt - 1.0),
        ({"zones": {"slow": Zone(shape="sphere", position=middle, size=(0.1,), speed=1e-6)}}, "slow_zone", 0.1),
        ({"zones": {"slow": Zone(shape="capsule", position=middle, size=(0.1, 0.6), speed=1e-6)}}, "slow_zone", 0.1),
        ({"zones": {"slow": Zone(shape="box", position=middle, size=(2.0, 2.0, 0.2), speed=1e-6)}}, "slow_zone", 0.1),
    ):
        found = dense_excess(robot, replace(scene, **change), waypoints, 3.0)
        assert found[limit] == pytest.approx(expected, abs=0.005), (limit, found)
    dipping = waypoints.copy()
    dipping[len(tool) // 2] = robot.inverse_kinematics((*middle[:2], 0.01), seed=waypoints[len(tool) // 2])
    assert dense_excess(robot, scene, dipping, 3.0)["height"] == pytest.approx(scene.floor - 0.01, abs=0.005)


@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_plans_with_every_limit_of_the_tool_on_exceed_none(name):
    robot = RobotModel(load_robot(config_path("robots", name)))
    scene = with_tool_limits(load_scene(config_path("tasks", "laptop")))
    config = PlannerConfig(time_budget=60.0)
    missed = set()
    for pair in itertools.islice(random_pairs(robot, scene, config), 2):
        for given in (pair.scene, replace(pair.scene, zones={}, cones={}, workspace=(), tool_speed=0.0)):
            plan = plan_motion(robot, TrueTask(scene=pair.scene), pair.start, pair.goal, duration=scene.duration,
                               scene=given, config=config)
            assert plan.success, plan.message
            excess = dense_excess(robot, pair.scene, plan.waypoints, plan.trajectory.duration)
            if given is pair.scene:
                assert max(excess.values()) <= TOLERANCE, excess
            else:
                missed |= {limit for limit, size in excess.items() if size > 0.01}
    assert missed, "the limits do not matter to these motions"
