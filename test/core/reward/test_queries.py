"""Laws of the information gain (paper eq. M8) and of the motions to ask about."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from unifeed_ros.core.errors import InputError, ShapeError
from unifeed_ros.core.reward.queries import (
    information_gain,
    most_informative,
    random_query,
    select_query,
    vary_trajectory,
    with_variations,
)
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


SETTINGS = {"waypoints": 20, "rationality": 2.0}


def test_the_query_is_the_best_of_all_pairs(panda, context, straight, ensemble):
    candidates = [straight, *vary_trajectory(panda, straight, 0.15, 5, np.random.default_rng(1))]
    query = select_query(ensemble, candidates, panda, context, **SETTINGS)
    returns = np.stack([ensemble.member_rewards(panda.tool_states(c.resampled(20)), context).sum(axis=1)
                        for c in candidates], axis=1)
    gains = {(j, i): float(information_gain(2.0 * returns[:, [i, j]])) for i in range(6) for j in range(i)}
    assert query.indices == max(gains, key=gains.__getitem__)
    assert query.information == pytest.approx(max(gains.values()))


@pytest.mark.parametrize("count", [2, 20, 21, 22, 41, 60])
def test_no_pair_is_left_out(count):
    """The two candidates that two members are sure of opposite things about, wherever they stand."""
    for seed in range(20):
        rng = np.random.default_rng(seed)
        returns = np.tile(rng.normal(scale=0.1, size=count), (2, 1))
        i, j = sorted(rng.choice(count, 2, replace=False))
        returns[:, [i, j]] = [[40.0, -40.0], [-40.0, 40.0]]
        returns[:, [k for k in range(count) if k not in (i, j)]] *= 0.0
        query = most_informative(returns)
        assert query.indices == (i, j)
        assert query.information == pytest.approx(1.0)


@given(seed=st.integers(0, 50), options=st.integers(2, 4))
def test_the_order_of_members_and_candidates_does_not_matter(seed, options):
    rng = np.random.default_rng(seed)
    returns = rng.normal(scale=2.0, size=(3, 45))
    members, candidates = rng.permutation(3), rng.permutation(45)
    query, other = most_informative(returns, options), most_informative(returns[members][:, candidates], options)
    assert query.indices == tuple(sorted(candidates[list(other.indices)]))
    assert other.information == pytest.approx(query.information)


@given(seed=st.integers(0, 50), options=st.integers(2, 5), members=st.integers(2, 6))
def test_an_answer_tells_at_most_the_logarithm_of_the_options(seed, options, members):
    query = most_informative(np.random.default_rng(seed).normal(scale=30.0, size=(members, 30)), options)
    assert 0.0 < query.information <= np.log2(min(members, options)) + 1e-9


def test_no_question_tells_anything_where_members_agree():
    row = np.random.default_rng(0).normal(scale=5.0, size=30)
    assert most_informative(np.tile(row, (3, 1)), 3).information == pytest.approx(0.0, abs=1e-9)


def test_the_grown_set_is_nearly_the_best_of_all_sets():
    shares = []
    for seed in range(20):
        returns = np.random.default_rng(seed).normal(scale=2.0, size=(3, 12))
        best = max(float(information_gain(returns[:, list(s)])) for s in combinations(range(12), 3))
        shares.append(most_informative(returns, 3).information / best)
    assert max(shares) <= 1.0 + 1e-9
    assert min(shares) > 0.95


def test_a_passive_query_is_random_and_says_what_it_tells(panda, context, straight, ensemble):
    candidates = vary_trajectory(panda, straight, 0.15, 8, np.random.default_rng(1))
    rng = np.random.default_rng(5)
    queries = [random_query(ensemble, candidates, panda, context, **SETTINGS, rng=rng, options=3) for _ in range(30)]
    assert len({q.indices for q in queries}) > 15
    assert all(len(set(q.indices)) == 3 for q in queries)
    some = queries[0]
    returns = np.stack([ensemble.member_rewards(panda.tool_states(candidates[i].resampled(20)), context).sum(axis=1)
                        for i in some.indices], axis=1)
    assert some.information == pytest.approx(float(information_gain(2.0 * returns)))
    best = select_query(ensemble, candidates, panda, context, **SETTINGS)
    pairs = [random_query(ensemble, candidates, panda, context, **SETTINGS, rng=rng) for _ in range(10)]
    assert all(pair.information <= best.information + 1e-12 for pair in pairs)


def test_candidates_are_the_given_motions_and_as_many_variations_as_asked_for(panda, straight):
    for given_count, total, expected in ((1, 4, 4), (2, 7, 7), (3, 2, 3)):
        motions = with_variations(panda, [straight] * given_count, 0.1, total, np.random.default_rng(0))
        assert len(motions) == expected
        assert all(m is straight for m in motions[:given_count])
        assert len({m.positions.tobytes() for m in motions[given_count:]}) == expected - given_count


def test_queries_refuse_what_cannot_be_compared(panda, context, straight, ensemble):
    with pytest.raises(InputError, match="at least 2"):
        select_query(ensemble, [straight], panda, context, **SETTINGS)
    with pytest.raises(InputError, match="at least 3"):
        random_query(ensemble, [straight, straight], panda, context, **SETTINGS, rng=np.random.default_rng(0),
                     options=3)
    with pytest.raises(InputError, match="at least two"):
        select_query(ensemble, [straight, straight], panda, context, **SETTINGS, options=1)
    other = Trajectory(joint_names=tuple("abcdefg"), times=straight.times, positions=straight.positions)
    with pytest.raises(InputError, match="joints"):
        select_query(ensemble, [straight, other], panda, context, **SETTINGS)
