"""The reward of what was taught so far: the same inputs give the same model, however it was come to."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Correction, FeedbackItem
from unifeed_ros.core.reward.config import TrainingConfig, TrainingResult
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel

LONGEST_CHAIN = 8
"""Trainings in a row, of which each goes on from the one before, after which one begins anew."""


def learn_reward(dataset: FeedbackDataset, robot: RobotModel, config: TrainingConfig, *, version: int, seed: int,
                 known: RewardEnsemble | None = None,
                 on_progress: Callable[[float], None] | None = None) -> TrainingResult:
    """Learn as if the inputs had come one by one, each learned from before the next.

    After a correction the model is learned from scratch: it says that the model is wrong, and going on from that one
    learns less of it in as few steps. After each other input, training goes on from the model of those before. Which
    inputs were taken back meanwhile, when trainings were asked for, and whether the learner was started anew make no
    difference to any byte; without `known` it takes up to LONGEST_CHAIN trainings.

    Args:
        dataset: What was taught.
        robot: The arm that was taught.
        config: Settings.
        version: Version of the new model.
        seed: Seed of everything random.
        known: Model that was learned like this, with these settings, of some inputs; what can be is gone on from.
        on_progress: Called now and then with the share of the work that is done.

    Returns:
        The ensemble, figures of the last training, and the seconds and steps of all that had to be done.

    Raises:
        TrainingError: Nothing to learn from, or a member that stayed dead or diverged.
    """
    items = dataset.comparisons()
    first = _chain_begin(items) + 1 if config.warm_steps else len(items)
    model: RewardEnsemble | None = None
    if known is not None and known.seed == seed:
        names = [item.id for item in items]
        silent = {item.id for item in dataset.items} - set(names)  # rankings that nothing is learned from
        learned = [name for name in known.feedback_ids if name not in silent]
        if first <= len(learned) < len(items) and learned == names[:len(learned)]:
            model, first = known, len(learned) + 1
    seconds, steps, stages = 0.0, 0, len(items) - first + 1
    for stage, end in enumerate(range(first, len(items) + 1)):
        part = dataset if end == len(items) else dataset.only(items[:end])
        progress = partial(_tell, on_progress, stage, stages) if on_progress is not None else None
        result = train_reward(part, robot, config, version=version, seed=seed, previous=model, on_progress=progress)
        model, seconds, steps = result.ensemble, seconds + result.seconds, steps + result.steps
    return replace(result, seconds=seconds, steps=steps)


def _chain_begin(items: Sequence[FeedbackItem]) -> int:
    """Give the number of the input after which the newest chain of trainings begins from scratch."""
    latest = max((k for k, item in enumerate(items) if isinstance(item, Correction)), default=0)
    return latest + (len(items) - 1 - latest) // LONGEST_CHAIN * LONGEST_CHAIN


def _tell(on_progress: Callable[[float], None], stage: int, stages: int, share: float) -> None:
    on_progress((stage + share) / stages)
