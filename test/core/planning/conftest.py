"""Two real arms, one task, and rewards whose optima are known."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene, load_scene

CONFIG = Path(__file__).parents[3] / "config"


@dataclass(frozen=True)
class Near:
    """Minus the squared distance to a point."""

    point: np.ndarray
    gain: float = 1.0

    def value_and_gradient(self, tool_states):
        away = tool_states[:, :3] - self.point
        gradients = np.zeros_like(tool_states)
        gradients[:, :3] = -2.0 * self.gain * away
        return -self.gain * (away**2).sum(axis=1), gradients


@dataclass(frozen=True)
class Network:
    """A random smooth network of the learned reward's size, between -1 and 1."""

    first: np.ndarray
    second: np.ndarray
    last: np.ndarray

    @staticmethod
    def random(seed: int, width: int = 64) -> Network:
        rng = np.random.default_rng(seed)
        scale = 1.0 / np.sqrt(width)
        return Network(rng.normal(size=(6, width)), rng.normal(scale=1.5 * scale, size=(width, width)),
                       rng.normal(scale=scale, size=width))

    def value_and_gradient(self, tool_states):
        one = np.tanh(tool_states @ self.first)
        two = np.tanh(one @ self.second)
        value = np.tanh(two @ self.last)
        slope = (1.0 - value**2)[:, None] * self.last * (1.0 - two**2)
        return value, ((slope @ self.second.T) * (1.0 - one**2)) @ self.first.T


class Down:
    """The lower, the better."""

    def value_and_gradient(self, tool_states):
        gradients = np.zeros_like(tool_states)
        gradients[:, 2] = -1.0
        return -tool_states[:, 2], gradients


@dataclass(frozen=True)
class Case:
    """An arm with a task and the postures at its ends."""

    robot: RobotModel
    scene: Scene
    start: np.ndarray
    goal: np.ndarray


def make_case(name: str, task: str = "table") -> Case:
    robot, scene = RobotModel(load_robot(CONFIG / f"robots/{name}.yaml")), load_scene(CONFIG / f"tasks/{task}.yaml")
    start = robot.inverse_kinematics(scene.start, scene.axis)
    return Case(robot, scene, start, robot.inverse_kinematics(scene.goal, scene.axis, seed=start))


@pytest.fixture(scope="session", params=["panda", "ur10"])
def case(request) -> Case:
    return make_case(request.param)


@pytest.fixture(scope="session")
def panda() -> Case:
    return make_case("panda")


@pytest.fixture(scope="session")
def rewards():
    """Makers of rewards, for tests that cannot import this file."""
    return {"near": Near, "network": Network.random, "down": Down}
