"""Laws of the losses (paper eqs. M3 to M6)."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unifeed_ros.core.reward.losses import (
    LossTerms,
    choice_loss,
    correction_loss,
    demonstration_loss,
    preference_loss,
)

returns = arrays(float, (3, 4), elements=st.floats(-40, 40))


def tensor(values: object) -> torch.Tensor:
    return torch.as_tensor(np.asarray(values, dtype=np.float64))


@given(better=returns, worse=returns)
def test_choice_loss_is_the_papers_softmax(better, worse):
    chance = np.exp(better) / (np.exp(better) + np.exp(worse))
    np.testing.assert_allclose(np.exp(-choice_loss(tensor(better), tensor(worse)).numpy()), chance, atol=1e-9)


@given(better=returns, worse=returns, shift=st.floats(-100, 100))
def test_a_constant_added_to_all_rewards_changes_nothing(better, worse, shift):
    args = tensor(better), tensor(worse), tensor(np.stack([worse, better], axis=-1))
    moved = [a + shift for a in args]
    for loss in (lambda b, w, _: preference_loss(b, w), lambda b, _, a: demonstration_loss(b, a), correction_loss):
        np.testing.assert_allclose(loss(*moved), loss(*args), atol=1e-9)


@given(better=returns, worse=returns, order=st.permutations(range(4)))
def test_the_order_of_pairs_changes_nothing(better, worse, order):
    np.testing.assert_allclose(preference_loss(tensor(better[:, order]), tensor(worse[:, order])),
                               preference_loss(tensor(better), tensor(worse)), atol=1e-9)


@pytest.mark.parametrize("gap", [-1e4, 1e4])
def test_losses_stay_finite_and_keep_their_gradient(gap):
    better = torch.zeros(1, dtype=torch.float64, requires_grad=True)
    loss = choice_loss(better, tensor([gap]))
    loss.sum().backward()
    assert torch.isfinite(loss).all()
    assert better.grad.item() == pytest.approx(-1.0 if gap > 0 else 0.0)


def test_losses_by_hand():
    corrected, planned, alternatives = tensor([[1.0, 2.0]]), tensor([[0.0, 3.0]]), tensor([[[0.0, 1.0], [2.0, 2.0]]])
    surprise = lambda gap: np.log1p(np.exp(-gap))  # noqa: E731 - one line of algebra
    of_alternatives = (surprise(1.0) + surprise(0.0)) / 2 + surprise(0.0)
    assert demonstration_loss(corrected, alternatives).item() == pytest.approx(of_alternatives)
    assert correction_loss(corrected, planned, alternatives).item() == pytest.approx(
        of_alternatives + surprise(1.0) + surprise(-1.0))
    assert preference_loss(corrected, planned).item() == pytest.approx(surprise(1.0) + surprise(-1.0))


def test_nothing_of_a_kind_costs_nothing():
    none = torch.zeros(3, 0)
    terms = LossTerms(demonstrations=demonstration_loss(none, torch.zeros(3, 0, 5)),
                      corrections=correction_loss(none, none, torch.zeros(3, 0, 5)),
                      preferences=preference_loss(none, none))
    assert terms.total.tolist() == [0.0, 0.0, 0.0]
