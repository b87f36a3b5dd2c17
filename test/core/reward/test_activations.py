"""Laws of the activations, alone and within an ensemble."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from unifeed_ros.core.errors import ConfigError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Demonstration
from unifeed_ros.core.reward.activations import ACTIVATIONS, SHARPNESS, leaky_relu, leaky_softplus
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.networks import activate, backpropagate
from unifeed_ros.core.reward.storage import load_model, save_model
from unifeed_ros.core.reward.training import train_reward

POINTS = np.concatenate([np.linspace(-3.0, 3.0, 61) + 0.01, [-1e4, 1e4]])  # none on the kink


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_the_slope_is_that_of_the_value(name):
    values, slopes = ACTIVATIONS[name](POINTS)
    sides = [ACTIVATIONS[name](POINTS + side)[0] for side in (1e-6, -1e-6)]
    np.testing.assert_allclose(slopes, (sides[0] - sides[1]) / 2e-6, atol=1e-5)
    assert np.isfinite(values).all()


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_training_and_evaluation_have_the_same_activations(name):
    values, slopes = ACTIVATIONS[name](POINTS)
    inputs = torch.from_numpy(POINTS)
    theirs = activate(name, inputs)
    np.testing.assert_allclose(theirs, values, atol=1e-8)
    np.testing.assert_allclose(backpropagate(name, torch.ones_like(inputs), inputs, theirs), slopes, atol=1e-8)


def test_the_smooth_one_stays_near_the_kinked_one():
    gaps = leaky_softplus(POINTS)[0] - leaky_relu(POINTS)[0]
    assert gaps.min() > -1e-9
    assert gaps.max() <= np.log(2.0) / SHARPNESS


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_an_ensembles_gradient_is_that_of_its_value(name, ensemble, context):
    reward = dataclasses.replace(ensemble, activation=name).bind(context)
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (12, 6))
    gradient, step = reward.value_and_gradient(points)[1], 1e-6 * np.eye(6)
    sides = [[reward.value_and_gradient(points + side * d)[0] for d in step] for side in (1.0, -1.0)]
    slopes = (np.array(sides[0]) - np.array(sides[1])) / 2e-6
    np.testing.assert_allclose(gradient, slopes.T, atol=1e-5)


@pytest.mark.parametrize("name", ACTIVATIONS)
def test_each_is_trained_with_and_kept(name, panda, straight, context, tmp_path):
    dataset = FeedbackDataset("panda", panda.joint_names)
    dataset.add(Demonstration(id="d", robot="panda", context=context, trajectory=straight))
    config = TrainingConfig(activation=name, steps=200, hidden=(24, 24), pool=200,
                            learning_rate=3e-3 if name == "tanh" else 1e-2)
    result = train_reward(dataset, panda, config, version=1, seed=0)
    assert result.loss_demonstrations < 0.6  # guessing: log 2
    kept = load_model(save_model(tmp_path / "model.safetensors", result.ensemble))
    assert kept.activation == name
    states = panda.tool_states(straight.resampled(9))
    assert np.array_equal(kept.member_rewards(states, context), result.ensemble.member_rewards(states, context))


def test_unknown_activations_are_refused(ensemble):
    with pytest.raises(ConfigError, match="activation"):
        TrainingConfig(activation="relu6")
    with pytest.raises(ConfigError, match="activation"):
        dataclasses.replace(ensemble, activation="")
