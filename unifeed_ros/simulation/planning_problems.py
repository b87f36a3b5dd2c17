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
from unifeed_ros.core.zones import Cone, Zone
from unifeed_ros.simulation.person import SimulatedPerson
from unifeed_ros.simulation.rig import LessonError, Rig
from unifeed_ros.simulation.tasks import TrueTask, endpoints, measure

_SPREAD = 0.1
"""Largest distance of a random start or goal from the task's own in each direction [m]."""
_HURRY = 0.85
"""Largest share of the task's duration that the fastest motion may take [1]."""

ZONES = {"laptop": Zone(shape="box", position=np.array([0.45, -0.05, 0.12]), size=np.array([0.3, 0.2, 0.24])),
         "person": Zone(shape="capsule", position=np.array([0.8, 0.25, 0.6]), size=np.array([0.15, 1.2]))}
"""A laptop and a person beside and on the way of the tasks' motions, whom the whole arm keeps out of."""
_LAPTOP_PLACES = np.array([[0.25, -0.45], [0.75, 0.45]])
"""Smallest and largest x and y of the middle of a laptop at a random place [m]."""
_PERSON_DISTANCES = (0.55, 1.0)
"""Smallest and largest distance of a person at a random place from the arm's base [m]."""
_PERSON_DIRECTIONS = 1.6
"""Largest angle between the directions from the base to a person at a random place and ahead [rad]."""

_ROOM = 0.2
"""Distance of a workspace's faces from start and goal [m]."""


def with_tool_limits(scene: Scene) -> Scene:
    """Limit the tool in every way that there is: a cone, a slow zone on its way, its speed, and a workspace.

    Args:
        scene: A task.
    """
    slow = Zone(shape="sphere", position=0.5 * (scene.start + scene.goal), size=np.array([0.12]), speed=0.35)
    low, high = np.minimum(scene.start, scene.goal) - _ROOM, np.maximum(scene.start, scene.goal) + _ROOM
    return replace(scene, zones={**scene.zones, "careful": slow}, tool_speed=0.8, workspace=(*low, *high),
                   cones={"upright": Cone(direction=scene.axis, angle=0.3)})


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


def random_zones(rng: np.random.Generator) -> dict[str, Zone]:
    """Put the laptop anywhere on the table before the arm, and the person anywhere around it."""
    x, y = rng.uniform(*_LAPTOP_PLACES)
    distance, direction = rng.uniform(*_PERSON_DISTANCES), rng.uniform(-_PERSON_DIRECTIONS, _PERSON_DIRECTIONS)
    beside = distance * np.array([np.cos(direction), np.sin(direction)])
    laptop, person = ZONES["laptop"], ZONES["person"]
    return {"laptop": replace(laptop, position=np.array([x, y, laptop.position[2]])),
            "person": replace(person, position=np.array([*beside, person.position[2]]))}


def random_pairs(robot: RobotModel, scene: Scene, config: PlannerConfig, seed: int = 0, *,
                 places: bool = False) -> Iterator[PlanningPair]:
    """Yield random starts and goals near the task's own that the arm can reach in the task's duration.

    Args:
        robot: The arm.
        scene: The task.
        config: Settings of the planner, whose limits both ends keep.
        seed: Seed of the draws.
        places: True: laptop and person are somewhere else each time; neither start nor goal is inside them.
    """
    rng = np.random.default_rng(seed)
    while True:
        if places:
            scene = replace(scene, zones={**scene.zones, **random_zones(rng)})
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
