"""DemPref: draws from the right density, questions of the right worth, weights that come out true."""

from __future__ import annotations

import numpy as np
import pytest

from unifeed_ros.baselines.dempref import DemPref, DemPrefConfig, MotionFeatures, adaptive_metropolis, removed_volume
from unifeed_ros.core.errors import ConfigError, InputError
from unifeed_ros.core.feedback.items import Correction, Demonstration, Preference
from unifeed_ros.core.reward.queries import vary_trajectory
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.resources import config_path

CONTEXT = Context(goal=(0.55, 0.3, 0.1), objects={"ball": (0.45, -0.35, 0.25)})
NAMES = ("distance(goal)", "height(0.0)", "distance(ball)")


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def motions(robot):
    ends = robot.inverse_kinematics((0.45, 0.0, 0.45)), robot.inverse_kinematics((0.5, 0.25, 0.3))
    share = np.linspace(0.0, 1.0, 21)[:, None]
    line = Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, 3.0, 21),
                      positions=ends[0] + share * (ends[1] - ends[0]))
    return vary_trajectory(robot, line, 0.15, 160, np.random.default_rng(0))


@pytest.fixture(scope="module")
def features(robot, motions):
    raw = MotionFeatures(names=NAMES, context=CONTEXT, waypoints=10, centre=np.zeros(3), spread=np.ones(3))
    values = raw.of(robot, motions)
    return MotionFeatures(names=NAMES, context=CONTEXT, waypoints=10, centre=values.mean(axis=0),
                          spread=values.std(axis=0))


def answer(robot, pair, better, name):
    return Preference(id=name, robot="panda", context=CONTEXT, options=pair, ranks=(0, 1) if better == 0 else (1, 0))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_draws_of_a_level_density_fill_the_ball(dimensions):
    level = lambda w: np.where((w**2).sum(axis=1) <= 1.0, 0.0, -np.inf)  # noqa: E731
    drawn = adaptive_metropolis(level, dimensions, DemPrefConfig(chains=50, steps=2000), np.random.default_rng(0))
    assert (np.linalg.norm(drawn, axis=1) <= 1.0).all()
    assert np.abs(drawn.mean(axis=0)).max() < 0.03
    assert (drawn**2).sum(axis=1).mean() == pytest.approx(dimensions / (dimensions + 2.0), abs=0.02)


def test_draws_agree_with_a_grid(robot, features, motions):
    config = DemPrefConfig(demonstration_rationality=0.7, chains=50, steps=3000)
    learner = DemPref(robot, features.without("height(0.0)"), config, np.random.default_rng(1))
    learner.learn(Demonstration(id="d", robot="panda", context=CONTEXT, trajectory=motions[0]))
    for k in range(1, 7):
        learner.learn(answer(robot, (motions[2 * k], motions[2 * k + 1]), k % 2, f"p{k}"))
    phi = features.without("height(0.0)").of(robot, motions)
    axis = np.linspace(-1.0, 1.0, 401)
    grid = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
    grid = grid[(grid**2).sum(axis=1) <= 1.0]
    density = np.exp(0.7 * grid @ phi[0])
    for k in range(1, 7):
        better, worse = (phi[2 * k], phi[2 * k + 1]) if k % 2 == 0 else (phi[2 * k + 1], phi[2 * k])
        density /= 1.0 + np.exp(-5.0 * grid @ (better - worse))
    density /= density.sum()
    mean = density @ grid
    np.testing.assert_allclose(learner.samples.mean(axis=0), mean, atol=0.02)
    np.testing.assert_allclose(learner.samples.std(axis=0), np.sqrt(density @ (grid - mean) ** 2), atol=0.02)


def test_noiseless_answers_to_its_questions_bring_the_weights_out(robot, features, motions):
    """Its paper's measure: within 25 questions the direction of the mean weights comes near the true one."""
    true = np.array([-0.6, 0.3, 0.742])
    phi = features.of(robot, motions)
    questions = phi.reshape(-1, 2, 3)
    learner = DemPref(robot, features, DemPrefConfig(answer_rationality=20.0), np.random.default_rng(2))
    for k in range(25):
        asked = learner.select(questions)
        pair = (motions[2 * asked], motions[2 * asked + 1])
        learner.learn(answer(robot, pair, int(np.argmax(questions[asked] @ true)), f"p{k}"))
    mean = learner.samples.mean(axis=0)
    assert mean @ true / (np.linalg.norm(mean) * np.linalg.norm(true)) > 0.97


def test_volume_by_hand():
    """Two samples and two options: P(1 | w) is 0.9 and 0.2, so answer 1 removes 0.45 of the volume, answer 2 0.55."""
    returns = np.log([[0.9, 0.1], [0.2, 0.8]])
    assert removed_volume(returns) == pytest.approx(0.45)
    sure = np.log([[0.99, 0.01], [0.99, 0.01]])
    asked = np.stack([sure, returns])
    assert np.argmax(removed_volume(asked)) == 1
    assert (removed_volume(asked) > 0.0).all()  # the authors' code has nought for every question


@pytest.mark.parametrize("objective", ["information", "volume"])
def test_a_question_about_what_is_unknown_is_chosen(robot, features, motions, objective):
    """Known: the first weight is large. A question about it alone tells nothing, one about the others does."""
    learner = DemPref(robot, features, DemPrefConfig(objective=objective), np.random.default_rng(3))
    learner.samples = np.array([[0.7, 0.7, 0.0], [0.7, -0.7, 0.0]])
    questions = np.array([[[3.0, 0.0, 0.0], [0.0, 0.0, 0.0]], [[0.0, 3.0, 0.0], [0.0, 0.0, 0.0]]])
    assert learner.select(questions) == 1


def test_reward_is_the_features_up_to_a_constant(robot, features, motions):
    """Plans maximise a motion's w . Phi: sums of the states' rewards differ between motions as w . Phi does."""
    weights = np.array([0.5, -0.2, 0.8])
    states = robot.tool_states(np.concatenate([m.resampled(10) for m in motions]))
    sums = features.reward(weights).value_and_gradient(states)[0].reshape(-1, 10).mean(axis=1)
    phi = features.of(robot, motions) @ weights
    np.testing.assert_allclose(sums - sums[0], phi - phi[0], atol=1e-9)


def test_reward_has_exact_gradients(robot, features, motions):
    states = robot.tool_states(motions[3].resampled(7))
    reward = features.reward([0.5, -0.2, 0.8])
    values = [[reward.value_and_gradient(states + sign * 1e-6 * e)[0] for sign in (1, -1)] for e in np.eye(6)]
    numeric = np.stack([(after - before) / 2e-6 for after, before in values], axis=-1)
    np.testing.assert_allclose(reward.value_and_gradient(states)[1], numeric, atol=1e-6)


def test_same_seed_same_draws(robot, features):
    first, second = (DemPref(robot, features, DemPrefConfig(), np.random.default_rng(4)).samples for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_what_it_has_no_model_of_is_refused(robot, features, motions):
    learner = DemPref(robot, features, DemPrefConfig(), np.random.default_rng(5))
    correction = Correction(id="c", robot="panda", context=CONTEXT, planned=motions[0], corrected=motions[1],
                            span=(0.0, 3.0))
    with pytest.raises(InputError, match="correction"):
        learner.learn(correction)
    for wrong in ({"objective": "luck"}, {"chains": 1}, {"answer_rationality": -1.0}):
        with pytest.raises(ConfigError):
            DemPrefConfig(**wrong)
