"""Cross-entropy of comparisons between motions (paper eqs. M3 to M6 and M9)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


def choice_loss(better: Tensor, worse: Tensor) -> Tensor:
    """Compute how surprising it is that the better motion was chosen.

    -log P(better > worse) = log(1 + exp(R_worse - R_better)), the softmax of paper eq. M3 for two options. Written
    as a soft-plus, it neither overflows nor loses its gradient.

    Args:
        better: Returns of the chosen motions, any shape [reward].
        worse: Returns of the others, the same shape [reward].

    Returns:
        Cross-entropy of each comparison [nat].
    """
    return torch.nn.functional.softplus(worse - better)


@dataclass(frozen=True, kw_only=True)
class LossTerms:
    """The three losses of each member."""

    demonstrations: Tensor
    """Paper eq. M4, shape (m,) [nat]."""
    corrections: Tensor
    """Paper eq. M5, shape (m,) [nat]."""
    preferences: Tensor
    """Paper eq. M6, shape (m,) [nat]."""

    @property
    def total(self) -> Tensor:
        """Sum of the three (paper eq. M9), shape (m,) [nat]."""
        return self.demonstrations + self.corrections + self.preferences


def demonstration_loss(demonstrated: Tensor, alternatives: Tensor) -> Tensor:
    """Compare each demonstration with its alternatives (paper eq. M4).

    Args:
        demonstrated: Returns of the demonstrations, shape (m, D) [reward].
        alternatives: Returns of deformations of each, shape (m, D, K) [reward].

    Returns:
        Sum over demonstrations of the mean over alternatives, shape (m,) [nat].
    """
    return choice_loss(demonstrated[..., None], alternatives).mean(dim=-1).sum(dim=-1)


def correction_loss(corrected: Tensor, planned: Tensor, alternatives: Tensor) -> Tensor:
    """Compare each correction with what the robot meant to do, and with its alternatives (paper eq. M5).

    Args:
        corrected: Returns of the corrected spans, shape (m, C) [reward].
        planned: Returns of the planned spans, shape (m, C) [reward].
        alternatives: Returns of deformations of the corrected spans, shape (m, C, K) [reward].

    Returns:
        Sum over corrections of both terms, shape (m,) [nat].
    """
    return choice_loss(corrected, planned).sum(dim=-1) + demonstration_loss(corrected, alternatives)


def preference_loss(better: Tensor, worse: Tensor) -> Tensor:
    """Compare the ranked options (paper eq. M6).

    Args:
        better: Returns of the better option of each ranked pair, shape (m, P) [reward].
        worse: Returns of the worse ones, shape (m, P) [reward].

    Returns:
        Sum over the ranked pairs, shape (m,) [nat].
    """
    return choice_loss(better, worse).sum(dim=-1)
