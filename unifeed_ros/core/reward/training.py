"""Trains the ensemble on everything that was taught (paper eq. M9 and Algorithm 1)."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from unifeed_ros.core.errors import TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.reward.buffer import RankingsBuffer, build_buffer
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.losses import LossTerms
from unifeed_ros.core.reward.networks import FEATURE_RATE, Comparer, Networks
from unifeed_ros.core.robot import RobotModel


def train_reward(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, *, version: int, seed: int,
                 previous: RewardEnsemble | None = None,
                 on_progress: Callable[[float], None] | None = None) -> TrainingResult:
    """Train an ensemble on all feedback (paper Algorithm 1, one pass of its outer loop).

    Members and comparisons are evaluated together; each member draws its own alternatives in every step.
    One thread, and the same arguments give the same bytes.

    Args:
        dataset: What was taught.
        robot: The arm that was taught.
        config: Settings.
        version: Version of the new model.
        seed: Seed of everything random.
        previous: Model to go on from, if the settings allow it, its inputs and sizes are the same, and all that it
            learned from is still there: after an undo, training from scratch gives the model of what is left.
        on_progress: Called now and then with the share of the steps that are done.

    Returns:
        The ensemble and figures.

    Raises:
        TrainingError: Nothing to learn from, or a member that stayed dead or diverged.
    """
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    buffer = _build(dataset, robot, config, config.pool, config.pool, rng)
    sizes = (len(buffer.inputs), *config.hidden, 1)
    with _one_thread():
        networks = Networks(sizes, config.members, rng, len(config.features))
        # a model that knows an input that was taken back since would keep a trace of it
        grown = previous is not None and set(previous.feedback_ids) <= {item.id for item in dataset.items}
        warm = config.warm_steps > 0 and previous is not None and grown and networks.load(previous, buffer.inputs)
        steps = config.warm_steps if warm else config.steps
        _optimise(networks, buffer, config, steps, config.warm_learning_rate if warm else config.learning_rate,
                  rng, on_progress)
        fresh = _build(dataset, robot, config, config.demonstration_comparisons, config.correction_comparisons, rng)
        terms, accuracy = _evaluate(networks, fresh, config.rationality)
    ensemble = RewardEnsemble(
        version=version, robot=dataset.robot, frame=robot.config.base_frame, inputs=buffer.inputs, layer_sizes=sizes,
        weights=tuple(w.detach().numpy() for w in networks.weights),
        biases=tuple(b.detach().numpy()[:, 0] for b in networks.biases),
        thetas=(FEATURE_RATE * networks.thetas).detach().numpy()[..., 0],
        feedback_ids=tuple(item.id for item in dataset.items), seed=seed)
    return TrainingResult(
        ensemble=ensemble, seconds=time.perf_counter() - began, steps=steps, accuracy=accuracy,
        loss_demonstrations=_mean(terms.demonstrations, len(buffer.demonstrated)),
        loss_corrections=_mean(terms.corrections, 2 * len(buffer.corrected)),
        loss_preferences=_mean(terms.preferences, len(buffer.better)))


def _optimise(networks: Networks, buffer: RankingsBuffer, config: TrainingConfig, steps: int, learning_rate: float,
              rng: np.random.Generator, on_progress: Callable[[float], None] | None) -> None:
    """Minimise eq. M9 with Adam under a cosine schedule, restarting members that die early."""
    comparer = Comparer(networks, buffer, config.rationality)
    weights = (config.demonstration_comparisons, config.correction_comparisons, config.preference_comparisons)
    counts = (len(buffer.demonstrated), 2 * len(buffer.corrected), len(buffer.better))
    total = sum(w * c for w, c in zip(weights, counts, strict=True))
    each = max(1, config.batch // max(1, len(buffer.demonstrated) + len(buffer.corrected)))
    # what features explain is left to them
    shrink = config.residual_penalty if config.features else config.weight_penalty
    adam = torch.optim.Adam(networks.parameters, lr=learning_rate, fused=True)
    for step in range(steps):
        for group in adam.param_groups:
            group["lr"] = learning_rate * 0.5 * (1.0 + np.cos(np.pi * step / steps))
        terms = comparer.losses(comparer.draw(each, rng))
        entropy = (weights[0] * terms.demonstrations + weights[1] * terms.corrections + weights[2] * terms.preferences)
        penalty = torch.stack([w.square().sum() for w in networks.weights]).sum()
        adam.zero_grad(set_to_none=True)
        torch.autograd.backward(entropy.sum() / total + shrink * penalty)
        adam.step()
        if step in (steps // 10, steps // 4):
            for member in networks.dead_members(comparer.shown):
                networks.restart(member)
                for state in adam.state.values():
                    state["exp_avg"][member] = state["exp_avg_sq"][member] = 0.0
        if on_progress is not None and (step + 1) % max(1, steps // 20) == 0:
            on_progress((step + 1) / steps)
    if dead := networks.dead_members(comparer.shown):
        raise TrainingError(f"training left {len(dead)} of {config.members} members dead or diverged",
                            mend="lower the learning rate, or train again with another seed")


def _evaluate(networks: Networks, fresh: RankingsBuffer, rationality: float) -> tuple[LossTerms, float]:
    """Losses on fresh alternatives, and the share of comparisons that the members' mean decides rightly."""
    comparer = Comparer(networks, fresh, rationality)
    with torch.no_grad():
        alternatives = comparer.all_alternatives()
        terms = comparer.losses(alternatives)
        shown, demonstrations, corrections = (r.mean(dim=0) for r in comparer.returns(alternatives))
    decided = torch.cat([
        (shown[fresh.demonstrated][:, None] - demonstrations).flatten(),
        (shown[fresh.corrected][:, None] - corrections).flatten(),
        shown[fresh.corrected] - shown[fresh.planned], shown[fresh.better] - shown[fresh.worse]])
    return terms, float((decided > 0).float().mean())


def _build(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, demonstration_alternatives: int,
           correction_alternatives: int, rng: np.random.Generator) -> RankingsBuffer:
    return build_buffer(
        dataset, robot, waypoints=config.waypoints, demonstration_alternatives=demonstration_alternatives,
        correction_alternatives=correction_alternatives, config=config.alternatives, rng=rng,
        features=config.features)


def _mean(sums: Tensor, count: int) -> float:
    return float(sums.mean()) / count if count else 0.0


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep torch to one thread: small matrices gain nothing from more, and sums keep their order.

    Numbers too small for full precision count as zero: gradients of comparisons that are long decided are, and the
    processor computes with them many times slower.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(False)
        torch.set_num_threads(threads)
