"""How good a learned reward is: what simulated people taught, order of motions never shown, regret of the plan."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from unifeed_ros.core.errors import UnreachableError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import plan_motion
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.networks import SPREAD
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Context, Trajectory
from unifeed_ros.simulation.person import SimulatedPerson
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, endpoints, measure, straight_line

WORKSPACE = ((0.25, -0.45, 0.1), (0.7, 0.45, 0.6))
"""Corners of the box that new starts and goals are drawn from [m]."""
SECOND_START, SECOND_GOAL = (0.35, -0.35, 0.5), (0.6, 0.25, 0.12)
"""Ends of the second motion that is taught [m]."""
PLACES, MOTIONS = 10, 12
"""New pairs of start and goal, and motions between each."""
PACE = 1.3
"""How much slower than the optimum a person shows a motion [1]."""
POINTS = 61
"""Points of a motion that is made up here."""


@dataclass(frozen=True, kw_only=True)
class UnseenMotions:
    """Motions between a start and a goal that were not taught."""

    context: Context
    """Their goal, and the objects of the task."""
    states: Array
    """Tool states along each motion, shape (MOTIONS, H, 6) [m, 1]."""
    returns: Array
    """Their true returns, shape (MOTIONS,) [reward]."""


def taught_places(robot: RobotModel, scene: Scene, waypoints: int) -> list[Yardstick]:
    """Find the optima of a task where it is taught: in its own scene, and between another start and goal.

    Taught at one goal only, a reward cannot tell the way to the goal from the way to that point.

    Args:
        robot: The arm.
        scene: The task.
        waypoints: Way-points H of the planner.

    Returns:
        Two yardsticks.
    """
    scenes = (scene, replace(scene, start=np.array(SECOND_START), goal=np.array(SECOND_GOAL)))
    return [measure(robot, TrueTask(scene=s), PlannerConfig(waypoints=waypoints)) for s in scenes]


def teach(places: Sequence[Yardstick], seed: int, letters: str = "DCPDCP", error: float = 0.02) -> FeedbackDataset:
    """Make up what a person would have taught, without an arm that is touched, in one place after the other.

    D: the optimum, slower and deformed; C: the same for the middle of the straight line; P: two deformed straight
    lines, ranked by the simulated person.

    Args:
        places: The task in the scenes that it is taught in, with its optimum.
        seed: Seed of the person.
        letters: Kinds of feedback, in order.
        error: Size of the person's error [m].

    Returns:
        What was taught.
    """
    rng = np.random.default_rng([seed, 2])
    return teach_in_turn(places, seed, letters, lambda *item: _taught(*item, error, rng))


def teach_in_turn(places: Sequence[Yardstick], seed: int, letters: str,
                  taught: Callable[[str, str, Yardstick, SimulatedPerson], FeedbackItem]) -> FeedbackDataset:
    """Collect one item for each letter, in one place after the other.

    Args:
        places: The task in the scenes that it is taught in.
        seed: Seed of the people, one for each place.
        letters: Kinds of feedback, in order.
        taught: Makes an item up from its name, its letter, the place and its person.

    Returns:
        What was taught.
    """
    people = [SimulatedPerson(place, seed) for place in places]
    dataset = FeedbackDataset(places[0].robot.config.name, places[0].robot.joint_names)
    for k, letter in enumerate(letters):
        at = k % len(places)
        dataset.add(taught(f"{k}-{letter}", letter, places[at], people[at]))
    return dataset


def _taught(name: str, letter: str, place: Yardstick, person: SimulatedPerson, error: float,
            rng: np.random.Generator) -> FeedbackItem:
    robot, scene = place.robot, place.task.scene
    common: dict[str, Any] = {"id": name, "robot": robot.config.name, "context": scene.context()}
    optimum = retimed(place.optimum, PACE * place.optimum.duration)
    line = retimed(straight_line(robot, scene, POINTS), optimum.duration)
    if letter == "P":
        options = tuple(vary_trajectory(robot, line, 0.15, 2, rng))
        return Preference(**common, options=options, ranks=person.rank(options))
    shown = vary_trajectory(robot, optimum, error, 1, rng)[0]
    if letter == "D":
        return Demonstration(**common, trajectory=shown)
    planned, corrected = _middle(line), _middle(shown)
    return Correction(**common, planned=planned, corrected=corrected, span=(planned.times[0], planned.times[-1]))


def unseen_motions(yardstick: Yardstick, waypoints: int, seed: int = 0) -> list[UnseenMotions]:
    """Draw starts and goals that nobody taught, and motions between them.

    Args:
        yardstick: The arm and the task.
        waypoints: States H of a motion.
        seed: Seed of the places and motions.

    Returns:
        Motions for each of PLACES starts and goals.
    """
    rng = np.random.default_rng([seed, 3])
    found: list[UnseenMotions] = []
    while len(found) < PLACES:
        start, goal = rng.uniform(*WORKSPACE, size=(2, 3))
        scene = replace(yardstick.task.scene, start=start, goal=goal)
        try:
            line = retimed(straight_line(yardstick.robot, scene, POINTS), 4.0)
        except UnreachableError:
            continue
        motions = [line, *vary_trajectory(yardstick.robot, line, 0.15, MOTIONS - 1, rng)]
        states = np.stack([yardstick.robot.tool_states(m.resampled(waypoints)) for m in motions])
        task = TrueTask(scene=scene, name=yardstick.task.name)
        returns = task.rewards(states.reshape(-1, 6)).reshape(len(motions), waypoints).sum(axis=1)
        found.append(UnseenMotions(context=scene.context(), states=states, returns=returns))
    return found


def order_accuracy(ensemble: RewardEnsemble, unseen: list[UnseenMotions]) -> float:
    """Compute the share of pairs of unseen motions that the ensemble's mean orders as the true reward does.

    Args:
        ensemble: Learned reward.
        unseen: Motions, from unseen_motions.

    Returns:
        Share, 0 to 1; a half is guessing.
    """
    right = []
    for place in unseen:
        rewards = ensemble.member_rewards(place.states.reshape(-1, 6), place.context).mean(axis=0)
        learned = rewards.reshape(place.states.shape[:2]).sum(axis=1)
        first, second = np.triu_indices(len(learned), k=1)
        right.append((learned[first] > learned[second]) == (place.returns[first] > place.returns[second]))
    return float(np.mean(right))


def dead_members(ensemble: RewardEnsemble, unseen: list[UnseenMotions]) -> int:
    """Count the members that reward all states of unseen motions alike."""
    spread = np.concatenate([e.member_rewards(p.states.reshape(-1, 6), p.context).T
                             for e, p in ((ensemble, place) for place in unseen)]).std(axis=0)
    return int((spread < SPREAD).sum())


def planned_regret(ensemble: RewardEnsemble, yardstick: Yardstick, *, free_end: bool = False) -> float:
    """Plan with a learned reward where it was taught, and judge the motion by the true one.

    Args:
        ensemble: Learned reward.
        yardstick: The arm, the task, and its optimum with the same number of way-points.
        free_end: Plan to wherever the reward leads, not to the task's goal.

    Returns:
        Normalised regret (paper eq. s1 over the straight line's), 0 the optimum, 1 not learning. A search that finds no
        motion counts as not learning.
    """
    scene = yardstick.task.scene
    start, goal = endpoints(yardstick.robot, scene)
    plan = plan_motion(yardstick.robot, ensemble.bind(scene.context()), start, None if free_end else goal,
                       duration=scene.duration, scene=scene,
                       config=PlannerConfig(waypoints=yardstick.waypoints, time_budget=60.0))
    return yardstick.normalised_regret(plan.trajectory) if plan.success else 1.0


def retimed(motion: Trajectory, duration: float) -> Trajectory:
    """Give a motion another duration [s] and POINTS points."""
    return Trajectory(joint_names=motion.joint_names, times=np.linspace(0.0, duration, POINTS),
                      positions=motion.resampled(POINTS))


def _middle(motion: Trajectory) -> Trajectory:
    span = slice(POINTS // 4, POINTS - POINTS // 4)
    return Trajectory(joint_names=motion.joint_names, times=motion.times[span], positions=motion.positions[span])
