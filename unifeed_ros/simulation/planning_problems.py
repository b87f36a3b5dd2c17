"""Planning problems like those of a lesson: learned rewards, and random starts and goals."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Demonstration
from unifeed_ros.core.planning.check import motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.sampling import shortest_duration
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array
from unifeed_ros.simulation.person import SimulatedPerson
from unifeed_ros.simulation.rig import LessonError, Rig
from unifeed_ros.simulation.tasks import TrueTask, endpoints, measure

_SPREAD = 0.1
"""Largest distance of a random start or goal from the task's own in each direction [m]."""
_HURRY = 0.85
"""Largest share of the task's duration that the fastest motion may take [1]."""


class PlanningPair(NamedTuple):
    """A random start and goal."""

    scene: Scene
    """The task, with that start and goal."""
    start: Array
    """Joint positions, shape (n,) [rad]."""
    goal: Array
    """Joint positions, shape (n,) [rad]."""


def taught_reward(robot: RobotModel, scene: Scene, *, demonstrations: int = 2, seed: int = 0) -> RewardEnsemble:
    """Let a simulated person demonstrate a task, and learn from it.

    Args:
        robot: The arm.
        scene: The task.
        demonstrations: Number of demonstrations.
        seed: Seed of the person and the training.

    Raises:
        LessonError: Capture found nothing in a demonstration.
    """
    person = SimulatedPerson(measure(robot, TrueTask(scene=scene)), seed)
    dataset = FeedbackDataset(robot.config.name, robot.joint_names)
    for k in range(demonstrations):
        rig = Rig(robot, table_height=scene.table_height, seed=seed + k, start=endpoints(robot, scene)[0])
        shown = rig.guide(person)
        if shown.trajectory is None:
            raise LessonError("a demonstration could not be captured", got=shown.reason)
        dataset.add(Demonstration(id=str(k), robot=robot.config.name, context=scene.context(),
                                  trajectory=shown.trajectory))
    return train_reward(dataset, robot, TrainingConfig(), version=1, seed=seed).ensemble


def random_pairs(robot: RobotModel, scene: Scene, config: PlannerConfig, seed: int = 0) -> Iterator[PlanningPair]:
    """Yield random starts and goals near the task's own that the arm can reach in the task's duration.

    Args:
        robot: The arm.
        scene: The task.
        config: Settings of the planner, whose limits both ends keep.
        seed: Seed of the draws.
    """
    rng = np.random.default_rng(seed)
    while True:
        ends = [end + rng.uniform(-_SPREAD, _SPREAD, size=3) for end in (scene.start, scene.goal)]
        for end in ends:
            end[2] = max(end[2], scene.floor + 1e-3)
        moved = replace(scene, start=ends[0], goal=ends[1])
        try:
            start, goal = endpoints(robot, moved)
            bounds = motion_bounds(robot, moved, start, goal, config)
        except UnifeedError:
            continue
        if shortest_duration(goal - start, bounds.velocity, bounds.acceleration) < _HURRY * scene.duration:
            yield PlanningPair(moved, start, goal)
