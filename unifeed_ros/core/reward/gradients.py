"""The gradient of the comparisons' cross-entropy, written out: what automatic differentiation gives, sooner.

Networks this small spend more time between operations than in them; here every comparison of a step is one column of a
matrix, and each layer is three operations.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from unifeed_ros.core.reward.networks import Networks, backpropagate


@dataclass(frozen=True, kw_only=True)
class Comparisons:
    """Which of a step's T motions beats which, and how much that counts."""

    better: Tensor
    """Index of the better motion of each comparison, shape (C,)."""
    worse: Tensor
    """Index of the worse one, shape (C,)."""
    weights: Tensor
    """Weight of each comparison's cross-entropy in the loss, shape (C,)."""
    motions: int
    """Number of motions T."""

    def signs(self) -> Tensor:
        """Write each comparison as a column: 1 for the worse motion, -1 for the better one.

        Returns:
            Matrix, shape (T, C): returns @ matrix are the gaps between returns that surprise.
        """
        columns = torch.arange(len(self.better))
        matrix = torch.zeros(self.motions, len(self.better))
        matrix[self.worse, columns] += 1.0
        matrix[self.better, columns] -= 1.0
        return matrix


class LossGradient:
    """Gradient of sum_c w_c softplus(beta (R_worse - R_better)) of each member with respect to its weights."""

    def __init__(self, networks: Networks, comparisons: Comparisons, rationality: float) -> None:
        """Hold the networks and the comparisons.

        Args:
            networks: The members; their `gradient` is written.
            comparisons: The comparisons, alike in each step.
            rationality: Factor beta on the returns in paper eq. M3 [1/reward].
        """
        self._networks, self._comparisons, self._rationality = networks, comparisons, rationality
        self._matrices: dict[tuple[int, float], tuple[Tensor, Tensor]] = {}

    def write(self, motions: Tensor, scale: float) -> None:
        """Write the gradient of one step's loss into the networks' gradient.

        Args:
            motions: Network inputs along T motions, shape (m, T, S, I).
            scale: What a sum of S rewards is multiplied by to estimate the return of a whole motion.
        """
        networks = self._networks
        outputs, into, before = networks.forward(motions.flatten(1, 2))
        gaps, slopes = self._matrices_of(motions.shape[2], scale)
        features = networks.features_of(into[0])
        rewards = outputs + (features * networks.thetas).sum(dim=-1) if features.shape[-1] else outputs
        by_state = torch.sigmoid(rewards @ gaps) @ slopes
        torch.bmm(by_state[:, None], features, out=networks.theta_gradient)
        last = torch.ops.aten.tanh_backward(by_state, outputs)[:, None]
        torch.bmm(last, into[-1], out=networks.weight_gradients[-1].transpose(1, 2))
        torch.sum(last, dim=2, keepdim=True, out=networks.bias_gradients[-1])
        backward = last.transpose(1, 2) * networks.weights[-1].transpose(1, 2)
        for layer in reversed(range(len(before))):
            backward = backpropagate(networks.activation, backward, before[layer], into[layer + 1])
            torch.bmm(into[layer].transpose(1, 2), backward, out=networks.weight_gradients[layer])
            torch.sum(backward, dim=1, keepdim=True, out=networks.bias_gradients[layer])
            if layer:
                backward = torch.bmm(backward, networks.weights[layer].transpose(1, 2))

    def _matrices_of(self, states: int, scale: float) -> tuple[Tensor, Tensor]:
        """Give the matrices from rewards to gaps, shape (T S, C), and from their slopes to the rewards', (C, T S)."""
        if (states, scale) not in self._matrices:
            gaps = self._rationality * scale * self._comparisons.signs().repeat_interleave(states, dim=0)
            self._matrices[states, scale] = gaps, self._comparisons.weights[:, None] * gaps.T
        return self._matrices[states, scale]
