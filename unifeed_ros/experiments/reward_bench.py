"""Speed and quality of the reward's training beside the paper's procedure, in one run on one thread."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.stats import wilcoxon
from torch.utils.flop_counter import FlopCounterMode

from unifeed_ros.baselines.paper_reward import PaperTraining, buffer_pairs, train_as_the_paper
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.reward.buffer import build_buffer
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel
from unifeed_ros.core.scene import Scene
from unifeed_ros.experiments.reward_quality import (
    dead_members,
    order_accuracy,
    planned_regret,
    taught_places,
    teach,
    unseen_motions,
)
from unifeed_ros.simulation.tasks import Yardstick

MATRIX = 512
"""Rows of the matrices that the machine's speed is measured with; three of them fit the cache of a core."""


def bench_reward(robot: RobotModel, scenes: Sequence[Scene], *, horizons: Sequence[int], people: int, repeats: int,
                 on_row: Callable[[str], None], config: TrainingConfig | None = None,
                 peer: PaperTraining | None = None) -> dict[str, Any]:
    """Measure this project's training and the paper's procedure on the same feedback.

    Times are the processor's, of the first person of the first scene, six inputs, the newest one new to the warm start.
    Quality is over all people and scenes, that of warm starts after one for each input but the first; the peer is then
    trained with the pairs of a step in one forward pass, which is the same training up to rounding. That way is timed
    too (`peer_batched_s`), because most of the plain peer's time goes into single calls.

    Args:
        robot: The arm.
        scenes: Tasks with a true reward.
        horizons: Numbers of way-points H.
        people: Simulated people for each task.
        repeats: Trainings that each time is the median of.
        on_row: Told what was measured, as a sentence.
        config: Settings of this project's training; its way-points are those of the horizon.
        peer: Settings of the paper's procedure.

    Returns:
        `summary` with a dictionary for each horizon, and `people` with a row for each person.
    """
    summary, rows = {}, []
    with _one_thread():
        speed = matrix_speed()
        on_row(f"matrix speed {speed / 1e9:.0f} GFLOP/s")
        for horizon in horizons:
            settings = replace(config or TrainingConfig(), waypoints=horizon)
            lessons = [taught_places(robot, scene, horizon) for scene in scenes]
            times = _times(teach(lessons[0], 0), robot, settings, peer or PaperTraining(), repeats)
            on_row(f"H = {horizon}: " + ", ".join(f"{name} {value:.4g}" for name, value in times.items()))
            judged = []
            for places in lessons:
                for person in range(people):
                    judged.append({"horizon": horizon, "task": places[0].task.name, "person": person,
                                   **_judge(places, person, settings, peer or PaperTraining())})
                    on_row(", ".join(f"{k} {v:.3f}" if isinstance(v, float) else f"{k} {v}"
                                     for k, v in judged[-1].items()))
            summary[str(horizon)] = _summary(times, judged, speed)
            rows += judged
    return {"summary": summary, "people": rows, "matrix_gflops": speed / 1e9, "repeats": repeats}


def matrix_speed() -> float:
    """Measure the speed of matrix products in single precision on one thread.

    Returns:
        Median speed [floating-point operations/s].
    """
    matrix = torch.rand(MATRIX, MATRIX)
    with torch.no_grad():
        seconds = _median_times({"product": lambda: matrix @ matrix}, 30)["product"]
    return 2.0 * MATRIX**3 / seconds


def _times(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, peer: PaperTraining,
           repeats: int) -> dict[str, float]:
    """Time retraining after the newest input [s], and count the operations of a training from scratch."""
    before = _train(_without_newest(dataset), robot, config, 0).ensemble
    times = _median_times({
        "cold_s": lambda: _train(dataset, robot, config, 0),
        "warm_s": lambda: _train(dataset, robot, config, 0, before),
        "peer_s": lambda: _train_peer(dataset, robot, config, 0, replace(peer, together=False)),
        "peer_batched_s": lambda: _train_peer(dataset, robot, config, 0, replace(peer, together=True))}, repeats)
    with FlopCounterMode(display=False) as counter:
        _train(dataset, robot, config, 0)
    return {**times, "flops": float(counter.get_total_flops())}


def _judge(places: Sequence[Yardstick], person: int, config: TrainingConfig, peer: PaperTraining) -> dict[str, Any]:
    """Train on what one person taught in three ways, and judge each reward."""
    dataset, robot = teach(places, person), places[0].robot
    unseen = unseen_motions(places[0], config.waypoints, person)
    cold = _train(dataset, robot, config, person).ensemble
    warm = _train_in_turn(dataset, robot, config, person)
    plain = _train_peer(dataset, robot, config, person, replace(peer, together=True))
    figures: dict[str, Any] = {}
    for prefix, ensemble in (("", cold), ("warm_", warm), ("peer_", plain)):
        figures |= {f"{prefix}accuracy": order_accuracy(ensemble, unseen),
                    f"{prefix}regret": float(np.mean([planned_regret(ensemble, place) for place in places])),
                    f"{prefix}dead_members": dead_members(ensemble, unseen)}
    return figures


def _train(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, seed: int,
           previous: RewardEnsemble | None = None) -> TrainingResult:
    return train_reward(dataset, robot, config, version=1, seed=seed, previous=previous)


def _train_in_turn(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, seed: int) -> RewardEnsemble:
    """Train after each input, each time going on from the model before, as a lesson does."""
    earlier, model = FeedbackDataset(dataset.robot, dataset.joint_names), None
    for item in dataset.items:
        earlier.add(item)
        model = _train(earlier, robot, config, seed, model).ensemble
    assert model is not None
    return model


def _train_peer(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, seed: int,
                peer: PaperTraining) -> RewardEnsemble:
    buffer = build_buffer(
        dataset, robot, waypoints=config.waypoints, demonstration_alternatives=config.demonstration_comparisons,
        correction_alternatives=config.correction_comparisons, config=config.alternatives,
        rng=np.random.default_rng(seed))
    return train_as_the_paper(buffer_pairs(buffer, config.preference_comparisons), inputs=buffer.inputs,
                              robot=dataset.robot, frame=robot.config.base_frame, seed=seed, config=peer)


def _without_newest(dataset: FeedbackDataset) -> FeedbackDataset:
    earlier = FeedbackDataset(dataset.robot, dataset.joint_names)
    for item in dataset.items[:-1]:
        earlier.add(item)
    return earlier


def _summary(times: dict[str, float], judged: list[dict[str, Any]], speed: float) -> dict[str, Any]:
    """Put the figures of one horizon together; regrets and accuracies are medians over people and tasks."""
    column = {name: np.array([row[name] for row in judged], dtype=float) for name in judged[0]
              if name.endswith(("accuracy", "regret", "dead_members"))}
    figures: dict[str, Any] = {
        "cold_s": times["cold_s"], "warm_s": times["warm_s"], "peer_s": times["peer_s"],
        "peer_batched_s": times["peer_batched_s"], "cold_ratio": times["peer_s"] / times["cold_s"],
        "warm_ratio": times["peer_s"] / times["warm_s"], "floor_s": times["flops"] / speed}
    figures |= {name: int(values.sum()) if name.endswith("dead_members") else float(np.median(values))
                for name, values in column.items()}
    for name in ("regret", "accuracy", "warm_regret", "warm_accuracy"):
        peer = column["peer_" + name.removeprefix("warm_")]
        figures[f"{name}_p"] = _paired(column[name], peer, "greater" if name.endswith("regret") else "less")
    return figures


def _paired(ours: np.ndarray, peers: np.ndarray, worse: str) -> float | None:
    """Give the p-value of "ours is worse", Wilcoxon's signed ranks over people; None where nothing differs."""
    return float(wilcoxon(ours, peers, alternative=worse).pvalue) if (ours != peers).any() else None


def _median_times(works: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Run several things in turn, so that a machine that slows down slows them all; median processor times [s].

    Processor time is the wall-clock time of one thread on a quiet machine, and does not count those that share it,
    apart from what they do to its caches.
    """
    seconds: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(repeats):
        for name, work in works.items():
            began = time.process_time()
            work()
            seconds[name].append(time.process_time() - began)
    return {name: float(np.median(values)) for name, values in seconds.items()}


@contextmanager
def _one_thread() -> Iterator[None]:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
