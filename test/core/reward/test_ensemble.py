"""Laws of the reward ensemble: gradients, bounds, order of members, round trips."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.reward.inputs import input_names, scene_inputs
from unifeed_ros.core.types import Context


def states(seed: int, count: int = 12) -> np.ndarray:
    rng = np.random.default_rng(seed)
    axes = rng.normal(size=(count, 3))
    return np.hstack([rng.uniform(-1, 1, (count, 3)), axes / np.linalg.norm(axes, axis=1, keepdims=True)])


def restored(ensemble, **changes):
    fields = {name: getattr(ensemble, name)
              for name in ("members", "layer_sizes", "inputs", "version", "robot", "frame", "feedback_ids", "seed")}
    return type(ensemble).from_flat(changes.pop("flat", ensemble.flat_weights()), **(fields | changes))


def test_inputs_are_tool_goal_and_shared_objects(context):
    names = input_names([context, Context(goal=[0, 0, 0], objects={"laptop": [1, 1, 1], "vase": [0, 1, 0]})])
    assert names == ("z", "axis_x", "axis_y", "axis_z", "goal_dx", "goal_dy", "goal_dz", "x/10", "y/10",
                     "laptop_dx/10", "laptop_dy/10", "laptop_dz/10")


def test_offsets_point_from_the_tool_to_the_thing(context):
    state = states(0, 1)
    inputs = scene_inputs(input_names([context]), context).values(state)[0]
    np.testing.assert_allclose(inputs[:4], state[0, 2:])
    np.testing.assert_allclose(inputs[4:7], context.goal - state[0, :3])
    np.testing.assert_allclose(inputs[7:9], 0.1 * state[0, :2])
    np.testing.assert_allclose(inputs[9:12], 0.1 * (context.objects["cup"] - state[0, :3]))
    np.testing.assert_allclose(inputs[12:15], 0.1 * (context.objects["laptop"] - state[0, :3]))
    whole = scene_inputs(["x", "cup_dz"], context).values(state)[0]
    np.testing.assert_allclose(whole, [state[0, 0], context.objects["cup"][2] - state[0, 2]])


@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_disagreement_is_taken_off_with_its_exact_gradient(ensemble_of, context, seed):
    ensemble, points = ensemble_of(seed), states(seed)
    mean, gradient = ensemble.bind(context).value_and_gradient(points)
    careful = ensemble.bind(context, 2.0, among=points)
    value, slope = careful.value_and_gradient(points)
    np.testing.assert_allclose(value, mean - 2.0 * ensemble.disagreement(points, context), atol=3e-4)
    shift, step = 1e-6 * np.random.default_rng(seed).normal(size=6), 1.0
    sides = [careful.value_and_gradient(points + sign * step * shift)[0] for sign in (1, -1)]
    kinked = np.abs(sides[0] - 2 * value + sides[1]) > 1e-10
    np.testing.assert_allclose((slope @ shift)[~kinked], (sides[0] - sides[1])[~kinked] / 2, atol=1e-10)
    assert kinked.mean() < 0.5 and np.abs(slope - gradient).max() > 1e-3
    same = ensemble.bind(context, 0.0, among=points).value_and_gradient(points)
    np.testing.assert_array_equal(same[0], mean)


@settings(max_examples=20)
@given(seed=st.integers(0, 999))
def test_gradient_is_that_of_the_value(ensemble_of, context, seed):
    reward = ensemble_of(seed).bind(context)
    points = states(seed)
    value, gradient = reward.value_and_gradient(points)
    np.testing.assert_allclose(value, reward.member_rewards(points).mean(axis=0))
    step = 1e-6
    for column in range(6):
        shift = step * np.eye(6)[column]
        sides = [reward.value_and_gradient(points + side * shift)[0] for side in (1, -1)]
        kinked = np.abs(sides[0] - 2 * value + sides[1]) > 1e-9  # a kink of the leaky ReLU lies between
        slope = (sides[0] - sides[1]) / (2 * step)
        np.testing.assert_allclose(gradient[~kinked, column], slope[~kinked], atol=1e-6)
        assert kinked.mean() < 0.5


def test_binding_a_scene_equals_evaluating_the_inputs(ensemble, context):
    inputs = scene_inputs(ensemble.inputs, context).values(states(1))
    hidden = np.broadcast_to(inputs, (3, 12, len(ensemble.inputs)))
    for layer, (weight, bias) in enumerate(zip(ensemble.weights, ensemble.biases, strict=True)):
        hidden = hidden @ weight.astype(float) + bias.astype(float)[:, None]
        hidden = np.tanh(hidden) if layer == 2 else np.maximum(hidden, 0.01 * hidden)
    np.testing.assert_allclose(ensemble.member_rewards(states(1), context), hidden[..., 0], atol=1e-12)


def test_rewards_are_bounded(ensemble, context):
    assert np.abs(ensemble.member_rewards(1e3 * states(2), context)).max() <= 1.0


def test_the_order_of_members_does_not_matter(ensemble, context):
    order = [2, 0, 1]
    shuffled = dataclasses.replace(ensemble, weights=tuple(w[order] for w in ensemble.weights),
                                   biases=tuple(b[order] for b in ensemble.biases))
    for mine, theirs in zip(shuffled.bind(context).value_and_gradient(states(3)),
                            ensemble.bind(context).value_and_gradient(states(3)), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-12)
    np.testing.assert_allclose(shuffled.disagreement(states(3), context), ensemble.disagreement(states(3), context))


def test_members_that_are_alike_do_not_disagree(ensemble, context):
    alike = dataclasses.replace(ensemble, weights=tuple(w[[0, 0, 0]] for w in ensemble.weights),
                                biases=tuple(b[[0, 0, 0]] for b in ensemble.biases))
    np.testing.assert_allclose(alike.disagreement(states(4), context), 0.0, atol=1e-12)
    assert ensemble.disagreement(states(4), context).max() > 0.01


def test_flat_weights_round_trip(ensemble):
    again = restored(ensemble)
    for mine, theirs in zip(again.weights + again.biases, ensemble.weights + ensemble.biases, strict=True):
        np.testing.assert_array_equal(mine, theirs)
    assert again.flat_weights().tobytes() == ensemble.flat_weights().tobytes()
    assert (again.inputs, again.feedback_ids) == (ensemble.inputs, ensemble.feedback_ids)


def test_flat_weights_are_in_the_messages_order(ensemble):
    flat, (inputs, width) = ensemble.flat_weights(), ensemble.layer_sizes[:2]
    np.testing.assert_array_equal(flat[:width], ensemble.weights[0][0, 0])
    np.testing.assert_array_equal(flat[inputs * width:(inputs + 1) * width], ensemble.biases[0][0])
    np.testing.assert_array_equal(flat[(inputs + 1) * width:(inputs + 2) * width], ensemble.weights[0][1, 0])


def test_bad_models_are_refused(ensemble, context):
    flat = ensemble.flat_weights()
    with pytest.raises(ShapeError, match="weights of the reward model"):
        restored(ensemble, flat=flat[:-1])
    with pytest.raises(InputError, match="not finite"):
        restored(ensemble, flat=np.where(np.arange(flat.size) == 7, np.nan, flat))
    with pytest.raises(ConfigError, match="activation"):
        restored(ensemble, activation="relu")
    with pytest.raises(ConfigError, match="layer sizes"):
        restored(ensemble, inputs=ensemble.inputs[:-1])
    with pytest.raises(InputError, match="cup"):
        ensemble.bind(Context(goal=context.goal, objects={"laptop": context.objects["laptop"]}))
    with pytest.raises(ShapeError, match="tool states"):
        ensemble.member_rewards(np.zeros((4, 7)), context)
