"""People who want the tool near or far from a bowl, a table and a ball, and the motions that they are asked about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from unifeed_ros.baselines.dempref import MotionFeatures
from unifeed_ros.baselines.slsqp import solve_with_slsqp
from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.feedback.items import Demonstration, Preference
from unifeed_ros.core.planning.check import check_motion, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import plan_motion
from unifeed_ros.core.planning.problem import PlanningProblem, StateReward
from unifeed_ros.core.planning.starts import StartRepair
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.experiments.query_bench import CONTEXT, RATIONALITY, START, draw_motions
from unifeed_ros.experiments.reward_quality import WORKSPACE
from unifeed_ros.resources import config_path

FEATURES = ("distance(goal)", "height(0.0)", "distance(ball)")
"""The paper's three features: distance to the bowl, height over the table, distance to the ball."""
WAYPOINTS = 10
"""States H of a motion."""
DURATION = 3.0
"""Duration of every motion [s]."""
SCENE = Scene(task=CONTEXT.task, start=START, goal=CONTEXT.goal, objects=dict(CONTEXT.objects), duration=DURATION,
              workspace=(*WORKSPACE[0], *WORKSPACE[1]))
"""The bowl is the goal in name only: motions end wherever the reward leads, inside the workspace."""
ROOMY = replace(SCENE, workspace=tuple(np.array(SCENE.workspace) + np.repeat([-0.002, 0.002], 3)))
"""The same with 2 mm more room: motions that the planner's dense check finds outside by less are taken."""
PLANNER = PlannerConfig(waypoints=WAYPOINTS, time_budget=60.0, whole_arm=False)
"""For all methods alike."""
STARTS = 6
"""Motions that the search for a person's optimum starts from."""


@dataclass(frozen=True, kw_only=True)
class Questions:
    """What all people can be asked: pairs of motions, each to one random place."""

    robot: RobotModel
    """The arm."""
    motions: Sequence[Trajectory]
    """2 Q motions; the first two are question 0 [rad]."""
    states: Array
    """Their tool states, shape (2 Q, H, 6) [m, 1]."""
    features: MotionFeatures
    """The three features, centred on these motions and in units of their standard deviation."""
    phi: Array
    """Their features, shape (Q, 2, 3) [1]."""


@lru_cache(maxsize=2)
def draw_questions(count: int, seed: int) -> Questions:
    """Draw the motions, the same for all people and methods.

    Args:
        count: Number of motions, even.
        seed: Seed.

    Returns:
        The questions.
    """
    robot = RobotModel(load_robot(config_path("robots", "panda")))
    motions = draw_motions(robot, count, WAYPOINTS, seed)
    raw = MotionFeatures(names=FEATURES, context=CONTEXT, waypoints=WAYPOINTS, centre=np.zeros(3), spread=np.ones(3))
    values = raw.of(robot, motions.trajectories)
    centre, spread = values.mean(axis=0), values.std(axis=0)
    features = MotionFeatures(names=FEATURES, context=CONTEXT, waypoints=WAYPOINTS, centre=centre, spread=spread)
    return Questions(robot=robot, motions=motions.trajectories, states=motions.states, features=features,
                     phi=((values - centre) / spread).reshape(-1, 2, 3))


class Person:
    """One simulated person: weights that are all equally likely, and noisily rational inputs.

    Attributes:
        weights: What each feature is worth to them, in standard deviations over the motions, a unit vector, shape (3,).
        demonstration: What they show: one of all motions, chosen by Luce's rule as answers are, so noisily optimal.
        optimum: Their best motion.
        optimal_return: Its return [reward].
    """

    def __init__(self, questions: Questions, rng: np.random.Generator) -> None:
        """Make up the person's mind, and find their best motion.

        Args:
            questions: What they can be asked.
            rng: Source of randomness.

        Raises:
            PlanningError: No motion satisfies the constraints.
        """
        weights = rng.normal(size=len(FEATURES))
        self.weights = weights / np.linalg.norm(weights)
        self._questions, self._reward = questions, questions.features.reward(self.weights)
        self._luck = rng.random(len(questions.phi))
        self.demonstration = self._demonstrate(rng)
        self.optimum = plan(questions.robot, self._reward, STARTS)
        self.optimal_return = self.returns(self.optimum)

    def returns(self, motion: Trajectory) -> float:
        """Add up the true reward over H states (paper eq. P3), the motions' mean return nought.

        Args:
            motion: A motion [rad].

        Returns:
            Return [reward]: H times the weighted features.
        """
        return WAYPOINTS * float((self._questions.features.of(self._questions.robot, [motion]) @ self.weights)[0])

    def _demonstrate(self, rng: np.random.Generator) -> Demonstration:
        questions = self._questions
        appeal = RATIONALITY * questions.phi.reshape(-1, 3) @ self.weights
        shown = int(np.argmax(appeal + rng.gumbel(size=len(appeal))))
        return Demonstration(id="demonstration", robot=questions.robot.config.name, context=CONTEXT,
                             trajectory=questions.motions[shown])

    def answer(self, question: int) -> Preference:
        """Answer a question by Luce's rule (paper eq. M3); the same question twice, the same answer.

        Args:
            question: Its number.

        Returns:
            The ranking.
        """
        first, second = self._questions.phi[question] @ self.weights
        prefers_first = self._luck[question] < 1.0 / (1.0 + np.exp(-RATIONALITY * (first - second)))
        options = tuple(self._questions.motions[2 * question:2 * question + 2])
        return Preference(id=f"question {question}", robot=self._questions.robot.config.name, context=CONTEXT,
                          options=options, ranks=(0, 1) if prefers_first else (1, 0))

    def slsqp_return(self) -> float:
        """Look for the optimum with an independent solver, SciPy's SLSQP with exact gradients, from the same line.

        Returns:
            Return of what it found [reward].
        """
        robot, start = self._questions.robot, start_posture(self._questions.robot)
        problem = PlanningProblem(robot, self._reward, start, None, DURATION,
                                  motion_bounds(robot, SCENE, start, None, PLANNER), PLANNER)
        found = solve_with_slsqp(problem, StartRepair(problem).line, exact=True, limit=60.0).waypoints
        times = np.linspace(0.0, DURATION, len(found))
        return self.returns(Trajectory(joint_names=robot.joint_names, times=times, positions=found))


@lru_cache(maxsize=2)
def start_posture(robot: RobotModel) -> Array:
    """Find the posture that every motion starts in, shape (n,) [rad]."""
    return robot.inverse_kinematics(START)


def plan(robot: RobotModel, reward: StateReward, starts: int = 1) -> Trajectory:
    """Find the motion of the largest return (paper eq. M10 without a goal).

    Args:
        robot: The arm.
        reward: Learned or true.
        starts: Motions that the search starts from.

    Returns:
        The motion.

    Raises:
        PlanningError: No motion satisfies the constraints.
    """
    config = PLANNER if starts == 1 else replace(PLANNER, starts=starts, smoothness=0.1 * PLANNER.smoothness)
    start = start_posture(robot)
    found = plan_motion(robot, reward, start, None, duration=DURATION, scene=SCENE, config=config)
    if not (found.success or check_motion(found.trajectory, motion_bounds(robot, ROOMY, start, None, PLANNER)).ok):
        found = plan_motion(robot, reward, start, None, duration=DURATION, scene=SCENE,
                            config=replace(config, starts=STARTS, seed=1))
        if not found.success:
            raise PlanningError("no motion for a reward over bowl, table and ball", got=found.message)
    return found.trajectory
