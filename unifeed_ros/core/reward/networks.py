"""The members' weights while they are trained."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from math import prod

import numpy as np
import torch
from torch import Tensor

from unifeed_ros.core.reward.activations import LEAK, SHARPNESS
from unifeed_ros.core.reward.ensemble import RewardEnsemble

SPREAD = 1e-4
"""Standard deviation of the rewards of the shown states under which a member counts as dead [1]."""

FEATURE_RATE = 10.0
"""How much faster than the networks' weights those of the features learn: what is known comes first."""


FIRST_BIAS = 0.1
"""Largest bias that the first layer begins with [m]: without any, all its kinks meet where the inputs are zero, at the
goal, and what matters elsewhere is learned late."""


class Networks:
    """All members' weights, one tensor a layer, and their joint forward pass.

    Attributes:
        activation: Activation of the hidden layers.
        flat: Everything that is trained in one row, shape (W,): all weights, then all biases, each layer by
            layer, then the weights of the features.
        gradient: Room for the gradient of a loss with respect to it, shape (W,).
        weights: Its parts that are matrices of a layer, shape (m, in, out).
        biases: Its parts that are biases of a layer, shape (m, 1, out).
        thetas: Its part that is the weights of the features, the last F inputs, over FEATURE_RATE, shape (m, 1, F).
        weight_gradients: The gradient's parts that belong to the weights.
        bias_gradients: The gradient's parts that belong to the biases.
        theta_gradient: The gradient's part that belongs to the weights of the features.
        matrix_entries: How many entries of a row are weights; those of the biases follow.
    """

    def __init__(self, sizes: Sequence[int], members: int, rng: np.random.Generator,
                 activation: str = "leaky_relu", features: int = 0) -> None:
        """Draw the first weights.

        Args:
            sizes: Widths from the input to the output.
            members: Number of networks m.
            rng: Source of randomness, kept for restarts.
            activation: Activation of the hidden layers.
            features: How many of the inputs, the last ones, are features F.
        """
        self._sizes, self._members, self._rng, self.activation = tuple(sizes), members, rng, activation
        self._features = features
        self.flat = torch.zeros(members * (features + sum((i + 1) * o for i, o in itertools.pairwise(sizes))))
        self.gradient = torch.zeros_like(self.flat)
        self.weights, self.biases, (self.thetas,) = self.parts_of(self.flat)
        self.weight_gradients, self.bias_gradients, (self.theta_gradient,) = self.parts_of(self.gradient)
        self.matrix_entries = sum(weight.numel() for weight in self.weights)
        for member in range(members):
            self.restart(member)

    def parts_of(self, flat: Tensor) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
        """Cut a row like `flat` into its parts, without copying.

        Args:
            flat: Shape (W,).

        Returns:
            Weights and biases of each layer, and the weights of the features, shaped as the attributes.
        """
        shapes = [(self._members, i, o) for i, o in itertools.pairwise(self._sizes)]
        shapes += [(self._members, 1, o) for o in (*self._sizes[1:], self._features)]
        parts = [part.view(shape) for part, shape in zip(flat.split(list(map(prod, shapes))), shapes, strict=True)]
        layers = len(self._sizes) - 1
        return parts[:layers], parts[layers:2 * layers], parts[2 * layers:]

    def restart(self, member: int) -> None:
        """Draw one member's weights anew: Glorot's uniform rule; biases zero but in the first layer; thetas zero."""
        for weight, bias in zip(self.weights, self.biases, strict=True):
            bound = np.sqrt(6.0 / (weight.shape[1] + weight.shape[2]))
            weight[member] = torch.from_numpy(self._rng.uniform(-bound, bound, weight.shape[1:]).astype(np.float32))
            bias[member] = 0.0
        first = self.biases[0][member]
        first.copy_(torch.from_numpy(self._rng.uniform(-FIRST_BIAS, FIRST_BIAS, first.shape)))
        self.thetas[member] = 0.0

    def load(self, ensemble: RewardEnsemble, inputs: tuple[str, ...]) -> bool:
        """Take over an ensemble's weights.

        Args:
            ensemble: Where to take them from.
            inputs: Names of the inputs that these networks are to have.

        Returns:
            False if its inputs, widths, activation or number of members differ; then nothing changes.
        """
        if (ensemble.layer_sizes, ensemble.inputs, ensemble.members, ensemble.activation) != (
                self._sizes, inputs, self._members, self.activation):
            return False
        for mine, theirs in zip(self.weights, ensemble.weights, strict=True):
            mine.copy_(torch.from_numpy(theirs.copy()))
        for mine, theirs in zip(self.biases, ensemble.biases, strict=True):
            mine.copy_(torch.from_numpy(theirs[:, None].copy()))
        self.thetas.copy_(torch.from_numpy(ensemble.thetas[:, None] / FEATURE_RATE))
        return True

    def forward(self, inputs: Tensor) -> tuple[Tensor, list[Tensor], list[Tensor]]:
        """Compute the output of each member's network, and keep what its gradient needs.

        Args:
            inputs: Network inputs, shape (m, N, I).

        Returns:
            Outputs, shape (m, N) [1]; what goes into each layer; what the hidden layers' activations were applied to.
        """
        into, before = [inputs], []
        for weight, bias in zip(self.weights[:-1], self.biases[:-1], strict=True):
            before.append(torch.baddbmm(bias, into[-1], weight))
            into.append(activate(self.activation, before[-1]))
        return self._last(into[-1]).tanh_(), into, before

    def _last(self, hidden: Tensor) -> Tensor:
        """Apply the last layer: it has one output, and a weighted sum is faster than a product of matrices."""
        return (hidden * self.weights[-1].transpose(1, 2)).sum(dim=-1).add_(self.biases[-1][..., 0])

    def features_of(self, inputs: Tensor) -> Tensor:
        """Take the features from the inputs, times the rate that their weights learn at.

        Args:
            inputs: Network inputs, shape (m, N, I).

        Returns:
            Features, shape (m, N, F).
        """
        return FEATURE_RATE * inputs[..., inputs.shape[-1] - self._features:]

    def rewards(self, motions: Tensor) -> Tensor:
        """Compute each member's reward of each state.

        Args:
            motions: Network inputs along T motions, shape (m, T, H, I).

        Returns:
            Rewards, shape (m, T, H) [1].
        """
        inputs = motions.flatten(1, 2)
        outputs = self.forward(inputs)[0]
        if self._features:
            outputs = outputs + (self.features_of(inputs) * self.thetas).sum(dim=-1)
        return outputs.unflatten(1, motions.shape[1:3])

    def dead_members(self, motions: Tensor) -> list[int]:
        """Find members that reward all states alike, or whose rewards are not numbers.

        Args:
            motions: Network inputs, shape (m, T, H, I).

        Returns:
            Indices of the members.
        """
        spreads = self.rewards(motions).flatten(1).std(dim=1).tolist()
        return [member for member, spread in enumerate(spreads) if not spread > SPREAD]


def activate(name: str, inputs: Tensor) -> Tensor:
    """Apply an activation (see activations.py, which has the same in numpy).

    Args:
        name: Name of the activation.
        inputs: Any shape.

    Returns:
        Values, the same shape.
    """
    if name == "tanh":
        return torch.tanh(inputs)
    if name == "leaky_softplus":
        return torch.nn.functional.softplus(inputs, SHARPNESS).mul_(1.0 - LEAK).add_(inputs, alpha=LEAK)
    return torch.nn.functional.leaky_relu(inputs, LEAK)


def backpropagate(name: str, backward: Tensor, inputs: Tensor, values: Tensor) -> Tensor:
    """Multiply a gradient by an activation's slope.

    Args:
        name: Name of the activation.
        backward: Gradient with respect to the values; it may be overwritten.
        inputs: What the activation was applied to, the same shape.
        values: Its values, the same shape.

    Returns:
        Gradient with respect to the inputs, the same shape.
    """
    if name == "tanh":
        return torch.ops.aten.tanh_backward(backward, values)
    if name == "leaky_softplus":
        return backward.mul_(torch.sigmoid(SHARPNESS * inputs).mul_(1.0 - LEAK).add_(LEAK))
    return torch.ops.aten.leaky_relu_backward(backward, inputs, LEAK, False)
