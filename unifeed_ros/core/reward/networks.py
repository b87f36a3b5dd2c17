"""The members' weights while they are trained, and the comparisons put through them."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from unifeed_ros.core.reward.buffer import RankingsBuffer
from unifeed_ros.core.reward.ensemble import LEAK, RewardEnsemble
from unifeed_ros.core.reward.losses import LossTerms, correction_loss, demonstration_loss, preference_loss

SPREAD = 1e-4
"""Standard deviation of the rewards of the shown states under which a member counts as dead [1]."""

FEATURE_RATE = 10.0
"""How much faster than the networks' weights those of the features learn: what is known comes first."""


class Networks:
    """All members' weights, one tensor a layer, and their joint forward pass.

    Attributes:
        weights: Matrices of each layer, shape (m, in, out).
        biases: Biases of each layer, shape (m, 1, out).
        thetas: Weights of the features, which are the last F inputs, over FEATURE_RATE, shape (m, F, 1).
    """

    def __init__(self, sizes: Sequence[int], members: int, rng: np.random.Generator, features: int = 0) -> None:
        """Draw the first weights.

        Args:
            sizes: Widths from the input to the output.
            members: Number of networks m.
            rng: Source of randomness, kept for restarts.
            features: How many of the inputs, the last ones, are features F.
        """
        self._sizes, self._rng = tuple(sizes), rng
        layers = list(itertools.pairwise(sizes))
        self.weights = [torch.zeros(members, i, o) for i, o in layers]
        self.biases = [torch.zeros(members, 1, o) for _, o in layers]
        self.thetas = torch.zeros(members, features, 1)
        for member in range(members):
            self.restart(member)
        for parameter in self.parameters:
            parameter.requires_grad_(True)

    @property
    def parameters(self) -> list[Tensor]:
        """All tensors that are trained; their first axis is the member."""
        return [*self.weights, *self.biases, self.thetas]

    def restart(self, member: int) -> None:
        """Draw one member's weights anew (Glorot's uniform rule, biases and features' weights zero)."""
        with torch.no_grad():
            for weight, bias in zip(self.weights, self.biases, strict=True):
                bound = np.sqrt(6.0 / (weight.shape[1] + weight.shape[2]))
                weight[member] = torch.from_numpy(self._rng.uniform(-bound, bound, weight.shape[1:]).astype(np.float32))
                bias[member] = 0.0
            self.thetas[member] = 0.0

    def load(self, ensemble: RewardEnsemble, inputs: tuple[str, ...]) -> bool:
        """Take over an ensemble's weights.

        Args:
            ensemble: Where to take them from.
            inputs: Names of the inputs that these networks are to have.

        Returns:
            False if its inputs, widths or number of members differ; then nothing changes.
        """
        if (ensemble.layer_sizes, ensemble.inputs, ensemble.members) != (self._sizes, inputs, len(self.weights[0])):
            return False
        with torch.no_grad():
            for mine, theirs in zip(self.weights, ensemble.weights, strict=True):
                mine.copy_(torch.from_numpy(theirs.copy()))
            for mine, theirs in zip(self.biases, ensemble.biases, strict=True):
                mine.copy_(torch.from_numpy(theirs[:, None].copy()))
            self.thetas.copy_(torch.from_numpy(ensemble.thetas[..., None] / FEATURE_RATE))
        return True

    def rewards(self, motions: Tensor) -> Tensor:
        """Compute each member's reward of each state.

        Args:
            motions: Network inputs along T motions, shape (m, T, H, I).

        Returns:
            Rewards, shape (m, T, H) [1].
        """
        members, count, states, width = motions.shape
        hidden = motions.reshape(members, count * states, width)
        explained = torch.bmm(hidden[..., width - self.thetas.shape[1]:], FEATURE_RATE * self.thetas)
        for layer, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            hidden = torch.baddbmm(bias, hidden, weight)
            if layer < len(self.weights) - 1:
                hidden = torch.nn.functional.leaky_relu(hidden, LEAK)
        return (torch.tanh(hidden) + explained).reshape(members, count, states)

    def dead_members(self, motions: Tensor) -> list[int]:
        """Find members that reward all states alike, or whose rewards are not numbers.

        Args:
            motions: Network inputs, shape (m, T, H, I).

        Returns:
            Indices of the members.
        """
        with torch.no_grad():
            spreads = self.rewards(motions).flatten(1).std(dim=1).tolist()
        return [member for member, spread in enumerate(spreads) if not spread > SPREAD]


class Comparer:
    """Puts each shown motion and each alternative through the networks once, and compares their returns.

    Attributes:
        shown: Network inputs of the shown motions, shape (m, A, H, I).
    """

    def __init__(self, networks: Networks, buffer: RankingsBuffer, rationality: float) -> None:
        """Hold the networks and the buffer's arrays as tensors, without copying.

        Args:
            networks: The members.
            buffer: The comparisons.
            rationality: Factor beta on the returns in paper eq. M3 [1/reward].
        """
        self._networks, self._buffer, self._rationality = networks, buffer, rationality
        members = len(networks.weights[0])
        self.shown = torch.from_numpy(buffer.shown).expand(members, *buffer.shown.shape)
        self._demonstrations = torch.from_numpy(buffer.demonstration_alternatives)
        self._corrections = torch.from_numpy(buffer.correction_alternatives)

    def draw(self, count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
        """Draw some alternatives for each member on its own.

        Args:
            count: Alternatives K of each demonstration and each correction.
            rng: Source of randomness.

        Returns:
            Alternatives of the demonstrations, shape (m, D, K, H, I), and of the corrections, (m, C, K, H, I).
        """
        return self._pick(self._demonstrations, count, rng), self._pick(self._corrections, count, rng)

    def all_alternatives(self) -> tuple[Tensor, Tensor]:
        """Take every alternative in the buffer, shaped as by draw."""
        members = len(self.shown)
        return (self._demonstrations.expand(members, *self._demonstrations.shape),
                self._corrections.expand(members, *self._corrections.shape))

    def returns(self, alternatives: tuple[Tensor, Tensor]) -> tuple[Tensor, Tensor, Tensor]:
        """Compute returns: sums of the rewards of a motion's states.

        Args:
            alternatives: As from draw.

        Returns:
            Returns of the shown motions, shape (m, A), of the demonstrations' alternatives, (m, D, K), and of the
            corrections' alternatives, (m, C, K) [1].
        """
        motions = torch.cat([self.shown, *(a.flatten(1, 2) for a in alternatives)], dim=1)
        returns = self._networks.rewards(motions).sum(dim=-1)
        counts = [self.shown.shape[1], *(a.shape[1] * a.shape[2] for a in alternatives)]
        shown, demonstrations, corrections = torch.split(returns, counts, dim=1)
        return shown, demonstrations.reshape(alternatives[0].shape[:3]), corrections.reshape(alternatives[1].shape[:3])

    def losses(self, alternatives: tuple[Tensor, Tensor]) -> LossTerms:
        """Compute the three losses of each member (paper eqs. M4 to M6).

        Args:
            alternatives: As from draw.

        Returns:
            The losses.
        """
        shown, demonstrations, corrections = (self._rationality * r for r in self.returns(alternatives))
        buffer = self._buffer
        return LossTerms(
            demonstrations=demonstration_loss(shown[:, buffer.demonstrated], demonstrations),
            corrections=correction_loss(shown[:, buffer.corrected], shown[:, buffer.planned], corrections),
            preferences=preference_loss(shown[:, buffer.better], shown[:, buffer.worse]))

    def _pick(self, alternatives: Tensor, count: int, rng: np.random.Generator) -> Tensor:
        groups, available = alternatives.shape[:2]
        drawn = torch.from_numpy(rng.integers(available, size=(len(self.shown), groups, count)))
        return alternatives[torch.arange(groups)[:, None], drawn]
