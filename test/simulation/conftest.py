from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene, load_scene
from unifeed_ros.core.types import Trajectory
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, endpoints, straight_line

CONFIG = Path(__file__).parents[2] / "config"


@pytest.fixture(scope="session")
def panda() -> RobotModel:
    return RobotModel(load_robot(CONFIG / "robots/panda.yaml"))


@pytest.fixture(scope="session")
def scenes() -> dict[str, Scene]:
    return {name: load_scene(CONFIG / f"tasks/{name}.yaml") for name in ("table", "laptop", "cup", "proximity")}


@pytest.fixture(scope="session")
def quick_yardstick(panda, scenes) -> Yardstick:
    """A yardstick that needs no planner: the optimum is replaced by a fast motion on the straight line."""
    task = TrueTask(scene=scenes["table"])
    start, goal = endpoints(panda, task.scene)
    times = np.linspace(0.0, task.scene.duration, 301)
    share = np.clip(times / 2.4, 0.0, 1.0)
    share = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    best = Trajectory(joint_names=panda.joint_names, times=times, positions=start + share[:, None] * (goal - start))
    line = straight_line(panda, task.scene, 20)
    return Yardstick(robot=panda, task=task, waypoints=20, optimum=best, optimal_return=task.returns(panda, best, 20),
                     straight_return=task.returns(panda, line, 20))
