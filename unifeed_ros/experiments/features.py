"""Learning with known and unknown features: Coactive, FERL and ours (paper sec. "Simulation 2", first part)."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache

from unifeed_ros.baselines.coactive import Coactive, CoactiveConfig
from unifeed_ros.baselines.ferl import Ferl, FerlConfig
from unifeed_ros.baselines.learned_feature import FeatureTrace, LearnedFeature, learn_feature
from unifeed_ros.baselines.learner import Learner
from unifeed_ros.baselines.ours import Ours
from unifeed_ros.core.errors import PlanningError
from unifeed_ros.core.feedback.items import FeedbackItem
from unifeed_ros.core.planning.config import PlannerConfig
from unifeed_ros.core.planning.plan import Plan, plan_motion
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import Scene, load_scene
from unifeed_ros.experiments.experiment import Condition, Experiment, Row, RunSettings
from unifeed_ros.experiments.features_findings import FEATURES, KNOWN, METHODS, analyse, draw, label
from unifeed_ros.experiments.optimum import ConfirmedOptimum, confirmed_optimum
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.planning_problems import random_pairs
from unifeed_ros.simulation.tasks import TrueTask, endpoints
from unifeed_ros.simulation.trajectory_person import TrajectoryPerson

INTERACTIONS, TRACES = 20, 10
"""Inputs of a person, the first one a demonstration, the others corrections; traces of each missing feature."""

TUNED = CoactiveConfig(gain=3.0, update="max", reading="push")
"""What was best of Coactive on other people (docs/methods.md). FERL has it too: where all features are known, it is the
same method."""


@dataclass(frozen=True, kw_only=True)
class MethodSettings:
    """Settings of the compared methods, as tuned (docs/methods.md)."""

    coactive: CoactiveConfig = TUNED
    """Of Coactive."""
    ferl: FerlConfig = field(default_factory=lambda: FerlConfig(coactive=TUNED))
    """Of FERL."""
    ours: TrainingConfig = field(default_factory=TrainingConfig)
    """Of ours; its features are replaced by those that are known."""


@dataclass(frozen=True, kw_only=True)
class Lesson:
    """One person and one task, before anything was taught: the same for all methods."""

    robot: RobotModel
    """The arm."""
    optimum: ConfirmedOptimum
    """The task between this person's start and goal."""
    seed: tuple[int, ...]
    """Seed of the person."""
    planner: PlannerConfig
    """Settings of the planner."""

    def person(self) -> TrajectoryPerson:
        """Give the person as they are before the lesson: the same demonstration and the same errors for each method."""
        return TrajectoryPerson(self.optimum.yardstick, self.seed)


@lru_cache(maxsize=2)
def _robot(name: str) -> RobotModel:
    return RobotModel(load_robot(config_path("robots", name)))


def scene_of(task: str, person: int, settings: RunSettings, robot: str = "ur10") -> Scene:
    """Draw a person's start and goal near the task's own.

    Args:
        task: Name of the task.
        person: Number of the person.
        settings: Seed.
        robot: Name of the arm.

    Returns:
        The task between them.
    """
    place = int(settings.rng(person, 1).integers(2**31))
    return next(random_pairs(_robot(robot), load_scene(config_path("tasks", task)), PlannerConfig(), seed=place)).scene


def lesson_of(task: str, person: int, settings: RunSettings, robot: str = "ur10") -> Lesson:
    """Prepare a person's lesson.

    Args:
        task: Name of the task.
        person: Number of the person.
        settings: Seed.
        robot: Name of the arm.

    Returns:
        The lesson, with the optimum of the person's scene.
    """
    planner, scene, arm = PlannerConfig(), scene_of(task, person, settings, robot), _robot(robot)
    return Lesson(robot=arm, optimum=confirmed_optimum(arm, TrueTask(scene=scene), planner),
                  seed=(settings.seed, person, list(FEATURES).index(task)), planner=planner)


class LearnedFeatures:
    """What FERL learns from a person's traces, each feature once however often it is missing.

    Attributes:
        seconds: Time that training has taken and that nobody was charged for yet [s].
    """

    def __init__(self, task: str, lesson: Lesson, config: FerlConfig) -> None:
        """Let the person show the task's features.

        Args:
            task: Name of the task.
            lesson: The person and the task.
            config: Settings of FERL.
        """
        person, context = lesson.person(), lesson.optimum.yardstick.task.scene.context()
        self._traces = {name: [FeatureTrace(context=context, states=person.trace(name)) for _ in range(TRACES)]
                        for name in FEATURES[task]}
        self._config, self._seed = config, lesson.seed[1]
        self._learned: dict[str, LearnedFeature] = {}
        self.seconds = 0.0

    def __getitem__(self, name: str) -> LearnedFeature:
        """Give what was learned of a feature."""
        if name not in self._learned:
            began = time.thread_time()
            self._learned[name] = learn_feature(self._traces[name], self._config.traces, self._seed)
            self.seconds += time.thread_time() - began
        return self._learned[name]


def make_learner(method: str, known: Sequence[str], missing: Sequence[str], learned: LearnedFeatures, lesson: Lesson,
                 methods: MethodSettings) -> Learner:
    """Make a method that knows some features of the task.

    Args:
        method: Its name.
        known: Features that it is told of.
        missing: The others, which FERL is shown by traces.
        learned: What FERL learns of them.
        lesson: The person and the task.
        methods: Settings.

    Returns:
        The method, before the first interaction.
    """
    if method == "Coactive":
        return Coactive(lesson.robot, known, methods.coactive)
    if method == "FERL":
        ferl = Ferl(lesson.robot, known, methods.ferl, lesson.seed[1])
        for name in missing:
            ferl.add(learned[name])
        return ferl
    return Ours(lesson.robot, replace(methods.ours, features=known), lesson.seed[1])


def teach(learner: Learner, lesson: Lesson, interactions: int = INTERACTIONS) -> list[Row]:
    """Teach a method: one demonstration, then corrections of what it plans.

    Args:
        learner: The method.
        lesson: The person and the task.
        interactions: Inputs.

    Returns:
        One row an interaction, without task and method.
    """
    yardstick, person = lesson.optimum.yardstick, lesson.person()
    scene, (start, goal) = yardstick.task.scene, endpoints(lesson.robot, yardstick.task.scene)
    rows: list[Row] = []
    item: FeedbackItem = person.demonstrate("demonstration")
    plan: Plan | None = None
    for interaction in range(1, interactions + 1):
        began = time.thread_time()
        learner.learn(item)
        learned = time.thread_time()
        found = plan_motion(lesson.robot, learner.reward(scene.context()), start, goal, duration=scene.duration,
                            scene=scene, config=lesson.planner)
        if plan is None and not found.success:
            raise PlanningError("no motion after the demonstration", got=found.message)
        plan = found if found.success else plan
        rows.append({"interaction": interaction, "regret": yardstick.regret(plan.trajectory),
                     "normalised_regret": yardstick.normalised_regret(plan.trajectory), "planned": found.success,
                     "optimum_gap": lesson.optimum.gap, "seconds_train": learned - began,
                     "seconds_plan": time.thread_time() - learned})
        item = person.correct(f"correction {interaction}", plan.trajectory)
    return rows


def run_condition(task: str, known: str, method: str, lesson: Lesson, learned: LearnedFeatures,
                  methods: MethodSettings, interactions: int = INTERACTIONS) -> list[Row]:
    """Teach one method one task.

    Args:
        task: Name of the task.
        known: Word of KNOWN.
        method: Name of the method.
        lesson: The person and the task.
        learned: What FERL learns of the features.
        methods: Settings.
        interactions: Inputs.

    Returns:
        One row an interaction.
    """
    names, count = FEATURES[task], KNOWN[known]
    learner = make_learner(method, names[:count], names[count:], learned, lesson, methods)
    rows = teach(learner, lesson, interactions)
    rows[0]["seconds_train"] += learned.seconds
    learned.seconds = 0.0
    return [{"task": label(task, known), "method": method, "known": known, **row} for row in rows]


def run_person(person: int, settings: RunSettings, methods: MethodSettings | None = None) -> list[Row]:
    """Run one person through all tasks, sets of known features and methods.

    Args:
        person: Number of the person.
        settings: Seed.
        methods: Settings of the methods; None: as tuned.

    Returns:
        One row an interaction.
    """
    methods, rows = methods or MethodSettings(), []
    for task in FEATURES:
        lesson = lesson_of(task, person, settings)
        learned = LearnedFeatures(task, lesson, methods.ferl)
        rows += [row for known in KNOWN for method in METHODS
                 for row in run_condition(task, known, method, lesson, learned, methods)]
    return rows


EXPERIMENT = Experiment(
    name="features", title="Known and unknown features", people=10,
    source="sec. \"Learning from Demonstrations and Corrections\" (sec:sim1), fig:sim1",
    conditions=[Condition(task=label(task, known), method=method)
                for task in FEATURES for known in KNOWN for method in METHODS],
    run_person=run_person, analyse=analyse, draw=draw)
