"""How many questions a reward takes when they are chosen and when they are drawn (paper eqs. M7, M8, hypothesis H9)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from unifeed_ros.core.errors import UnreachableError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Demonstration, Preference
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.queries import most_informative, vary_trajectory
from unifeed_ros.core.reward.terms import distance, height
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.types import Array, Context, Trajectory
from unifeed_ros.experiments.reward_quality import WORKSPACE

START = (0.45, 0.0, 0.45)
"""Where every motion starts [m]."""
CONTEXT = Context(goal=(0.55, 0.3, 0.1), task="bowl and ball", objects={"ball": (0.45, -0.35, 0.25)})
"""The bowl, which is the goal, and the ball."""
VARIATION = 0.15
"""Size of the variations of straight motions [m]."""
POINTS = 21
"""Points of a motion."""
RATIONALITY = 5.0
"""How strongly a person's own returns decide an answer [1/reward]."""
TRAINING = TrainingConfig(waypoints=10, hidden=(32, 32), members=5, steps=100, learning_rate=1e-2)
"""Smaller than a lesson's, because every person is learned from anew after each of many answers."""


@dataclass(frozen=True, kw_only=True)
class QueryBench:
    """Sizes of the experiment."""

    people: int = 50
    """Simulated people."""
    questions: int = 16
    """Questions each person is asked."""
    candidates: int = 1000
    """Motions that questions are chosen from."""
    judged: int = 300
    """Other motions, that the learned reward chooses the best of."""
    demonstrated: bool = False
    """Show one motion before the questions."""
    training: TrainingConfig = field(default_factory=lambda: TRAINING)
    """Settings of the training."""


def bench_queries(robot: RobotModel, bench: QueryBench, *, on_row: Callable[[str], None]) -> dict[str, Any]:
    """Ask the same people chosen and drawn questions, and compare how fast regret falls.

    Rewards are learned by the networks from scratch: they are told none of the three features. Regret is that of the
    best of motions nobody asked about, in place of a plan: what it takes to plan well is measured elsewhere.

    Args:
        robot: The arm.
        bench: Sizes.
        on_row: Told what was measured, as a sentence.

    Returns:
        `summary` with the medians, and `people` with each person's regrets by the number of answers.
    """
    horizon = bench.training.waypoints
    asked, judged = draw_motions(robot, bench.candidates, horizon, 0), draw_motions(robot, bench.judged, horizon, 1)
    regrets: dict[str, list[list[float]]] = {"active": [], "passive": []}
    for person in range(bench.people):
        for name, found in regrets.items():
            found.append(ask(robot, asked, judged, active=name == "active", questions=bench.questions, seed=person,
                             config=bench.training, demonstrated=bench.demonstrated))
        last = ", ".join(f"{name} {found[-1][-1]:.3f}" for name, found in regrets.items())
        on_row(f"person {person + 1} of {bench.people}: {last}")
    return {"summary": compare_curves(regrets["active"], regrets["passive"]), "people": regrets}


def compare_curves(active: Sequence[Sequence[float]], passive: Sequence[Sequence[float]]) -> dict[str, Any]:
    """Compare how many questions two ways of asking take.

    Args:
        active: Regrets of each person after each answer, shape (people, questions).
        passive: The same, asked at random.

    Returns:
        Median regrets by the number of answers; `matched`: how many chosen questions first bring the median to that of
        as many random ones as the place in the list says (None: never); `ratio`: that number for all random questions,
        over their number; `best_ratio`: the same for the lowest median of random questions, over the number that first
        reaches it. The second is stricter, since random questions may end worse than they once were.
    """
    curve, other = np.median(active, axis=0), np.median(passive, axis=0)
    matched = [questions_to(curve, level) for level in other]
    best = int(np.argmin(other))
    return {"active": curve.tolist(), "passive": other.tolist(), "matched": matched,
            "ratio": _share(matched[-1], len(other)), "best_ratio": _share(matched[best], best + 1)}


def questions_to(curve: ArrayLike, level: float) -> int | None:
    """Count the answers after which a curve first is at a level; None if it never is."""
    reached = np.flatnonzero(np.asarray(curve) <= level)
    return int(reached[0]) + 1 if len(reached) else None


def _share(part: int | None, whole: int) -> float | None:
    return None if part is None else part / whole


@dataclass(frozen=True, kw_only=True)
class Motions:
    """Motions to ask about, or to choose from."""

    trajectories: list[Trajectory]
    """Motions, N of them [rad]."""
    states: Array
    """Their tool states, shape (N, H, 6) [m, 1]."""
    features: Array
    """Distance to the bowl, height over the table, distance to the ball: means over the states, each over its spread
    among all motions, shape (N, 3) [1]."""


def draw_motions(robot: RobotModel, count: int, waypoints: int, seed: int) -> Motions:
    """Draw motions as the paper's section "Learning from Demonstrations and Preferences" does.

    Two noisy motions to each of many random places in the workspace.

    Args:
        robot: The arm.
        count: Number of motions N.
        waypoints: States H of a motion.
        seed: Seed.

    Returns:
        The motions.
    """
    rng = np.random.default_rng([seed, 7])
    first = robot.inverse_kinematics(START)
    share = np.linspace(0.0, 1.0, POINTS)[:, None]
    trajectories: list[Trajectory] = []
    while len(trajectories) < count:
        try:
            last = robot.inverse_kinematics(rng.uniform(*WORKSPACE), seed=first)
        except UnreachableError:
            continue
        line = Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, 3.0, POINTS),
                          positions=first + share * (last - first))
        trajectories += vary_trajectory(robot, line, VARIATION, 2, rng)
    trajectories = trajectories[:count]
    states = robot.tool_states(np.concatenate([t.resampled(waypoints) for t in trajectories]))
    terms = distance(states, CONTEXT.goal), height(states, 0.0), distance(states, CONTEXT.objects["ball"])
    features = np.stack([v.reshape(count, waypoints).mean(axis=1) for v, _ in terms], axis=-1)
    return Motions(trajectories=trajectories, states=states.reshape(count, waypoints, 6),
                   features=features / features.std(axis=0))


def ask(robot: RobotModel, asked: Motions, judged: Motions, *, active: bool, questions: int, seed: int,
        config: TrainingConfig, demonstrated: bool = False) -> list[float]:
    """Teach one simulated person's reward by questions alone, or after one demonstration.

    Args:
        robot: The arm.
        asked: Motions that questions are about.
        judged: Motions that the learned reward chooses the best of; others than those asked about.
        active: Ask what tells the most; otherwise draw two motions.
        questions: How many.
        seed: Seed of the person, the training and the draws.
        config: Settings of the training.
        demonstrated: Show the best of ten motions first.

    Returns:
        Normalised regret after each answer: 0 the best of the judged motions, 1 their mean.
    """
    rng = np.random.default_rng([seed, 8])
    weights = rng.normal(size=3)
    weights /= np.linalg.norm(weights)
    dataset = FeedbackDataset(robot.config.name, robot.joint_names)
    common: dict[str, Any] = {"robot": robot.config.name, "context": CONTEXT}
    ensemble = None
    if demonstrated:
        few = rng.choice(len(asked.trajectories), 10, replace=False)
        best = few[np.argmax(asked.features[few] @ weights)]
        dataset.add(Demonstration(id="d", trajectory=asked.trajectories[best], **common))
        ensemble = train_reward(dataset, robot, config, version=1, seed=seed).ensemble
    regrets = []
    for question in range(questions):
        if active and ensemble is not None:
            pair = most_informative(config.rationality * _returns(ensemble, asked)).indices
        else:
            pair = tuple(rng.choice(len(asked.trajectories), 2, replace=False))
        gap = RATIONALITY * float((asked.features[pair[0]] - asked.features[pair[1]]) @ weights)
        first = bool(rng.random() < 1.0 / (1.0 + np.exp(-gap)))
        dataset.add(Preference(id=f"p{question}", options=tuple(asked.trajectories[i] for i in pair),
                               ranks=(0, 1) if first else (1, 0), **common))
        ensemble = train_reward(dataset, robot, config, version=1, seed=seed).ensemble
        regrets.append(_regret(ensemble, judged, weights))
    return regrets


def _returns(ensemble: RewardEnsemble, motions: Motions) -> Array:
    """Compute each member's return of each motion, shape (m, N) [reward]."""
    rewards = ensemble.member_rewards(motions.states.reshape(-1, 6), CONTEXT)
    return np.asarray(rewards.reshape(ensemble.members, *motions.states.shape[:2]).sum(axis=2))


def _regret(ensemble: RewardEnsemble, judged: Motions, weights: Array) -> float:
    """Let the learned reward choose, and judge the choice by the true one."""
    true = judged.features @ weights
    chosen = true[int(np.argmax(_returns(ensemble, judged).mean(axis=0)))]
    return float((true.max() - chosen) / (true.max() - true.mean()))
