"""What the tests of experiments share."""

from __future__ import annotations

import pytest

from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.resources import config_path


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def scene():
    return load_scene(config_path("tasks", "table"))
