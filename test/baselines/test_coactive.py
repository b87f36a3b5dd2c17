"""Coactive on cases that can be worked out by hand."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from unifeed_ros.baselines.coactive import Coactive, CoactiveConfig, deform, updated
from unifeed_ros.core.errors import ConfigError, ShapeError
from unifeed_ros.core.feedback.items import Demonstration, Preference

from .slider import CONTEXT, FEATURES, Slider, correction, motion


def coactive(**settings):
    return Coactive(Slider(), FEATURES, CoactiveConfig(**settings))


def test_a_push_deforms_as_the_method_of_its_source():
    # A^T A for five points is [6 -4 1 0 0; -4 6 -4 1 0; 1 -4 6 -4 1; ...]; solved by hand for a unit push on the first
    r = np.array([[6, -4, 1, 0, 0], [-4, 6, -4, 1, 0], [1, -4, 6, -4, 1], [0, 1, -4, 6, -4], [0, 0, 1, -4, 6]])
    shape = np.linalg.solve(r, [1, 0, 0, 0, 0])
    expected = np.zeros((10, 2))
    expected[3:8] = (np.sqrt(5) / np.linalg.norm(shape) * shape)[:, None] * [0.1, -0.2]
    np.testing.assert_allclose(deform(np.zeros((10, 2)), 3, np.array([0.1, -0.2]), 5), expected, atol=1e-12)


@given(index=st.integers(0, 9), size=st.floats(0.01, 1.0))
def test_a_push_displaces_by_its_size(index, size):
    bent = deform(np.zeros((10, 1)), index, np.array([size]), 5)
    moved = bent[index:index + 5]
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(size)
    assert not bent[:index].any() and not bent[index + 5:].any()
    assert (moved > 0).all()


def test_pushing_down_makes_height_dear_by_the_hand_computed_amount():
    learner = coactive(gain=0.5, cap=10.0)
    learner.learn(correction([[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]], [[0.2, 0.0, 0.3], [0.4, 0.0, 0.3]]))
    # height falls by 0.1 m for 2 s: Phi changes by -0.2 m s, the weight by 0.5 * 0.2
    np.testing.assert_allclose(learner.weights, [0.1, 0.0], atol=1e-12)
    rewards, gradients = learner.reward(CONTEXT).value_and_gradient(np.array([[0.5, 0.0, 0.4, 0.0, 0.0, -1.0]]))
    np.testing.assert_allclose(rewards, [-0.04], atol=1e-12)
    np.testing.assert_allclose(gradients, [[0.0, 0.0, -0.1, 0.0, 0.0, 0.0]], atol=1e-12)


def test_pushing_up_makes_it_no_cheaper_than_free_and_pushing_on_no_dearer_than_the_cap():
    low, high = [[0.2, 0.0, 0.3], [0.4, 0.0, 0.3]], [[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]]
    learner = coactive(gain=3.0)
    learner.learn(correction(low, high))
    assert learner.weights[0] == 0.0
    for _ in range(3):
        learner.learn(correction(high, low))
    assert learner.weights[0] == 1.0


def test_max_moves_the_most_changed_feature_alone():
    before, after = [[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]], [[0.25, 0.0, 0.3], [0.45, 0.0, 0.3]]
    every, most = coactive(gain=1.0, cap=9.0), coactive(gain=1.0, cap=9.0, update="max")
    for learner in (every, most):
        learner.learn(correction(before, after))
    np.testing.assert_allclose(every.weights, [0.2, 0.1], atol=1e-12)
    np.testing.assert_allclose(most.weights, [0.2, 0.0], atol=1e-12)


def test_a_demonstration_is_compared_with_the_straight_line_between_its_ends():
    learner = coactive(gain=1.0, cap=9.0, waypoints=3)
    learner.learn(Demonstration(id="d", robot="slider", context=CONTEXT, trajectory=motion(
        [[0.2, 0.0, 0.4], [0.4, 0.0, 0.1], [0.6, 0.0, 0.2]])))
    # the line's middle is at 0.3 m: 0.2 m higher in one of three states, for 2 s in all
    np.testing.assert_allclose(learner.weights, [0.2 * 2.0 / 3.0, 0.0], atol=1e-12)


def test_a_ranking_teaches_each_of_its_pairs():
    options = tuple(motion([[0.2, 0.0, z], [0.4, 0.0, z]]) for z in (0.3, 0.2, 0.1))
    learner = coactive(gain=1.0, cap=9.0)
    learner.learn(Preference(id="p", robot="slider", context=CONTEXT, options=options, ranks=(2, 1, 0)))
    np.testing.assert_allclose(learner.weights, [2.0 * (0.1 + 0.1 + 0.2), 0.0], atol=1e-12)
    learner.learn(Preference(id="q", robot="slider", context=CONTEXT, options=options, ranks=()))
    np.testing.assert_allclose(learner.weights, [0.8, 0.0], atol=1e-12)


def test_a_push_alone_teaches_less_than_the_whole_motion_but_in_the_same_direction():
    high = np.linspace([0.2, 0.0, 0.4], [0.4, 0.0, 0.4], 20)
    low = high - np.outer(np.hanning(20), [0.0, 0.0, 0.2])
    motion_read, push_read = coactive(gain=1.0, cap=9.0), coactive(gain=1.0, cap=9.0, reading="push")
    for learner in (motion_read, push_read):
        learner.learn(correction(high, low))
    assert 0.0 < push_read.weights[0] < motion_read.weights[0]


def test_without_features_nothing_is_learned_and_nothing_fails():
    learner = Coactive(Slider(), (), CoactiveConfig())
    learner.learn(correction([[0.2, 0.0, 0.4], [0.4, 0.0, 0.4]], [[0.2, 0.0, 0.3], [0.4, 0.0, 0.3]]))
    assert learner.weights.shape == (0,)
    rewards, gradients = learner.reward(CONTEXT).value_and_gradient(np.zeros((2, 6)))
    assert not rewards.any() and gradients.shape == (2, 6) and not gradients.any()


@given(change=st.lists(st.floats(-2.0, 2.0), min_size=1, max_size=4), update=st.sampled_from(["all", "max"]))
def test_weights_stay_between_zero_and_the_cap_and_never_move_with_the_change(change, update):
    change = np.array(change)
    weights = np.full(len(change), 0.5)
    after = updated(weights, change, CoactiveConfig(update=update))
    assert (after >= 0.0).all() and (after <= 1.0).all()
    assert ((after - weights) * change <= 0.0).all()


def test_bad_settings_and_pushes_are_refused():
    for settings in ({"gain": 0.0}, {"cap": float("inf")}, {"update": "some"}, {"reading": "mind"}, {"pushed": 0}):
        with pytest.raises(ConfigError):
            CoactiveConfig(**settings)
    with pytest.raises(ShapeError):
        deform(np.zeros((5, 3)), 5, np.zeros(3), 5)
    with pytest.raises(ShapeError):
        deform(np.zeros((5, 3)), 0, np.zeros(2), 5)
