"""Laws of named features, alone and in the learned reward."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints
from itertools import pairwise

import numpy as np
import pytest
import torch

from unifeed_ros.core.errors import ConfigError, InputError, ShapeError
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.feedback.items import Demonstration
from unifeed_ros.core.reward import features as module
from unifeed_ros.core.reward.buffer import AlternativesConfig
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.ensemble import RewardEnsemble
from unifeed_ros.core.reward.features import evaluate, feature_name, make_feature
from unifeed_ros.core.reward.inputs import input_names, scene_inputs
from unifeed_ros.core.reward.networks import Networks
from unifeed_ros.core.reward.storage import load_model, save_model
from unifeed_ros.core.reward.terms import distance
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.types import Context, Trajectory

EVERY_KIND = ["distance(goal)", "distance_xy(laptop)", "near(cup, 0.9)", "near_xy(laptop, 0.7)",
              "near_box(cup, 0.2, 0.1, 0.05, 0.9)", "height(0.1)", "tilt", "tilt(0, 1, 1)"]


def states(count: int = 40) -> np.ndarray:
    rng = np.random.default_rng(5)
    axes = rng.normal(size=(count, 3))
    return np.hstack([rng.uniform(-1, 1, (count, 3)), axes / np.linalg.norm(axes, axis=1, keepdims=True)])


def numeric_gradient(function, points, step=1e-6):
    return np.stack([(function(points + step * row) - function(points - step * row)) / (2 * step)
                     for row in np.eye(6)], axis=-1)


def ensemble_with(context: Context, features=EVERY_KIND, members=3) -> RewardEnsemble:
    rng, names = np.random.default_rng(2), input_names([context], features)
    sizes = (len(names), 16, 8, 1)
    layers = list(pairwise(sizes))
    return RewardEnsemble(
        version=1, robot="panda", frame="panda_link0", inputs=names, layer_sizes=sizes,
        weights=tuple(rng.normal(scale=0.5, size=(members, i, o)) for i, o in layers),
        biases=tuple(rng.normal(scale=0.3, size=(members, o)) for _, o in layers),
        thetas=rng.normal(size=(members, len(features))))


@pytest.mark.parametrize("name", EVERY_KIND)
def test_gradients_are_those_of_the_values(context, name):
    feature, points = make_feature(name, context), states()
    values, gradients = feature(points)
    assert values.shape == (40,)
    assert (values >= 0.0).all()
    assert values.any()
    np.testing.assert_allclose(gradients, numeric_gradient(lambda x: feature(x)[0], points), atol=1e-6)


def test_arguments_mean_what_they_say(context):
    at_cup = np.array([[*context.objects["cup"], 0.0, 0.0, -1.0]])
    aside = at_cup + np.array([[0.3, 0.0, 0.4, 0.0, 0.0, 0.0]])
    for name, value in {"distance(cup)": 0.5, "distance_xy(cup)": 0.3, "near(cup, 0.6)": 0.1, "near_xy(cup, 0.6)": 0.3,
                        "near_box(cup, 0.1, 0.1, 0.4, 0.6)": 0.4, "height(0.1)": 0.5, "tilt": 0.0,
                        "tilt(1, 0, 0)": np.pi / 2}.items():
        assert make_feature(name, context)(aside)[0][0] == pytest.approx(value), name


def test_a_feature_has_one_name():
    assert feature_name(" near_xy( person,0.4 )") == "near_xy(person, 0.4)"
    assert feature_name("tilt") == feature_name("tilt()") == "tilt()"
    with pytest.raises(ConfigError, match="each once"):
        TrainingConfig(features=["tilt", "tilt()"])


@pytest.mark.parametrize(("name", "error", "match"), [
    ("warmth(goal)", ConfigError, "expected distance.*got warmth"), ("distance(sofa)", InputError, "expected sofa"),
    ("distance", ConfigError, "arguments"), ("height(low)", ConfigError, "low"),
    ("tilt(0, 0, 0)", ConfigError, "length"), ("distance(goal", ConfigError, "such as")])
def test_what_is_not_a_feature_here_is_refused(context, name, error, match):
    with pytest.raises(error, match=match):
        make_feature(name, context)


def from_left(context: Context, weight: str):
    """A feature of somebody else's: how far to the left, times a weight."""
    factor = float(weight)
    return lambda points: (factor * points[:, 1], factor * np.tile(np.eye(6)[1], (len(points), 1)))


def wrong_shape(context: Context):
    return lambda points: (points, points)


def test_other_packages_offer_features(context, monkeypatch):
    here = [EntryPoint(name, f"{__name__}:{name}", module.GROUP) for name in ("from_left", "wrong_shape")]
    monkeypatch.setattr(module, "entry_points", lambda group: EntryPoints(here).select(group=group))
    points = states()
    np.testing.assert_allclose(make_feature("from_left(2)", context)(points)[0], 2.0 * points[:, 1])
    with pytest.raises(ShapeError, match="feature"):
        evaluate([make_feature("wrong_shape", context)], points)


def test_a_reward_with_features_is_what_torch_trains(context):
    ensemble, points = ensemble_with(context), states()
    networks = Networks(ensemble.layer_sizes, 3, np.random.default_rng(0), features=len(EVERY_KIND))
    assert networks.load(ensemble, ensemble.inputs)
    inputs = scene_inputs(ensemble.inputs, context).values(points).astype(np.float32)
    with torch.no_grad():
        trained = networks.rewards(torch.from_numpy(inputs).expand(3, 1, *inputs.shape))[:, 0].numpy()
    reward = ensemble.bind(context)
    np.testing.assert_allclose(reward.member_rewards(points), trained, atol=1e-5)
    value, gradient = reward.value_and_gradient(points)
    np.testing.assert_allclose(value, trained.mean(axis=0), atol=1e-5)
    slopes = numeric_gradient(lambda x: reward.value_and_gradient(x)[0], points)
    close = np.isclose(gradient, slopes, atol=1e-5)
    assert close.mean() > 0.98  # where they differ, a kink of a leaky ReLU lies between


def test_inputs_of_motions_are_those_of_their_states(context):
    inputs, points = scene_inputs(input_names([context], EVERY_KIND), context), states(40)
    np.testing.assert_array_equal(inputs.values(points.reshape(4, 10, 6)).reshape(40, -1), inputs.values(points))
    assert inputs.values(np.zeros((0, 10, 6))).shape == (0, 10, len(input_names([context], EVERY_KIND)))


def test_features_weights_survive_the_row_and_the_file(context, tmp_path):
    ensemble = ensemble_with(context)
    back = load_model(save_model(tmp_path / "model.safetensors", ensemble))
    np.testing.assert_array_equal(back.thetas, ensemble.thetas)
    assert back.inputs == ensemble.inputs
    np.testing.assert_array_equal(back.member_rewards(states(), context), ensemble.member_rewards(states(), context))
    np.testing.assert_array_equal(ensemble.flat_weights()[-ensemble.thetas.size:], ensemble.thetas.ravel())
    with pytest.raises(ShapeError, match="weights of the reward model"):
        RewardEnsemble.from_flat(ensemble.flat_weights()[:-1], members=3, layer_sizes=ensemble.layer_sizes,
                                 inputs=ensemble.inputs, version=1, robot="panda", frame="panda_link0")


def test_a_model_of_features_that_the_scene_lacks_is_refused(context):
    with pytest.raises(InputError, match="laptop"):
        ensemble_with(context).bind(Context(goal=context.goal, objects={"cup": context.objects["cup"]}))


def test_one_demonstration_teaches_what_a_given_feature_explains(panda, context, straight):
    shown = Trajectory(joint_names=panda.joint_names, times=straight.times, positions=straight.positions)
    dataset = FeedbackDataset("panda", panda.joint_names)
    dataset.add(Demonstration(id="d1", robot="panda", context=context, trajectory=shown))
    no_shortcuts = AlternativesConfig(shortcut_share=0.0)  # a line in joint space bends for no reason
    config = TrainingConfig(members=2, hidden=(16, 16), steps=250, pool=200, features=["distance(goal)"],
                            residual_penalty=0.1, alternatives=no_shortcuts)
    ensemble = train_reward(dataset, panda, config, version=1, seed=0).ensemble
    elsewhere = Context(goal=[0.4, 0.4, 0.4], objects=context.objects)
    points = states(200)
    learned = ensemble.bind(elsewhere).value_and_gradient(points)[0]
    wanted = -distance(points, elsewhere.goal)[0]
    assert (ensemble.thetas < 0.0).all()
    assert np.corrcoef(learned, wanted)[0, 1] > 0.99
