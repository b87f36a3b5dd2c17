"""A whole lesson in one process: the paper's Algorithm 1 with a simulated arm and person, as the session runs it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from unifeed_ros.core.errors import ConfigError, PlanningError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, Demonstration, FeedbackItem, Preference
from unifeed_ros.core.planning.plan import Plan, PlannerConfig, plan_motion
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.learning import learn_reward
from unifeed_ros.core.reward.queries import select_query, with_variations
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.core.types import Array, Trajectory
from unifeed_ros.simulation.person import PersonConfig, SimulatedPerson
from unifeed_ros.simulation.rig import Rig, RigConfig
from unifeed_ros.simulation.tasks import TrueTask, Yardstick, endpoints, measure


@dataclass(frozen=True, kw_only=True)
class LessonConfig:
    """Settings of a whole lesson."""

    training: TrainingConfig = field(default_factory=TrainingConfig)
    """The learner."""
    planner: PlannerConfig = field(default_factory=lambda: PlannerConfig(time_budget=30.0))
    """The planner, for learned and for true rewards; patient, so that figures do not depend on the machine's load."""
    person: PersonConfig = field(default_factory=PersonConfig)
    """The person."""
    rig: RigConfig = field(default_factory=RigConfig)
    """Arm, controller and capture."""
    candidates: int = 1000
    """Motions that a question is chosen from: those that are there, and variations of them."""
    variation_size: float = 0.10
    """Size of the variations at the tool [m]."""


@dataclass(frozen=True, kw_only=True)
class LessonStep:
    """One interaction: what was taught, what was learned, what the robot did with it."""

    index: int
    """Number of the interaction, the first is 1."""
    letter: str
    """D, C or P."""
    taught: tuple[FeedbackItem, ...]
    """What came of it; empty if capture found nothing in it, and then nothing was learned."""
    message: str
    """Why nothing came of it; empty otherwise."""
    train_s: float
    """Wall-clock time of training [s]."""
    plan_s: float
    """Wall-clock time of planning [s]."""
    accuracy: float
    """Share of fresh comparisons that the ensemble decides as the person did [1]."""
    planned: Trajectory
    """The motion that was planned."""
    executed: Trajectory
    """The motion as the arm carried it out, untouched."""
    planned_regret: float
    """Regret of the planned motion [reward]."""
    planned_normalised_regret: float
    """Its share of the straight line's [1]."""
    regret: float
    """Regret of the executed motion [reward]."""
    normalised_regret: float
    """Its share of the straight line's [1]."""


@dataclass(frozen=True, kw_only=True)
class LessonResult:
    """How a lesson went."""

    robot: str
    """Name of the arm."""
    task: str
    """Name of the task."""
    seed: int
    """Seed of the lesson."""
    optimal_return: float
    """Return of the best motion [reward]."""
    interactions: tuple[LessonStep, ...]
    """What happened, in order."""


def run_lesson(robot: RobotModel, scene: Scene, task: str = "", feedback: str = "DDCCPP", *, seed: int = 0,
               config: LessonConfig | None = None, yardstick: Yardstick | None = None,
               on_step: Callable[[LessonStep], None] | None = None) -> LessonResult:
    """Teach a simulated arm from scratch, in the order of events of the session.

    D: the person guides the arm from the start; C: they push while the arm carries out its last plan; P: they rank two
    motions. After each: train, plan, move back, carry the plan out untouched, move back.

    Args:
        robot: The arm.
        scene: Start, goal, table and objects.
        task: Name of the true reward; empty: the scene's task.
        feedback: Letters D, C and P, in order.
        seed: Seed of the person, the sensors, the learner and the questions.
        config: Settings.
        yardstick: The task's optimum, if it was measured before.
        on_step: Called after each interaction.

    Returns:
        What was taught, learned and done.

    Raises:
        ConfigError: Another letter, or a task without a true reward.
        PlanningError: A plan that the arm cannot carry out.
        UnreachableError: The start or the goal is out of reach.
    """
    config = config or LessonConfig()
    unknown = sorted(set(feedback) - set("DCP"))
    if unknown or not feedback:
        raise ConfigError("feedback of a lesson", expected="letters D, C, P", got=feedback or "none")
    yardstick = yardstick or measure(robot, TrueTask(scene=scene, name=task), config.planner)
    lesson = _Lesson(robot, scene, yardstick, seed, config)
    steps = []
    for letter in feedback:
        steps.append(lesson.interact(letter))
        if on_step is not None:
            on_step(steps[-1])
    return LessonResult(robot=robot.config.name, task=yardstick.task.name, seed=seed,
                        optimal_return=yardstick.optimal_return, interactions=tuple(steps))


class _Lesson:
    """What the session, the learner and the optimizer know between interactions."""

    def __init__(self, robot: RobotModel, scene: Scene, yardstick: Yardstick, seed: int, config: LessonConfig) -> None:
        self._robot, self._scene, self._config, self._seed = robot, scene, config, seed
        self._yardstick = yardstick
        self._start, self._goal = endpoints(robot, scene)
        self._person = SimulatedPerson(yardstick, seed, config.person)
        self._rig = Rig(robot, table_height=scene.table_height, seed=seed, start=self._start, config=config.rig)
        self._dataset = FeedbackDataset(robot.config.name, robot.joint_names)
        self._rng = np.random.default_rng([seed, 1])
        self._model: RewardEnsemble | None = None
        self._last: Array | None = None
        self._plan: Plan | None = None
        self._shown: list[Trajectory] = []
        self._count = self._motions = 0

    def interact(self, letter: str) -> LessonStep:
        """Let the person teach once, learn from it, and show what was learned."""
        self._count += 1
        taught, message = {"D": self._demonstrate, "C": self._correct, "P": self._ask}[letter]()
        train_s, accuracy = self._learn(taught)
        if taught or self._plan is None:
            self._plan = self._planned()
        self._return()
        executed = self._executed(self._plan.trajectory)
        self._return()
        self._shown.append(executed)
        return LessonStep(
            index=self._count, letter=letter, taught=tuple(taught), message=message, train_s=train_s,
            plan_s=self._plan.seconds, accuracy=accuracy, planned=self._plan.trajectory, executed=executed,
            planned_regret=self._yardstick.regret(self._plan.trajectory),
            planned_normalised_regret=self._yardstick.normalised_regret(self._plan.trajectory),
            regret=self._yardstick.regret(executed), normalised_regret=self._yardstick.normalised_regret(executed))

    def _demonstrate(self) -> tuple[list[FeedbackItem], str]:
        captured = self._rig.guide(self._person)
        if captured.trajectory is None:
            return [], captured.reason
        return [Demonstration(**self._item(0), trajectory=captured.trajectory)], ""

    def _correct(self) -> tuple[list[FeedbackItem], str]:
        if self._plan is None:
            self._plan = self._planned()
        self._motions += 1
        captured = self._rig.execute(self._plan.trajectory, f"run {self._motions}", self._person).captured
        return [Correction(**self._item(k), planned=span.planned, corrected=span.corrected, span=span.span)
                for k, span in enumerate(captured.corrections)], captured.reason

    def _ask(self) -> tuple[list[FeedbackItem], str]:
        if self._plan is None or self._model is None:
            return [], "nothing was learned yet that a question could be about"
        given = [self._plan.trajectory, *self._shown]
        config = self._config
        candidates = with_variations(self._robot, given, config.variation_size, config.candidates, self._rng)
        query = select_query(self._model, candidates, self._robot, self._scene.context(),
                             waypoints=config.training.waypoints, rationality=config.training.rationality)
        options = tuple(candidates[k] for k in query.indices)
        return [Preference(**self._item(0), options=options, ranks=self._person.rank(options))], ""

    def _item(self, number: int) -> dict[str, Any]:
        return {"id": f"{self._count}-{number}", "robot": self._robot.config.name, "context": self._scene.context()}

    def _learn(self, taught: list[FeedbackItem]) -> tuple[float, float]:
        for item in taught:
            self._dataset.add(item)
        if not any(not isinstance(item, Preference) or item.ranked_pairs for item in taught):
            return 0.0, float("nan")
        result = learn_reward(self._dataset, self._robot, self._config.training, version=self._count,
                              seed=self._seed, known=self._model)
        self._model = result.ensemble
        return result.seconds, result.accuracy

    def _planned(self) -> Plan:
        line = self._robot.tool_states(np.linspace(self._start, self._goal, self._config.planner.waypoints))
        kappa = self._config.planner.kappa
        reward = None if self._model is None else self._model.bind(self._scene.context(), kappa, line)
        seeds = [] if self._last is None else [self._last]
        plan = plan_motion(self._robot, reward, self._start, self._goal, duration=self._scene.duration,
                           scene=self._scene, config=self._config.planner, seeds=seeds)
        _require_success(plan, "the learned motion")
        self._last = plan.waypoints
        return plan

    def _executed(self, motion: Trajectory) -> Trajectory:
        self._motions += 1
        return self._rig.execute(motion, f"show {self._motions}").executed

    def _return(self) -> None:
        here = self._rig.positions
        if float(np.abs(here - self._start).max()) < 0.01:
            return
        plan = plan_motion(self._robot, None, here, self._start, duration=0.0, scene=self._scene,
                           config=self._config.planner)
        _require_success(plan, "the move back to the start")
        self._motions += 1
        self._rig.execute(plan.trajectory, f"return {self._motions}")


def _require_success(plan: Plan, what: str) -> None:
    if not plan.success:
        raise PlanningError(f"no motion for {what}", got=plan.message)
