"""Laws of the training's own gradient, and of comparing motions at some of their way-points."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from unifeed_ros.core.reward.activations import ACTIVATIONS
from unifeed_ros.core.reward.adam import DECAY, SQUARE_DECAY, Adam
from unifeed_ros.core.reward.batches import every_kth
from unifeed_ros.core.reward.gradients import Comparisons, LossGradient
from unifeed_ros.core.reward.losses import choice_loss
from unifeed_ros.core.reward.networks import Networks

MEMBERS, MOTIONS, STATES, SIZES, FEATURES = 3, 6, 4, (5, 12, 7, 1), 2
SCALE, RATIONALITY = 2.0, 5.0


@pytest.fixture
def comparisons() -> Comparisons:
    """Motion 0 beats four others, once a motion that also wins."""
    return Comparisons(better=torch.tensor([0, 0, 0, 2, 1]), worse=torch.tensor([3, 4, 2, 5, 0]),
                       weights=torch.tensor([0.1, 0.3, 0.2, 0.3, 0.1]), motions=MOTIONS)


def motions(seed: int = 0) -> torch.Tensor:
    return torch.randn(MEMBERS, MOTIONS, STATES, SIZES[0], generator=torch.Generator().manual_seed(seed))


def random_networks(activation: str) -> Networks:
    networks = Networks(SIZES, MEMBERS, np.random.default_rng(0), activation, FEATURES)
    for bias in networks.biases:
        bias.copy_(0.3 * torch.randn(bias.shape, generator=torch.Generator().manual_seed(1)))
    networks.thetas.copy_(0.1 * torch.randn(networks.thetas.shape, generator=torch.Generator().manual_seed(3)))
    return networks


def loss(networks: Networks, comparisons: Comparisons) -> torch.Tensor:
    """Eqs. M3 to M9 as they stand, without the written-out gradient's matrices."""
    returns = RATIONALITY * SCALE * networks.rewards(motions()).sum(dim=-1)
    return (choice_loss(returns[:, comparisons.better], returns[:, comparisons.worse]) * comparisons.weights).sum()


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_gradient_is_that_of_the_losses(activation, comparisons):
    networks = random_networks(activation)
    LossGradient(networks, comparisons, RATIONALITY).write(motions(), SCALE)
    networks.flat.requires_grad_(True)
    networks.weights, networks.biases, (networks.thetas,) = networks.parts_of(networks.flat)
    loss(networks, comparisons).backward()
    np.testing.assert_allclose(networks.gradient, networks.flat.grad, rtol=1e-5, atol=1e-5)
    assert networks.gradient.abs().max() > 1e-2


@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_gradient_is_the_slope_of_the_loss(activation, comparisons):
    networks = random_networks(activation)
    LossGradient(networks, comparisons, RATIONALITY).write(motions(), SCALE)
    gradient, step = networks.gradient.double(), 1e-6
    start = networks.flat.double()
    directions = torch.randn(20, len(start), dtype=torch.float64, generator=torch.Generator().manual_seed(2))

    def along(direction: torch.Tensor) -> float:
        networks.weights, networks.biases, (networks.thetas,) = networks.parts_of(start + direction)
        returns = RATIONALITY * SCALE * networks.rewards(motions().double()).sum(dim=-1)
        gaps = choice_loss(returns[:, comparisons.better], returns[:, comparisons.worse])
        return float((gaps * comparisons.weights).sum())

    for direction in directions:
        slope = (along(step * direction) - along(-step * direction)) / (2 * step)
        assert float(gradient @ direction) == pytest.approx(slope, rel=1e-4, abs=1e-4)


def test_members_do_not_share_a_gradient(comparisons):
    networks = random_networks("leaky_relu")
    gradient, inputs = LossGradient(networks, comparisons, RATIONALITY), motions()
    gradient.write(inputs, SCALE)
    parts = [*networks.weight_gradients, networks.theta_gradient]
    before = [part.clone() for part in parts]
    inputs[0] += 1.0
    gradient.write(inputs, SCALE)
    for old, new in zip(before, parts, strict=True):
        assert not torch.equal(old[0], new[0])
        torch.testing.assert_close(old[1:], new[1:])


@pytest.mark.parametrize(("states", "stride"), [(10, 2), (40, 8), (11, 2), (7, 3)])
def test_some_waypoints_give_the_return_of_all_on_average(states, stride):
    rewards = np.random.default_rng(0).normal(size=(5, states, 1))
    estimates = [stride * part.sum(dim=1) for part in every_kth(rewards, stride)]
    np.testing.assert_allclose(torch.stack(estimates).mean(dim=0), rewards.sum(axis=1))


def test_adam_makes_torchs_steps():
    weights = torch.randn(50, generator=torch.Generator().manual_seed(0))
    theirs = weights.clone().requires_grad_(True)
    gradient = torch.zeros(50)
    ours, other = Adam(weights, gradient), torch.optim.Adam([theirs], lr=0.01, betas=(DECAY, SQUARE_DECAY))
    for seed in range(5):
        gradient.copy_(torch.randn(50, generator=torch.Generator().manual_seed(seed)))
        theirs.grad = gradient.clone()
        ours.step(0.01)
        other.step()
    torch.testing.assert_close(weights, theirs.detach())
