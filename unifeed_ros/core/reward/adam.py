"""Adam (Kingma and Ba 2015) for one row of weights."""

from __future__ import annotations

import torch
from torch import Tensor

DECAY, SQUARE_DECAY, SMALL = 0.9, 0.99, 1e-8
"""The method's beta_1, beta_2 and epsilon. Torch's beta_2 of 0.999 would remember a whole training of 200 steps: with
0.99, the rate follows as the gradient shrinks, and the learned rewards plan better after as many steps."""


class Adam:
    """Moves weights against their gradient.

    torch's own loads a compiler on first use, seconds that a command line would wait for.

    Attributes:
        mean: Running mean of the gradient, shape (W,).
        square: Running mean of its square, shape (W,).
    """

    def __init__(self, weights: Tensor, gradient: Tensor) -> None:
        """Hold the tensors.

        Args:
            weights: What is changed, shape (W,).
            gradient: Where its gradient stands when a step is made, shape (W,).
        """
        self._weights, self._gradient = weights, gradient
        self.mean, self.square = torch.zeros_like(weights), torch.zeros_like(weights)
        self._steps = 0

    def step(self, rate: float) -> None:
        """Make one step.

        Args:
            rate: Learning rate.
        """
        self._steps += 1
        self.mean.lerp_(self._gradient, 1.0 - DECAY)
        self.square.mul_(SQUARE_DECAY).addcmul_(self._gradient, self._gradient, value=1.0 - SQUARE_DECAY)
        room = (self.square / (1.0 - SQUARE_DECAY**self._steps)).sqrt_().add_(SMALL)
        self._weights.addcdiv_(self.mean, room, value=-rate / (1.0 - DECAY**self._steps))
