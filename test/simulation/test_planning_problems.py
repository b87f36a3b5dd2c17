"""Random planning problems: reachable, feasible for the planner, the same for the same seed."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.planning_problems import random_pairs
from unifeed_ros.simulation.tasks import TrueTask


@pytest.mark.parametrize("name", ["panda", "ur10"])
def test_pairs_can_be_planned_and_end_where_their_scene_says(name):
    robot, scene = RobotModel(load_robot(config_path("robots", name))), load_scene(config_path("tasks", "table"))
    config = PlannerConfig(time_budget=60.0, starts=1)
    pairs, again = (list(itertools.islice(random_pairs(robot, scene, config, seed=3), 3)) for _ in range(2))
    for pair, same in zip(pairs, again, strict=True):
        np.testing.assert_array_equal(pair.goal, same.goal)
        ends = robot.tool_states(np.array([pair.start, pair.goal]))[:, :3]
        np.testing.assert_allclose(ends, [pair.scene.start, pair.scene.goal], atol=2e-4)
        plan = plan_motion(robot, TrueTask(scene=pair.scene), pair.start, pair.goal, duration=scene.duration,
                           scene=pair.scene, config=config)
        assert plan.success, plan.message
        assert plan.trajectory.duration == pytest.approx(scene.duration)
    assert not np.allclose(pairs[0].goal, pairs[1].goal)
