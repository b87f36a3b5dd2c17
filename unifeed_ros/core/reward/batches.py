"""What each step of the training compares: some alternatives of each shown motion, at some of their way-points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import torch
from torch import Tensor

from unifeed_ros.core.reward.buffer import RankingsBuffer
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.gradients import Comparisons


def every_kth(rows: np.ndarray, stride: int) -> list[Tensor]:
    """Cut motions into their way-points 0, k, 2k..., 1, k + 1..., and so on.

    States along a smooth motion are much alike: k times the sum over one of these parts, chosen at random, has the sum
    over all way-points as its expectation, and costs a k-th of it.

    Args:
        rows: Motions, shape (T, H, I).
        stride: Number of parts k.

    Returns:
        The parts, shape (T, about H / k, I) each.
    """
    return [torch.from_numpy(np.ascontiguousarray(rows[:, first::stride])) for first in range(stride)]


class Batches:
    """Draws what each step compares.

    Attributes:
        comparisons: Which of a step's motions beats which; the same in each step.
    """

    def __init__(self, buffer: RankingsBuffer, config: TrainingConfig,
                 reliability: Sequence[float] = (1.0, 1.0, 1.0)) -> None:
        """Lay the buffer's motions out for drawing.

        Args:
            buffer: Shown motions and their alternatives.
            config: Settings.
            reliability: Weights of demonstrations, corrections and preferences.
        """
        self._members, self._shown = config.members, len(buffer.shown)
        self._groups = len(buffer.demonstrated) + len(buffer.corrected)
        self._each = max(1, config.batch // max(1, self._groups))
        self._pool = config.pool
        self._stride = max(1, buffer.shown.shape[1] // config.compared_waypoints)
        alternatives = (buffer.demonstration_alternatives, buffer.correction_alternatives)
        rows = np.concatenate([buffer.shown, *(a.reshape(-1, *buffer.shown.shape[1:]) for a in alternatives)])
        self._parts = every_kth(rows, self._stride)
        self.comparisons = _comparisons(buffer, config, reliability, self._each)

    def draw(self, steps: int, rng: np.random.Generator) -> Iterator[tuple[Tensor, float]]:
        """Draw the motions of each step: all that were shown, then each member's own choice of alternatives.

        Args:
            steps: Number of steps.
            rng: Source of randomness.

        Returns:
            For each step, network inputs of T motions, shape (m, T, S, I), and what sums over their S way-points are
            to be multiplied by.
        """
        first = self._shown + self._pool * np.arange(self._groups)[:, None]
        drawn = first + rng.integers(self._pool, size=(steps, self._members, self._groups, self._each))
        shown = np.broadcast_to(np.arange(self._shown), (steps, self._members, self._shown))
        rows = torch.from_numpy(np.concatenate([shown, drawn.reshape(steps, self._members, -1)], axis=2))
        for chosen, part in zip(rows, rng.integers(self._stride, size=steps), strict=True):
            motions = self._parts[part]
            picked = motions.flatten(1).index_select(0, chosen.flatten())
            yield picked.view(*chosen.shape, *motions.shape[1:]), float(self._stride)


def _comparisons(buffer: RankingsBuffer, config: TrainingConfig, reliability: Sequence[float],
                 each: int) -> Comparisons:
    """Pair the motions of a step: shown ones first, then `each` alternatives of each demonstration and correction."""
    winners = np.concatenate([buffer.demonstrated, buffer.corrected])
    counts = (config.demonstration_comparisons, config.correction_comparisons, config.preference_comparisons)
    shown, led, ranked = (trust * count for trust, count in zip(reliability, counts, strict=True))
    kinds = ((np.repeat(buffer.demonstrated, each), shown / each), (np.repeat(buffer.corrected, each), led / each),
             (buffer.corrected, led), (buffer.better, ranked))
    alternatives = len(buffer.shown) + np.arange(each * len(winners))
    weights = np.concatenate([np.full(len(better), weight) for better, weight in kinds])
    return Comparisons(
        better=torch.from_numpy(np.concatenate([better for better, _ in kinds])),
        worse=torch.from_numpy(np.concatenate([alternatives, buffer.planned, buffer.worse])),
        weights=torch.from_numpy((weights / weights.sum()).astype(np.float32)),
        motions=len(buffer.shown) + len(alternatives))
