"""Laws of the information gain (paper eq. M8) and of the motions to ask about."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unifeed_ros.core.errors import InputError, ShapeError
from unifeed_ros.core.reward.queries import information_gain, select_query, vary_trajectory
from unifeed_ros.core.types import Trajectory

pairs = st.integers(1, 5).flatmap(lambda m: arrays(float, (m, 2), elements=st.floats(-60, 60)))


@given(returns=pairs)
def test_an_answer_to_a_pair_tells_at_most_a_bit(returns):
    assert 0.0 <= information_gain(returns) <= 1.0 + 1e-9


@given(returns=pairs, seed=st.integers(0, 9))
def test_neither_order_nor_constants_matter(returns, seed):
    rng = np.random.default_rng(seed)
    moved = rng.permutation(returns, axis=0)[:, ::-1] + rng.normal(size=(len(returns), 1))
    assert information_gain(moved) == pytest.approx(information_gain(returns), abs=1e-9)


@given(row=arrays(float, 2, elements=st.floats(-60, 60)), members=st.integers(1, 5))
def test_members_that_agree_learn_nothing(row, members):
    assert information_gain(np.tile(row, (members, 1))) == pytest.approx(0.0, abs=1e-9)


def test_members_that_are_sure_of_opposites_learn_a_bit():
    assert information_gain([[50.0, -50.0], [-50.0, 50.0]]) == pytest.approx(1.0)


def test_information_gain_by_the_papers_formula():
    returns = np.random.default_rng(0).normal(size=(3, 2))
    chance = np.exp(returns) / np.exp(returns).sum(axis=1, keepdims=True)
    terms = [chance[k, i] * np.log2(3 * chance[k, i] / chance[:, i].sum()) for k in range(3) for i in range(2)]
    assert information_gain(returns) == pytest.approx(sum(terms) / 3)


def test_bad_returns_are_refused():
    with pytest.raises(ShapeError, match="options"):
        information_gain([[1.0], [2.0]])
    with pytest.raises(InputError, match="not finite"):
        information_gain([[1.0, np.nan]])


def test_variations_keep_ends_and_limits(panda, straight):
    variations = vary_trajectory(panda, straight, 0.1, 6, np.random.default_rng(0))
    assert len(variations) == 6
    for variation in variations:
        np.testing.assert_allclose(variation.positions[[0, -1]], straight.positions[[0, -1]], atol=1e-12)
        assert (variation.positions >= panda.lower).all()
        assert (variation.positions <= panda.upper).all()
        assert (np.abs(variation.velocities) <= panda.velocity_limits).all()
        shift = panda.tool_states(variation.positions)[:, :3] - panda.tool_states(straight.positions)[:, :3]
        assert 0.01 < np.linalg.norm(shift, axis=1).max() < 0.6


def test_same_seed_same_variations(panda, straight):
    one, two = (vary_trajectory(panda, straight, 0.1, 2, np.random.default_rng(3)) for _ in range(2))
    assert all(a.positions.tobytes() == b.positions.tobytes() for a, b in zip(one, two, strict=True))


def test_a_motion_on_its_limits_is_given_back(panda, straight):
    rushed = Trajectory(joint_names=straight.joint_names, times=straight.times / 10, positions=straight.positions)
    np.testing.assert_array_equal(
        vary_trajectory(panda, rushed, 0.1, 1, np.random.default_rng(0))[0].positions, rushed.positions)


def test_the_query_is_the_best_of_all_pairs(panda, context, straight, ensemble):
    candidates = [straight, *vary_trajectory(panda, straight, 0.15, 5, np.random.default_rng(1))]
    query = select_query(ensemble, candidates, panda, context, 20, rationality=2.0)
    returns = np.stack([ensemble.member_rewards(panda.tool_states(c.resampled(20)), context).sum(axis=1)
                        for c in candidates], axis=1)
    gains = {(i, j): float(information_gain(2.0 * returns[:, [i, j]])) for j in range(6) for i in range(j)}
    assert query.indices == max(gains, key=gains.__getitem__)
    assert query.information == pytest.approx(max(gains.values()))


def test_queries_refuse_what_cannot_be_compared(panda, context, straight, ensemble):
    with pytest.raises(InputError, match="at least two"):
        select_query(ensemble, [straight], panda, context, 20)
    other = Trajectory(joint_names=tuple("abcdefg"), times=straight.times, positions=straight.positions)
    with pytest.raises(InputError, match="joints"):
        select_query(ensemble, [straight, other], panda, context, 20)
