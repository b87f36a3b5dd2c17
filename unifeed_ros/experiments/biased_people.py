"""Simulated people who are biased or careless in one kind of feedback and sound in the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from unifeed_ros.core.errors import UnreachableError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.experiments.reward_quality import PACE, POINTS, retimed, teach_in_turn
from unifeed_ros.simulation.person import SimulatedPerson
from unifeed_ros.simulation.tasks import Yardstick, straight_line

PEOPLE: Mapping[str, str] = {"sound": "", "short demonstrations": "D", "careless corrections": "C",
                             "careless rankings": "P"}
"""Kinds of people, and the letter of the feedback in which each is biased."""
SHORT = 0.15
"""How far from the goal a biased demonstration stops [m]."""
FALLS_SHORT = 0.25
"""Most that a motion of a robot that does not know the goal yet falls short of it [m]."""
ASIDE = 0.05
"""Standard deviation of where such a motion ends, in each direction [m]."""
OPTIONS = 4
"""Motions that each ranking compares."""


def teach_with_bias(places: Sequence[Yardstick], seed: int, biased: str = "", letters: str = "DCP" * 4,
                    error: float = 0.02) -> FeedbackDataset:
    """Make up what a person would have taught a robot that is not told where motions end.

    D: the optimum, slower and deformed; biased: only up to SHORT before the goal. C: the second half of a motion that
    falls short of the goal, corrected to that of the optimum; careless: to that of another motion that falls short.
    P: OPTIONS motions that fall short, deformed, ranked by the simulated person; careless: ranked at random. "Falls
    short" is by up to FALLS_SHORT along the way, evenly spread, and ASIDE.

    Args:
        places: The task in the scenes that it is taught in, with its optimum.
        seed: Seed of the person.
        biased: Letter of the feedback in which the person is biased; empty: none.
        letters: Kinds of feedback, in order.
        error: Size of the person's error where sound [m].

    Returns:
        What was taught.
    """
    rng = np.random.default_rng([seed, 5])
    return teach_in_turn(places, seed, letters, lambda *item: _taught(*item, biased, error, rng))


def _taught(name: str, letter: str, place: Yardstick, person: SimulatedPerson, bias: str, error: float,
            rng: np.random.Generator) -> FeedbackItem:
    robot, scene, biased = place.robot, place.task.scene, letter == bias
    common: dict[str, Any] = {"id": name, "robot": robot.config.name, "context": scene.context()}
    optimum = retimed(place.optimum, PACE * place.optimum.duration)
    shown = vary_trajectory(robot, optimum, error, 1, rng)[0]
    if letter == "D":
        return Demonstration(**common, trajectory=_stopped(robot, shown, scene.goal) if biased else shown)
    if letter == "C":
        planned = _second_half(_falling_short(robot, scene, optimum.duration, rng))
        corrected = _second_half(_falling_short(robot, scene, optimum.duration, rng) if biased else shown)
        return Correction(**common, planned=planned, corrected=corrected, span=(planned.times[0], planned.times[-1]))
    options = tuple(vary_trajectory(robot, _falling_short(robot, scene, optimum.duration, rng), 0.1, 1, rng)[0]
                    for _ in range(OPTIONS))
    ranks = tuple(int(i) for i in rng.permutation(OPTIONS)) if biased else person.rank(options)
    return Preference(**common, options=options, ranks=ranks)


def _stopped(robot: RobotModel, motion: Trajectory, goal: Array) -> Trajectory:
    """Leave out what comes after the tool is SHORT from the goal for good."""
    far = np.flatnonzero(np.linalg.norm(robot.tool_states(motion.positions)[:, :3] - goal, axis=1) > SHORT)
    count = max(int(far[-1]) + 1 if len(far) else 0, 3)
    return Trajectory(joint_names=motion.joint_names, times=motion.times[:count], positions=motion.positions[:count])


def _falling_short(robot: RobotModel, scene: Scene, duration: float, rng: np.random.Generator) -> Trajectory:
    """Draw a straight line in joint space that ends short of the goal."""
    back = (scene.start - scene.goal) / np.linalg.norm(scene.start - scene.goal)
    while True:
        end = scene.goal + rng.uniform(0.0, FALLS_SHORT) * back + rng.normal(scale=ASIDE, size=3)
        if end[2] < scene.floor:
            continue
        try:
            return retimed(straight_line(robot, replace(scene, goal=end), POINTS), duration)
        except UnreachableError:
            continue


def _second_half(motion: Trajectory) -> Trajectory:
    return Trajectory(joint_names=motion.joint_names, times=motion.times[POINTS // 2:],
                      positions=motion.positions[POINTS // 2:])
