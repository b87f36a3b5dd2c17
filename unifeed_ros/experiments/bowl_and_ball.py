"""People who want the tool near or far from a bowl, a table and a ball, and the motions that they are asked about."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from unifeed_ros.baselines.dempref import MotionFeatures
from unifeed_ros.baselines.slsqp import solve_with_slsqp
from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.feedback.items import Demonstration, Preference
from unifeed_ros.core.planning.check import check_motion, motion_bounds
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import plan_motion
from unifeed_ros.core.planning.problem import PlanningProblem, StateReward
from unifeed_ros.core.planning.starts import StartRepair
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.experiments.query_bench import CONTEXT, RATIONALITY, START, draw_motions
from unifeed_ros.experiments.reward_quality import WORKSPACE, retimed
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.person import PersonConfig

FEATURES = ("distance(goal)", "height(0.0)", "distance(ball)")
"""The paper's three features: distance to the bowl, height over the table, distance to the ball."""
WAYPOINTS = 10
"""States H of a motion."""
DURATION = 3.0
"""Duration of every motion [s]."""
SCENE = Scene(task=CONTEXT.task, start=START, goal=CONTEXT.goal, objects=dict(CONTEXT.objects), duration=DURATION,
              workspace=(*WORKSPACE[0], *WORKSPACE[1]))
"""The bowl is the goal in name only: motions end wherever the reward leads, inside the workspace."""
ROOMY, TIGHT = (replace(SCENE, workspace=tuple(np.array(SCENE.workspace) + np.repeat([-room, room], 3)))
                for room in (0.002, -0.01))
"""The same with 2 mm more room, up to which motions are taken that the planner's dense check finds outside; and with
1 cm less, for the one plan in a thousand that otherwise leaves it by more between two way-points."""
PLANNER = PlannerConfig(waypoints=WAYPOINTS, time_budget=60.0, whole_arm=False, tolerance=1e-2)
"""For all methods alike; it ends a quarter sooner than with the default tolerance, within 0.1 % of the return."""
OPTIMUM = replace(PLANNER, starts=6, halving=0, smoothness=0.1 * PLANNER.smoothness, tolerance=2e-3)
"""For a person's optimum: more starts, and the arm's limits rather than taste decide how fast it is."""
PERSON = PersonConfig()
"""Pace and smooth error of a demonstration, as of the people of lessons."""


@dataclass(frozen=True, kw_only=True)
class Questions:
    """What all people can be asked: pairs of the same motions."""

    robot: RobotModel
    """The arm."""
    motions: Sequence[Trajectory]
    """The motions, N of them [rad]."""
    states: Array
    """Their tool states, shape (N, H, 6) [m, 1]."""
    features: MotionFeatures
    """The three features, centred on these motions and in units of their standard deviation."""
    phi: Array
    """Their features, shape (N, 3) [1]."""
    pairs: NDArray[np.intp]
    """Which two each question compares, shape (Q, 2)."""


@lru_cache(maxsize=2)
def draw_questions(motions: int, questions: int, seed: int) -> Questions:
    """Draw motions, two noisy ones to each of many random places, and pairs of them: for all people and methods alike.

    Args:
        motions: Number of motions N.
        questions: Number of pairs Q.
        seed: Seed.

    Returns:
        The questions.
    """
    robot = RobotModel(load_robot(config_path("robots", "panda")))
    drawn = draw_motions(robot, motions, WAYPOINTS, seed)
    raw = MotionFeatures(names=FEATURES, context=CONTEXT, waypoints=WAYPOINTS, centre=np.zeros(3), spread=np.ones(3))
    values = raw.of(robot, drawn.trajectories)
    centre, spread = values.mean(axis=0), values.std(axis=0)
    features = MotionFeatures(names=FEATURES, context=CONTEXT, waypoints=WAYPOINTS, centre=centre, spread=spread)
    rng = np.random.default_rng([seed, 9])
    first = rng.integers(motions, size=questions)
    second = (first + rng.integers(1, motions, size=questions)) % motions
    return Questions(robot=robot, motions=drawn.trajectories, states=drawn.states, features=features,
                     phi=(values - centre) / spread, pairs=np.stack([first, second], axis=-1))


class Person:
    """One simulated person: weights that are all equally likely, and noisily rational inputs.

    Attributes:
        weights: What each feature is worth to them, in standard deviations over the motions, a unit vector, shape (3,).
        optimum: Their best motion.
        optimal_return: Its return [reward].
        demonstration: What they show of it: slower, and with the smooth error of the simulated people's hands.
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
        self._luck = rng.random(len(questions.pairs))
        self.optimum = plan(questions.robot, self._reward, config=OPTIMUM)
        self.optimal_return = self.returns(self.optimum)
        self.demonstration = self._demonstrate(rng)

    def returns(self, motion: Trajectory) -> float:
        """Add up the true reward over H states (paper eq. P3), the motions' mean return nought.

        Args:
            motion: A motion [rad].

        Returns:
            Return [reward]: H times the weighted features.
        """
        return WAYPOINTS * float((self._questions.features.of(self._questions.robot, [motion]) @ self.weights)[0])

    def _demonstrate(self, rng: np.random.Generator) -> Demonstration:
        robot, pace = self._questions.robot, PERSON.pace * float(np.exp(rng.normal(scale=PERSON.pace_spread)))
        slower = retimed(self.optimum, pace * self.optimum.duration)
        return Demonstration(id="demonstration", robot=robot.config.name, context=CONTEXT,
                             trajectory=vary_trajectory(robot, slower, PERSON.deviation, 1, rng)[0])

    def answer(self, question: int) -> Preference:
        """Answer a question by Luce's rule (paper eq. M3); the same question twice, the same answer.

        Args:
            question: Its number.

        Returns:
            The ranking.
        """
        pair = self._questions.pairs[question]
        first, second = self._questions.phi[pair] @ self.weights
        prefers_first = self._luck[question] < 1.0 / (1.0 + np.exp(-RATIONALITY * (first - second)))
        options = tuple(self._questions.motions[k] for k in pair)
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


def plan(robot: RobotModel, reward: StateReward, like: Sequence[Trajectory] = (),
         config: PlannerConfig = PLANNER) -> Trajectory:
    """Find the motion of the largest return (paper eq. M10 without a goal).

    Args:
        robot: The arm.
        reward: Learned or true.
        like: Motions that the search starts from besides the straight line, such as what was shown.
        config: Settings.

    Returns:
        The motion.

    Raises:
        PlanningError: No motion satisfies the constraints.
    """
    start, seeds = start_posture(robot), [motion.resampled(WAYPOINTS) for motion in like]
    allowed = motion_bounds(robot, ROOMY, start, None, PLANNER)
    many = replace(config, starts=OPTIMUM.starts, halving=0, seed=1)
    for scene, settings, given in ((SCENE, config, seeds), (SCENE, many, ()), (TIGHT, config, seeds)):
        found = plan_motion(robot, reward, start, None, duration=DURATION, scene=scene, config=settings, seeds=given)
        if found.success or check_motion(found.trajectory, allowed).ok:
            return found.trajectory
    raise PlanningError("no motion for a reward over bowl, table and ball", got=found.message)
