"""Learning from multiple forms of interaction: ours with any of them, beside others (paper sec. "Simulation 1")."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from unifeed_ros.baselines.learner import Learner, feature_counts, features_in
from unifeed_ros.baselines.ours import Ours
from unifeed_ros.baselines.policies import (
    AdversarialConfig,
    AtariConfig,
    CloningConfig,
    PolicyConfig,
    PolicyLearner,
    Worker,
)
from unifeed_ros.baselines.rric import Rric, RricConfig
from unifeed_ros.core.errors import PlanningError, UnifeedError
from unifeed_ros.core.feedback.items import FeedbackItem
from unifeed_ros.core.planning.plan import Plan, plan_motion
from unifeed_ros.core.planning.problem import StateReward
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.queries import QueryConfig, most_informative, select_query, with_variations
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.experiments.experiment import FAILED, Condition, Experiment, Row, RunSettings
from unifeed_ros.experiments.features import Lesson, lesson_of
from unifeed_ros.experiments.features_findings import FEATURES
from unifeed_ros.experiments.multimodal_findings import DCP, END_TO_END, OURS, RRIC, analyse, draw
from unifeed_ros.simulation.tasks import endpoints

TASKS = ("table", "laptop")
"""The paper's."""
PEOPLE = 15
INPUTS: Mapping[str, str] = {
    "BC": "DDDDDD", "AIRL": "DDDDDD", "Atari": "DDPPPP",
    "Ours (D)": "DDDDDD", "Ours (C)": "CCCCCC", "Ours (P)": "PPPPPP", "Ours (DC)": "DDDCCC", "Ours (DP)": "DDDPPP",
    "Ours (CP)": "CCCPPP", DCP: "DDCCPP", RRIC: "DDCCPP"}
"""Inputs of each method, split as in the paper: demonstrations, then corrections, then rankings."""
OPINIONS = 50
"""Samples of RRIC's posterior that a question is chosen by."""


@dataclass(frozen=True, kw_only=True)
class MultimodalConfig:
    """Settings of the compared methods, as tuned (docs/methods.md)."""

    ours: TrainingConfig = field(default_factory=TrainingConfig)
    """Of ours, whatever it learns from."""
    rric: RricConfig = field(default_factory=lambda: RricConfig(
        demonstration_rationality=50.0, correction_rationality=50.0, preference_rationality=2.0))
    """Of RRIC."""
    questions: QueryConfig = field(default_factory=QueryConfig)
    """How questions are chosen, alike for all that plan."""
    policies: Mapping[str, PolicyConfig] = field(default_factory=lambda: {
        "BC": CloningConfig(), "AIRL": AdversarialConfig(), "Atari": AtariConfig()})
    """Of the methods that learn a policy."""


def run_person(person: int, settings: RunSettings, config: MultimodalConfig | None = None) -> list[Row]:
    """Run one person through both tasks with all methods.

    Args:
        person: Number of the person.
        settings: Seed.
        config: Settings of the methods; None: as tuned.

    Returns:
        One row an interaction.
    """
    config, rows = config or MultimodalConfig(), []
    with Worker() as worker:
        for task in TASKS:
            lesson = lesson_of(task, person, settings, "panda")
            rows += [row for method in INPUTS for row in (
                run_policy(method, lesson, worker, config) if method in END_TO_END
                else run_condition(method, lesson, settings.rng(person, 20), config))]
    return rows


def run_policy(method: str, lesson: Lesson, worker: Worker, config: MultimodalConfig, inputs: str = "") -> list[Row]:
    """Teach one task to a method that learns a policy, and moves only where a motion is corrected and at the end.

    Args:
        method: Its name.
        lesson: The person and the task.
        worker: Trains it.
        config: Settings.
        inputs: Letters D, C and P in order, D first; empty: the method's.

    Returns:
        One row an input after which it moved; where it could not be trained, a failed one that says why.
    """
    yardstick, person, inputs = lesson.optimum.yardstick, lesson.person(), inputs or INPUTS[method]
    scene = yardstick.task.scene
    learner = PolicyLearner(method, worker, lesson.robot, endpoints(lesson.robot, scene)[0], scene.duration,
                            lesson.planner.waypoints, config.policies[method], lesson.seed[1], scene.floor)
    rows: list[Row] = []
    motion: Trajectory | None = None
    common = {"task": yardstick.task.name, "method": method}
    try:
        for number, letter in enumerate(inputs, 1):
            began, spent = time.thread_time(), learner.seconds
            if letter == "D":
                learner.learn(person.demonstrate(f"demonstration {number}"))
            elif letter == "C":
                learner.learn(person.correct(f"correction {number}", motion or learner.motion()))
            else:
                learner.learn(person.rank(f"preference {number}", learner.question()))
            if number < len(inputs) and inputs[number] != "C":
                continue
            motion = learner.motion()
            rows.append({**common, "interaction": number, "input": letter, "regret": yardstick.regret(motion),
                         "normalised_regret": yardstick.normalised_regret(motion), "planned": True,
                         "optimum_gap": lesson.optimum.gap,
                         "seconds_train": learner.seconds - spent + time.thread_time() - began})
    except UnifeedError as error:
        return [{**common, "interaction": 0, "status": FAILED, "message": str(error)}]
    return rows


def run_condition(method: str, lesson: Lesson, rng: np.random.Generator, config: MultimodalConfig,
                  inputs: str = "") -> list[Row]:
    """Teach one method one task.

    Args:
        method: Its name.
        lesson: The person and the task.
        rng: Source of the motions that questions are about.
        config: Settings.
        inputs: Letters D, C and P in order; empty: the method's.

    Returns:
        One row an input, with what the robot plans after it.
    """
    yardstick, person, learner = lesson.optimum.yardstick, lesson.person(), make_learner(method, lesson, config)
    context = yardstick.task.scene.context()
    motion = _planned(lesson, None).trajectory  # before anything is taught, the robot moves smoothly
    shown: list[Trajectory] = []
    rows: list[Row] = []
    for number, letter in enumerate(inputs or INPUTS[method], 1):
        began = time.thread_time()
        item: FeedbackItem
        if letter == "D":
            item = person.demonstrate(f"demonstration {number}")
        elif letter == "C":
            item = person.correct(f"correction {number}", motion)
        else:
            candidates = with_variations(lesson.robot, [motion, *shown], config.questions.variation_size,
                                         config.questions.candidates, rng)
            item = person.rank(f"preference {number}", choose(learner, candidates, context, lesson, config, rng))
        chosen = time.thread_time()
        learner.learn(item)
        learned = time.thread_time()
        reward = _reward(learner, context)
        plan = _planned(lesson, reward) if reward is not None else None
        if plan is not None and plan.success:
            motion = plan.trajectory
        shown.append(motion)
        rows.append({"task": yardstick.task.name, "method": method, "interaction": number, "input": letter,
                     "regret": yardstick.regret(motion), "normalised_regret": yardstick.normalised_regret(motion),
                     "planned": plan is None or plan.success, "optimum_gap": lesson.optimum.gap,
                     "seconds_sample": chosen - began, "seconds_train": learned - chosen,
                     "seconds_plan": time.thread_time() - learned})
    return rows


def make_learner(method: str, lesson: Lesson, config: MultimodalConfig) -> Learner:
    """Make a method before the first interaction.

    Args:
        method: Its name.
        lesson: The person and the task, whose features RRIC knows.
        config: Settings.
    """
    if method == RRIC:
        return Rric(lesson.robot, FEATURES[lesson.optimum.yardstick.task.name], config.rric, lesson.seed[1])
    return Ours(lesson.robot, config.ours, lesson.seed[1])


def choose(learner: Learner, candidates: Sequence[Trajectory], context: Context, lesson: Lesson,
           config: MultimodalConfig, rng: np.random.Generator) -> list[Trajectory]:
    """Choose two motions to ask about: those whose ranking tells a method the most (paper eqs. M7, M8).

    Args:
        learner: The method.
        candidates: What there is to choose from.
        context: Goal and objects.
        lesson: The person and the task.
        config: Settings.
        rng: Chooses where nothing was learned yet.

    Returns:
        The two.
    """
    if isinstance(learner, Ours) and learner.ensemble is not None:
        query = select_query(learner.ensemble, candidates, lesson.robot, context, waypoints=config.ours.waypoints,
                             rationality=config.ours.rationality)
        return [candidates[k] for k in query.indices]
    if isinstance(learner, Rric) and learner.choices:
        states = np.stack([lesson.robot.tool_states(c.resampled(config.rric.waypoints)) for c in candidates])
        known = features_in(FEATURES[lesson.optimum.yardstick.task.name], context)
        counts = feature_counts(known, states, candidates[0].duration)
        opinions = learner.samples[:: max(1, len(learner.samples) // OPINIONS)]
        query = most_informative(config.rric.preference_rationality * opinions @ counts.T)
        return [candidates[k] for k in query.indices]
    return [candidates[int(k)] for k in rng.choice(len(candidates), 2, replace=False)]


def _reward(learner: Learner, context: Context) -> StateReward | None:
    """Give what was learned; None where a ranking of ties alone has taught nothing."""
    if isinstance(learner, Ours) and learner.ensemble is None:
        return None
    return learner.reward(context)


def _planned(lesson: Lesson, reward: Any) -> Plan:
    scene = lesson.optimum.yardstick.task.scene
    start, goal = endpoints(lesson.robot, scene)
    plan = plan_motion(lesson.robot, reward, start, goal, duration=scene.duration, scene=scene, config=lesson.planner)
    if reward is None and not plan.success:
        raise PlanningError("no motion before anything was taught", got=plan.message)
    return plan


EXPERIMENT = Experiment(
    name="multimodal", title="Multiple forms of interaction", people=PEOPLE,
    source="Simulation 1 (sec:sim_interactions), fig:sim1_new",
    conditions=[Condition(task=task, method=method) for task in TASKS for method in (*END_TO_END, *OURS, RRIC)],
    run_person=run_person, analyse=analyse, draw=draw)
