"""What weighing each kind of feedback by its reliability gains and costs, with biased and with sound people."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.stats import wilcoxon

from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.experiments.biased_people import PEOPLE, teach_with_bias
from unifeed_ros.experiments.reward_quality import planned_regret, taught_places
from unifeed_ros.simulation.tasks import Yardstick

UNWEIGHTED = (1.0, 1.0, 1.0)


def bench_reliability(robot: RobotModel, scenes: Sequence[Scene], *, people: Sequence[str], seeds: int,
                      on_row: Callable[[str], None], config: TrainingConfig | None = None) -> dict[str, Any]:
    """Train with estimated and without weights on the same feedback, and judge the plans by the true reward.

    The robot is not told where a motion ends: plans are made with the end free, from where the task was taught, because
    a fixed end would hide that demonstrations stopped short of it.

    Args:
        robot: The arm.
        scenes: Tasks with a true reward.
        people: Which of PEOPLE.
        seeds: People of each kind for each task.
        on_row: Told what was measured, as a sentence.
        config: Settings of the training; the reliability is set here.

    Returns:
        `summary` with a dictionary for each task and kind of people, and `people` with a row for each person.
    """
    config, rows, summary = config or TrainingConfig(), [], {}
    for scene in scenes:
        places = taught_places(robot, scene, config.waypoints)
        for kind in people:
            judged = [_judge(places, kind, seed, config) for seed in range(seeds)]
            rows += judged
            summary[f"{scene.task}: {kind}"] = _summary(judged)
            on_row(f"{scene.task}, {kind}: " + ", ".join(
                f"{name} {value:.3g}" for name, value in summary[f"{scene.task}: {kind}"].items() if value is not None))
    return {"summary": summary, "people": rows}


def _judge(places: Sequence[Yardstick], kind: str, seed: int, config: TrainingConfig) -> dict[str, Any]:
    """Train on what one person taught, with and without weights."""
    dataset, robot, task = teach_with_bias(places, seed, PEOPLE[kind]), places[0].robot, places[0].task.name
    figures: dict[str, Any] = {"task": task, "people": kind, "seed": seed}
    for name, reliability in (("weighted", "estimate"), ("unweighted", UNWEIGHTED)):
        result = train_reward(dataset, robot, replace(config, reliability=reliability), version=1, seed=seed)
        figures[name] = float(np.mean([planned_regret(result.ensemble, place, free_end=True) for place in places]))
        if name == "weighted":
            figures |= dict(zip("DCP", result.reliability, strict=True))
    return figures


def _summary(judged: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Put one task and kind of people together: medians, means, and the p-value of "weights make it worse"."""
    column = {name: np.array([row[name] for row in judged]) for name in ("weighted", "unweighted", *"DCP")}
    weighted, unweighted = column["weighted"], column["unweighted"]
    differ = bool((weighted != unweighted).any())
    return {
        "weighted": float(np.median(weighted)), "unweighted": float(np.median(unweighted)),
        "ratio": float(np.median(weighted) / np.median(unweighted)),
        "weighted_mean": float(weighted.mean()), "unweighted_mean": float(unweighted.mean()),
        "worse_p": float(wilcoxon(weighted, unweighted, alternative="greater").pvalue) if differ else None,
        "better_p": float(wilcoxon(weighted, unweighted, alternative="less").pvalue) if differ else None,
        **{letter: float(column[letter].mean()) for letter in "DCP"}}
