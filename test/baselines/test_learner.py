"""The shape that all compared methods share: linear rewards and ours."""

from __future__ import annotations

import numpy as np
import pytest

from unifeed_ros.baselines.learner import LinearReward
from unifeed_ros.baselines.ours import Ours
from unifeed_ros.core.errors import ShapeError, TrainingError
from unifeed_ros.core.feedback.items import Demonstration, Preference
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.learning import learn_reward
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Context, Trajectory
from unifeed_ros.resources import config_path

CONTEXT = Context(goal=(0.5, 0.2, 0.1))
QUICK = TrainingConfig(waypoints=8, hidden=(12, 12), members=3, steps=30, warm_steps=15, pool=50)


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def motions(robot):
    first = robot.inverse_kinematics((0.45, 0.0, 0.45))
    share = np.linspace(0.0, 1.0, 11)[:, None]
    ends = [robot.inverse_kinematics(place, seed=first) for place in ((0.5, 0.2, 0.2), (0.4, -0.2, 0.4))]
    return [Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, 2.0, 11),
                       positions=first + share * (end - first)) for end in ends]


def taught(motions):
    common = {"robot": "panda", "context": CONTEXT}
    return (Demonstration(id="d", trajectory=motions[0], **common),
            Preference(id="p", options=tuple(motions), ranks=(0, 1), **common),
            Preference(id="tie", options=tuple(motions), ranks=(0, 0), **common))


def test_a_linear_reward_is_its_features_sum(robot, motions):
    states = robot.tool_states(motions[0].positions)
    reward = LinearReward(features=("distance(goal)", "height(0.0)"), weights=(-2.0, 0.5), context=CONTEXT)
    wanted = -2.0 * np.linalg.norm(states[:, :3] - CONTEXT.goal, axis=1) + 0.5 * np.abs(states[:, 2])
    np.testing.assert_allclose(reward.value_and_gradient(states)[0], wanted)
    with pytest.raises(ShapeError):
        reward.value_and_gradient(states[:, :3])
    with pytest.raises(ShapeError):
        LinearReward(features=("height(0.0)",), weights=(1.0, 2.0), context=CONTEXT)


def test_ours_learns_as_a_session_does(robot, motions):
    ours = Ours(robot, QUICK, seed=4)
    with pytest.raises(TrainingError):
        ours.reward(CONTEXT)
    demonstration, preference, tie = taught(motions)
    ours.learn(demonstration)
    ours.learn(preference)
    wanted = learn_reward(ours.dataset, robot, QUICK, version=1, seed=4).ensemble
    np.testing.assert_array_equal(ours.ensemble.flat_weights(), wanted.flat_weights())
    ours.learn(tie)
    np.testing.assert_array_equal(ours.ensemble.flat_weights(), wanted.flat_weights())
    assert [item.id for item in ours.dataset.items] == ["d", "p", "tie"]


def test_caution_takes_disagreement_off(robot, motions):
    states = robot.tool_states(motions[1].positions)
    plain, careful = Ours(robot, QUICK, seed=4), Ours(robot, QUICK, seed=4, kappa=2.0)
    for learner in (plain, careful):
        learner.learn(taught(motions)[0])
    values = [one.reward(CONTEXT).value_and_gradient(states)[0] for one in (plain, careful)]
    assert (values[0] > values[1]).all()
