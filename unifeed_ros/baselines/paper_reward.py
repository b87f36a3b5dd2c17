"""The paper's way of training the reward ensemble, written plainly: the peer that this project's training is timed by.

What the paper leaves out follows its public relatives: two hidden layers of 128, leaky ReLU and tanh, Glorot's uniform
start, Adam at 1e-3 and at a tenth of it for the last hundred of 500 epochs, 32 pairs an epoch, cross-entropy of summed
rewards plus 0.005 times the sum of squared weights, three members one after the other, two forward passes a pair.

It learns from the same buffer as this project's training, which spares it a rule for the size of deformations.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from unifeed_ros.core.reward.activations import LEAK
from unifeed_ros.core.reward.buffer import RankingsBuffer
from unifeed_ros.core.reward.ensemble import RewardEnsemble


@dataclass(frozen=True, kw_only=True)
class PaperTraining:
    """Settings of the procedure."""

    members: int = 3
    """Number of networks."""
    width: int = 128
    """Width of the two hidden layers."""
    epochs: int = 500
    """Steps of the optimiser."""
    slow_epochs: int = 100
    """Steps at the end with a tenth of the learning rate."""
    pairs: int = 32
    """Pairs drawn from the buffer for one step."""
    learning_rate: float = 1e-3
    """Learning rate of Adam."""
    penalty: float = 0.005
    """Weight of the sum of squared weights."""
    together: bool = False
    """True: the pairs of a step in one forward pass, the same training sooner; rounding differs."""


def buffer_pairs(buffer: RankingsBuffer, ranked: int) -> tuple[Tensor, Tensor]:
    """List every pair of Algorithm 1's buffer.

    Args:
        buffer: Comparisons as arrays.
        ranked: How often each ranked pair stands in the buffer N_q.

    Returns:
        Better and worse motions as network inputs, shape (P, H, I) each. A correction beats its plan as often as it
        beats an alternative (both terms of paper eq. M5).
    """
    better: list[np.ndarray] = []
    worse: list[np.ndarray] = []
    for at, alternatives in zip(buffer.demonstrated, buffer.demonstration_alternatives, strict=True):
        better += [buffer.shown[at]] * len(alternatives)
        worse += list(alternatives)
    for at, plan, alternatives in zip(buffer.corrected, buffer.planned, buffer.correction_alternatives, strict=True):
        better += [buffer.shown[at]] * (2 * len(alternatives))
        worse += [*alternatives, *([buffer.shown[plan]] * len(alternatives))]
    for first, second in zip(buffer.better, buffer.worse, strict=True):
        better += [buffer.shown[first]] * ranked
        worse += [buffer.shown[second]] * ranked
    return torch.from_numpy(np.stack(better)), torch.from_numpy(np.stack(worse))


def train_as_the_paper(pairs: tuple[Tensor, Tensor], *, inputs: tuple[str, ...], robot: str, frame: str, seed: int,
                       config: PaperTraining | None = None) -> RewardEnsemble:
    """Train three networks one after the other (paper eq. M9 and Algorithm 1).

    Args:
        pairs: Better and worse motions, as from buffer_pairs.
        inputs: Names of the networks' inputs.
        robot: Robot that was taught.
        frame: Frame of its positions.
        seed: Seed of the first weights and of the pairs drawn.
        config: Settings.

    Returns:
        The ensemble.
    """
    config = config or PaperTraining()
    networks = []
    for member in range(config.members):
        torch.manual_seed(1000 * seed + member)
        networks.append(_train_member(*pairs, config, np.random.default_rng([seed, member])))
    layers = [[layer for layer in network if isinstance(layer, nn.Linear)] for network in networks]
    stacked = list(zip(*layers, strict=True))
    return RewardEnsemble(
        version=1, robot=robot, frame=frame, inputs=inputs, layer_sizes=(len(inputs), config.width, config.width, 1),
        weights=tuple(np.stack([layer.weight.detach().numpy().T for layer in level]) for level in stacked),
        biases=tuple(np.stack([layer.bias.detach().numpy() for layer in level]) for level in stacked), seed=seed)


def _train_member(better: Tensor, worse: Tensor, config: PaperTraining, rng: np.random.Generator) -> nn.Sequential:
    network = _new_network(better.shape[-1], config.width)
    adam = torch.optim.Adam(network.parameters(), lr=config.learning_rate)
    schedule = torch.optim.lr_scheduler.MultiStepLR(adam, [config.epochs - config.slow_epochs], gamma=0.1)
    loss_of = _loss_together if config.together else _loss_pair_by_pair
    for _ in range(config.epochs):
        drawn = rng.integers(len(better), size=config.pairs)
        squares = torch.stack([parameter.square().sum() for parameter in network.parameters()]).sum()
        loss = loss_of(network, better[drawn], worse[drawn]) + config.penalty * squares
        adam.zero_grad()
        loss.backward()
        adam.step()
        schedule.step()
    return network


def _new_network(inputs: int, width: int) -> nn.Sequential:
    network = nn.Sequential(nn.Linear(inputs, width), nn.LeakyReLU(LEAK), nn.Linear(width, width), nn.LeakyReLU(LEAK),
                            nn.Linear(width, 1), nn.Tanh())
    for layer in network:
        if isinstance(layer, nn.Linear):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)
    return network


def _loss_pair_by_pair(network: nn.Sequential, better: Tensor, worse: Tensor) -> Tensor:
    """Mean cross-entropy of eq. M3, one pair after the other."""
    losses = []
    for winner, loser in zip(better, worse, strict=True):
        returns = torch.stack([network(winner).sum(), network(loser).sum()])
        losses.append(nn.functional.cross_entropy(returns[None], torch.zeros(1, dtype=torch.long)))
    return torch.stack(losses).mean()


def _loss_together(network: nn.Sequential, better: Tensor, worse: Tensor) -> Tensor:
    """Compute the same for all pairs in one forward pass."""
    returns = network(torch.stack([better, worse], dim=1))[..., 0].sum(dim=-1)
    return nn.functional.cross_entropy(returns, torch.zeros(len(returns), dtype=torch.long))
