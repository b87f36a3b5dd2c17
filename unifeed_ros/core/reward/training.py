"""Trains the ensemble on everything that was taught (paper eq. M9 and Algorithm 1)."""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from unifeed_ros.core.errors import TrainingError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.reward.adam import Adam
from unifeed_ros.core.reward.batches import Batches
from unifeed_ros.core.reward.buffer import RankingsBuffer, build_buffers
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.gradients import LossGradient
from unifeed_ros.core.reward.losses import LossTerms, correction_loss, demonstration_loss, preference_loss
from unifeed_ros.core.reward.networks import FEATURE_RATE, Networks
from unifeed_ros.core.reward.reliability import reliability_of
from unifeed_ros.core.robot import RobotModel

LEAST_SLOPE = 0.05
"""Mean slope of the output's tanh along a motion that was shown, under which a member is not gone on from [1]."""
FRESH = 20
"""Alternatives of each demonstration and each correction that the accuracy is measured on."""


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
        previous: Model to go on from, if the settings allow it, its inputs and sizes are the same and it can still
            learn from what is new. `learning.learn_reward` says when that is wise.
        on_progress: Called now and then with the share of the steps that are done.

    Returns:
        The ensemble and figures.

    Raises:
        TrainingError: Nothing to learn from, or a member that stayed dead or diverged.
    """
    began = time.perf_counter()
    rng = np.random.default_rng(seed)
    buffer, fresh = build_buffers(dataset, robot, waypoints=config.waypoints,
                                  alternatives=[(config.pool, config.pool), (FRESH, FRESH)],
                                  config=config.alternatives, rng=rng, features=config.features)
    reliability = reliability_of(buffer, config.reliability)
    sizes = (len(buffer.inputs), *config.hidden, 1)
    with _one_thread():
        networks = Networks(sizes, config.members, rng, config.activation, len(config.features))
        warm = config.warm_steps > 0 and previous is not None and _take_over(networks, previous, buffer)
        steps = config.warm_steps if warm else config.steps
        _optimise(networks, buffer, config, reliability, steps,
                  config.warm_learning_rate if warm else config.learning_rate, rng, on_progress)
        terms, accuracy = _evaluate(networks, fresh, config.rationality)
    ensemble = RewardEnsemble(
        version=version, robot=dataset.robot, frame=robot.config.base_frame, inputs=buffer.inputs, layer_sizes=sizes,
        weights=tuple(w.numpy() for w in networks.weights),
        biases=tuple(b.numpy()[:, 0] for b in networks.biases),
        thetas=(FEATURE_RATE * networks.thetas).numpy()[:, 0],
        feedback_ids=tuple(item.id for item in dataset.items), seed=seed,
        activation=config.activation)
    return TrainingResult(
        ensemble=ensemble, seconds=time.perf_counter() - began, steps=steps, accuracy=accuracy, reliability=reliability,
        loss_demonstrations=_mean(terms.demonstrations, len(buffer.demonstrated)),
        loss_corrections=_mean(terms.corrections, 2 * len(buffer.corrected)),
        loss_preferences=_mean(terms.preferences, len(buffer.better)))


def _take_over(networks: Networks, previous: RewardEnsemble, buffer: RankingsBuffer) -> bool:
    """Go on from a model, unless it does not fit, or could learn nothing where it is now told what is good.

    Learned between one start and goal, all rewards elsewhere may be so near -1 that their tanh has no slope left.
    """
    if not networks.load(previous, buffer.inputs):
        return False
    good = buffer.shown[np.concatenate([buffer.demonstrated, buffer.corrected, buffer.better])]
    rewards = networks.forward(torch.from_numpy(good).expand(previous.members, *good.shape).flatten(1, 2))[0]
    rewards = rewards.unflatten(1, good.shape[:2])
    if (1.0 - rewards.square()).mean(dim=-1).gt(LEAST_SLOPE).all():
        return True
    for member in range(previous.members):
        networks.restart(member)
    return False


def _optimise(networks: Networks, buffer: RankingsBuffer, config: TrainingConfig, reliability: Sequence[float],
              steps: int, learning_rate: float, rng: np.random.Generator,
              on_progress: Callable[[float], None] | None) -> None:
    """Minimise eq. M9, each term times its reliability, with Adam under a cosine schedule; restart members that die."""
    batches, adam = Batches(buffer, config, reliability), Adam(networks.flat, networks.gradient)
    gradient = LossGradient(networks, batches.comparisons, config.rationality)
    weights, slopes = networks.flat[:networks.matrix_entries], networks.gradient[:networks.matrix_entries]
    # what features explain is left to them
    penalty = config.residual_penalty if config.features else config.weight_penalty
    shown = torch.from_numpy(buffer.shown).expand(config.members, *buffer.shown.shape)
    for step, (motions, scale) in enumerate(batches.draw(steps, rng)):
        gradient.write(motions, scale)
        slopes.add_(weights, alpha=2.0 * penalty)
        adam.step(learning_rate * 0.5 * (1.0 + np.cos(np.pi * step / steps)))
        if step in (steps // 10, steps // 4, steps // 2):
            for member in networks.dead_members(shown):
                networks.restart(member)
                for moments in (adam.mean, adam.square):
                    for part in itertools.chain(*networks.parts_of(moments)):
                        part[member] = 0.0
        if on_progress is not None and (step + 1) % max(1, steps // 20) == 0:
            on_progress((step + 1) / steps)
    if dead := networks.dead_members(shown):
        raise TrainingError(f"training left {len(dead)} of {config.members} members dead or diverged",
                            mend="lower the learning rate, or train again with another seed")


def _evaluate(networks: Networks, fresh: RankingsBuffer, rationality: float) -> tuple[LossTerms, float]:
    """Losses on fresh alternatives, and the share of comparisons that the members' mean decides rightly."""
    members, motions = len(networks.weights[0]), fresh.shown.shape[1:]
    groups = [torch.from_numpy(g) for g in (fresh.shown, fresh.demonstration_alternatives,
                                            fresh.correction_alternatives)]
    returns = [networks.rewards(g.reshape(1, -1, *motions).expand(members, -1, -1, -1)).sum(dim=-1) for g in groups]
    shown, demonstrations, corrections = (
        r.reshape(members, *g.shape[:-2]) for r, g in zip(returns, groups, strict=True))
    scaled = rationality * shown
    terms = LossTerms(
        demonstrations=demonstration_loss(scaled[:, fresh.demonstrated], rationality * demonstrations),
        corrections=correction_loss(scaled[:, fresh.corrected], scaled[:, fresh.planned], rationality * corrections),
        preferences=preference_loss(scaled[:, fresh.better], scaled[:, fresh.worse]))
    mean, demonstrations, corrections = shown.mean(dim=0), demonstrations.mean(dim=0), corrections.mean(dim=0)
    decided = torch.cat([
        (mean[fresh.demonstrated][:, None] - demonstrations).flatten(),
        (mean[fresh.corrected][:, None] - corrections).flatten(),
        mean[fresh.corrected] - mean[fresh.planned], mean[fresh.better] - mean[fresh.worse]])
    return terms, float((decided > 0).float().mean())


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
