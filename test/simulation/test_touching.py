"""The arm's meshes among zones: apart where they are, touching where they are put into each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.core.zones import Zone
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.tasks import endpoints
from unifeed_ros.simulation.touching import MeshScene


@pytest.mark.parametrize("name", ["panda", "ur10"])
@pytest.mark.parametrize("shape", ["box", "sphere", "capsule"])
def test_a_zone_around_the_tool_is_touched_and_one_away_is_not(name, shape):
    robot, scene = RobotModel(load_robot(config_path("robots", name))), load_scene(config_path("tasks", "table"))
    ends = np.stack(endpoints(robot, scene))
    assert MeshScene(robot, scene).touching(ends) == 0
    size = {"box": (0.1, 0.1, 0.1), "sphere": (0.05,), "capsule": (0.05, 0.2)}[shape]
    for position, count in ((np.add(scene.start, (0.0, 0.0, 0.02)), 1), ((-1.0, 0.0, 0.5), 0)):
        zones = {"it": Zone(shape=shape, position=position, size=size)}
        assert MeshScene(robot, replace(scene, zones=zones)).touching(ends) == count
    assert MeshScene(robot, replace(scene, table_height=0.02, clearance=0.0)).touching(ends) == 0
