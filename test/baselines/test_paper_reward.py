"""The paper's procedure learns what it is shown, and its two ways of adding up a step's pairs are one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from unifeed_ros.baselines.paper_reward import PaperTraining, buffer_pairs, train_as_the_paper
from unifeed_ros.core.reward.buffer import RankingsBuffer

INPUTS = ("x", "y", "z", "axis_x", "axis_y", "axis_z", "goal_dx", "goal_dy", "goal_dz")
NAMES = {"inputs": INPUTS, "robot": "panda", "frame": "panda_link0"}


@pytest.fixture(scope="module")
def pairs():
    """Motions that end high are better."""
    rng = np.random.default_rng(0)
    better, worse = (rng.normal(scale=0.3, size=(40, 6, len(INPUTS))).astype(np.float32) for _ in range(2))
    better[..., 2] += 0.5
    return torch.from_numpy(better), torch.from_numpy(worse)


def test_it_learns_what_is_better(pairs):
    config = PaperTraining(epochs=60, slow_epochs=10, together=True)
    ensemble = train_as_the_paper(pairs, **NAMES, seed=0, config=config)
    for weight, shape in zip(ensemble.weights, [(3, 9, 128), (3, 128, 128), (3, 128, 1)], strict=True):
        assert weight.shape == shape
    low, high = (returns(ensemble, motions) for motions in reversed(pairs))
    assert (high > low).mean() > 0.9


def returns(ensemble, motions):
    """Put motions through the published weights by hand, shape (m, motions)."""
    hidden = motions.numpy()[None]
    for layer, (weight, bias) in enumerate(zip(ensemble.weights, ensemble.biases, strict=True)):
        hidden = hidden @ weight[:, None] + bias[:, None, None]
        hidden = np.tanh(hidden) if layer == 2 else np.where(hidden > 0, hidden, 0.01 * hidden)
    return hidden[..., 0].sum(axis=-1)


def test_pair_by_pair_and_together_are_the_same_training(pairs):
    short = PaperTraining(epochs=4, slow_epochs=1)
    one = train_as_the_paper(pairs, **NAMES, seed=3, config=short)
    other = train_as_the_paper(pairs, **NAMES, seed=3, config=replace(short, together=True))
    np.testing.assert_allclose(one.flat_weights(), other.flat_weights(), atol=1e-5)
    again = train_as_the_paper(pairs, **NAMES, seed=4, config=short)
    assert np.abs(again.flat_weights() - other.flat_weights()).max() > 0.01


def test_the_buffer_holds_every_pair_as_often_as_algorithm_1_says():
    motion = lambda value: np.full((2, 3), value, dtype=np.float32)  # noqa: E731 - local
    buffer = RankingsBuffer(
        inputs=("a", "b", "c"), shown=np.stack([motion(k) for k in range(5)]), demonstrated=np.array([0]),
        corrected=np.array([1]), planned=np.array([2]), better=np.array([3]), worse=np.array([4]),
        demonstration_alternatives=np.stack([motion(10), motion(11)])[None],
        correction_alternatives=np.stack([motion(20), motion(21), motion(22)])[None])
    better, worse = buffer_pairs(buffer, ranked=2)
    listed = list(zip(better[:, 0, 0].tolist(), worse[:, 0, 0].tolist(), strict=True))
    assert listed == [(0, 10), (0, 11), (1, 20), (1, 21), (1, 22), (1, 2), (1, 2), (1, 2), (3, 4), (3, 4)]
