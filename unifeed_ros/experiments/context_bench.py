"""Does what was taught hold elsewhere: taught at two goals, tested at goals and object places that nobody showed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from unifeed_ros.core.errors import TrainingError, UnifeedError
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.experiments.reward_quality import planned_regret, teach
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, measure

GOALS = 10
"""New goals of the test."""
SECOND_START, SECOND_GOAL = (0.35, -0.35, 0.5), (0.5, 0.28, 0.3)
"""Ends of the second motion that is taught [m]: another way, to a goal at another height, so that what depends on the
height over the table and what depends on the height over the goal can be told apart."""
GOAL_BOX = ((0.4, -0.45, 0.1), (0.7, 0.25, 0.4))
"""Corners of the box that new goals are drawn from [m]."""
NEW_OBJECT_PLACES = ((0.62, 0.12, 0.0), (0.22, -0.25, 0.0))
"""Where the object of a task is in the first and in the second half of the test [m]; it is taught elsewhere."""
FROM_START, FROM_ENDS, FROM_LINE = 0.4, 0.42, 0.3
"""Least distance of a new goal from the start, least distance over the table of an object from both, and farthest that
it is from the line between them, so that it matters [m]."""
AT_STAKE = 1.0
"""Least difference between the returns of the optimum and of the straight line in a test: where hardly anything can be
lost, a share of it says nothing [reward]."""


def taught_and_tested(robot: RobotModel, scene: Scene, config: PlannerConfig, seed: int = 0,
                      goals: int = GOALS) -> tuple[list[Yardstick], list[Yardstick]]:
    """Find the optima of a task at the two goals where it is taught, and where it is tested.

    The object, where a task has one, is taught in one place.

    Args:
        robot: The arm.
        scene: The task.
        config: Settings of the planner.
        seed: Seed of the places of the test.
        goals: New goals.

    Returns:
        Two yardsticks of the places taught, and one for each new goal.
    """
    second = replace(scene, start=np.array(SECOND_START), goal=np.array(SECOND_GOAL))
    places = [_measured(robot, s, config) for s in (scene, second)]
    rng = np.random.default_rng([seed, 4])
    tests: list[Yardstick] = []
    while len(tests) < goals:
        place = np.array(NEW_OBJECT_PLACES[2 * len(tests) // goals])
        drawn = replace(scene, goal=rng.uniform(*GOAL_BOX), objects=dict.fromkeys(scene.objects, place))
        if not _sensible(drawn):
            continue
        try:
            yardstick = _measured(robot, drawn, config)
        except UnifeedError:  # out of reach, or no motion between the two
            continue
        if yardstick.optimal_return - yardstick.straight_return >= AT_STAKE:
            tests.append(yardstick)
    return places, tests


def bench_context(robot: RobotModel, scenes: Sequence[Scene], trainings: Mapping[str, Callable[[str], TrainingConfig]],
                  *, people: int, on_row: Callable[[str], None], letters: str = "DCPDCP", goals: int = GOALS,
                  ) -> dict[str, Any]:
    """Let people teach at two goals, and judge the motions that are planned at new goals, around objects elsewhere.

    Args:
        robot: The arm.
        scenes: Tasks with a true reward.
        trainings: Ways to learn by name: the settings of the training for a task.
        people: Simulated people for each task.
        on_row: Told what was measured, as a sentence.
        letters: Kinds of feedback, in order, at the two goals in turn.
        goals: New goals.

    Returns:
        `summary` by way of learning and task, with "all" for all tasks, and `people` with a row for each person.
    """
    rows: list[dict[str, Any]] = []
    for scene in scenes:
        config = PlannerConfig()
        places, tests = taught_and_tested(robot, scene, config, goals=goals)
        on_row(f"{scene.task}: {len(tests)} new goals measured")
        for person in range(people):
            dataset = teach(places, person, letters)
            for name, training in trainings.items():
                try:
                    model = train_reward(dataset, robot, training(scene.task), version=1, seed=person).ensemble
                except TrainingError as error:
                    on_row(f"{scene.task} {name} person {person}: {error}")
                    taught, new = [1.0], [1.0] * len(tests)  # the straight line
                else:
                    taught, new = ([planned_regret(model, p) for p in some] for some in (places, tests))
                rows.append({"task": scene.task, "way": name, "person": person, "taught": taught, "new": new})
                on_row(f"{scene.task} {name} person {person}: taught {np.mean(taught):.3f}, new median "
                       f"{np.median(new):.3f}, worst {max(new):.3f}")
    summary = {name: {task: _figures([r for r in rows if r["way"] == name and task in ("all", r["task"])])
                      for task in (*(s.task for s in scenes), "all")} for name in trainings}
    return {"robot": robot.config.name, "letters": letters, "summary": summary, "people": rows}


def _measured(robot: RobotModel, scene: Scene, config: PlannerConfig) -> Yardstick:
    return measure(robot, TrueTask(scene=scene), config)


def _sensible(scene: Scene) -> bool:
    """Check that the goal is away from the start, and that objects are near the way but leave both ends free."""
    way = np.linspace(scene.start, scene.goal, 20)
    distances = [np.linalg.norm(way[:, :2] - place[:2], axis=1) for place in scene.objects.values()]
    return bool(np.linalg.norm(scene.goal - scene.start) > FROM_START and all(
        min(d[0], d[-1]) > FROM_ENDS and d.min() < FROM_LINE for d in distances))


def _figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    new = np.concatenate([row["new"] for row in rows])
    return {"motions": len(new), "median": float(np.median(new)), "p90": float(np.percentile(new, 90)),
            "worst": float(new.max()), "taught_median": float(np.median(np.concatenate([r["taught"] for r in rows])))}
