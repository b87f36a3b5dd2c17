"""A real arm, and a reward ensemble with random weights."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.inputs import input_names
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Context, Trajectory

START, GOAL = (0.2, 0.2, 0.6), (0.65, -0.4, 0.1)


@pytest.fixture(scope="session")
def panda() -> RobotModel:
    return RobotModel(load_robot(Path(__file__).parents[3] / "config/robots/panda.yaml"))


@pytest.fixture(scope="session")
def context() -> Context:
    return Context(goal=GOAL, task="laptop", objects={"laptop": [0.5, -0.35, 0.0], "cup": [0.3, 0.1, 0.2]})


@pytest.fixture(scope="session")
def straight(panda: RobotModel) -> Trajectory:
    """Rest to rest along the straight line between the postures of start and goal."""
    first = panda.inverse_kinematics(START)
    last = panda.inverse_kinematics(GOAL, seed=first)
    progress = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 61))[:, None]
    return Trajectory(joint_names=panda.joint_names, times=np.linspace(0.0, 4.0, 61),
                      positions=first + progress * (last - first))


@pytest.fixture
def ensemble(context: Context) -> RewardEnsemble:
    return random_ensemble(context, seed=0)


def random_ensemble(context: Context, seed: int, members: int = 3) -> RewardEnsemble:
    rng, names = np.random.default_rng(seed), input_names([context])
    sizes = (len(names), 16, 8, 1)
    layers = list(pairwise(sizes))
    return RewardEnsemble(
        version=1, robot="panda", frame="panda_link0", inputs=names, layer_sizes=sizes, feedback_ids=("d1",), seed=seed,
        weights=tuple(rng.normal(scale=0.7, size=(members, i, o)) for i, o in layers),
        biases=tuple(rng.normal(scale=0.3, size=(members, o)) for _, o in layers))


@pytest.fixture(scope="session")
def ensemble_of(context: Context) -> Callable[[int], RewardEnsemble]:
    """Ensembles with random weights, by seed."""
    return lambda seed: random_ensemble(context, seed)
