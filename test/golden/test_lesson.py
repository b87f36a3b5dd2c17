"""A recorded lesson goes through capture, learning and planning again, and teaches the same."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rclpy", reason="ROS is not there: source a workspace, or run make setup")

from rclpy.serialization import deserialize_message
from trajectory_msgs.msg import JointTrajectory

from unifeed_msgs.msg import Feedback, Interaction, RewardModel, TeachingState
from unifeed_ros.core.capture.contact import ContactDetector
from unifeed_ros.core.capture.feedback_capture import CapturedDemonstration, FeedbackCapture
from unifeed_ros.core.feedback.dataset import FeedbackDataset
from unifeed_ros.core.planning.plan import PlannerConfig, plan_motion
from unifeed_ros.core.recording import check_bag, read_bag
from unifeed_ros.core.reward.config import TrainingConfig
from unifeed_ros.core.reward.training import train_reward
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.conversions import (
    feedback_from_msg,
    model_from_msg,
    seconds,
    trajectory_from_msg,
)
from unifeed_ros.nodes.joint_stream import JointReader
from unifeed_ros.resources import config_path
from unifeed_ros.simulation.tasks import TrueTask, measure

BAG = Path(__file__).resolve().parents[2] / "bags" / "panda_table_dcp"
SEEN_BY_CAPTURE = ("/joint_states", "/external_torques", "/teaching_state", "/trajectory")


@pytest.fixture(scope="module")
def robot():
    return RobotModel(load_robot(config_path("robots", "panda")))


@pytest.fixture(scope="module")
def scene():
    return load_scene(config_path("tasks", "table"))


def recorded(topic, kind):
    return [deserialize_message(m.data, kind) for m in read_bag(BAG, topics=[topic])]


def test_the_bag_keeps_to_every_rule_of_the_format():
    assert [str(finding) for finding in check_bag(BAG) if finding.problems] == []


def captured_again(robot):
    """Feed the recorded sensors to the capture code as the node does."""
    capture = FeedbackCapture(robot)
    detector = ContactDetector(robot.config.contact_thresholds, robot=robot)
    states, torques = JointReader(robot.joint_names), JointReader(robot.joint_names)
    velocities, positions, found = np.zeros(robot.n), np.zeros(robot.n), []
    for message in read_bag(BAG, topics=list(SEEN_BY_CAPTURE)):
        if message.topic == "/joint_states":
            state = states.state(message.data)
            velocities, positions = state.velocities, state.positions
            capture.observe_state(state)
        elif message.topic == "/external_torques":
            time, torque = torques.torques(message.data, "external torques")
            capture.observe_contact(detector.update(time, torque, velocities, positions))
        elif message.topic == "/trajectory":
            msg = deserialize_message(message.data, JointTrajectory)
            capture.observe_trajectory(msg.header.frame_id, trajectory_from_msg(msg, robot.joint_names))
        else:
            msg = deserialize_message(message.data, TeachingState)
            found += capture.observe_teaching(seconds(msg.header.stamp), msg.mode, msg.motion_id, msg.motion_time)
    return found


def test_capture_finds_in_the_sensors_what_it_found_then(robot):
    then = [feedback_from_msg(m, robot.joint_names) for m in recorded("/feedback", Feedback)]
    demonstration = next(item for item in then if item.kind == "demonstration")
    correction = next(item for item in then if item.kind == "correction")
    again = captured_again(robot)
    shown = [c.trajectory for c in again if isinstance(c, CapturedDemonstration) and c.trajectory is not None]
    assert len(shown) == 1
    assert shown[0].duration == pytest.approx(demonstration.trajectory.duration, abs=0.1)
    np.testing.assert_allclose(shown[0].resampled(20), demonstration.trajectory.resampled(20), atol=0.02)
    spans = [span for c in again if not isinstance(c, CapturedDemonstration) for span in c.corrections[c.known:]]
    assert len(spans) == 1
    np.testing.assert_allclose(spans[0].span, correction.span, atol=0.15)
    np.testing.assert_allclose(spans[0].corrected.resampled(10), correction.corrected.resampled(10), atol=0.05)


def test_what_was_recorded_is_learned_again_and_planned_well(robot, scene):
    dataset = FeedbackDataset("panda", robot.joint_names)
    for message in recorded("/feedback", Feedback):
        dataset.add(feedback_from_msg(message, robot.joint_names))
    assert dataset.counts == (1, 1, 1)
    first, second = (train_reward(dataset, robot, TrainingConfig(), version=3, seed=0).ensemble for _ in range(2))
    assert first.flat_weights().tobytes() == second.flat_weights().tobytes()
    yardstick = measure(robot, TrueTask(scene=scene))
    start, goal = (yardstick.optimum.positions[k] for k in (0, -1))
    plan = plan_motion(robot, first.bind(scene.context()), start, goal, duration=scene.duration, scene=scene,
                       config=PlannerConfig(time_budget=60.0))
    assert plan.success
    assert yardstick.normalised_regret(plan.trajectory) < 0.25


def test_recorded_models_rank_what_was_taught_as_the_person_did(robot, scene):
    models = [model_from_msg(m) for m in recorded("/reward_model", RewardModel)]
    assert [m.version for m in models] == [1, 2, 3]
    taught = [feedback_from_msg(m, robot.joint_names) for m in recorded("/feedback", Feedback)]
    preference = next(item for item in taught if item.kind == "preference")
    returns = [models[-1].member_rewards(robot.tool_states(o.resampled(20)), scene.context()).mean(axis=0).sum()
               for o in preference.options]
    for better, worse in preference.ranked_pairs:
        assert returns[better] > returns[worse]


def test_recorded_interactions_follow_their_plans(robot):
    for interaction in recorded("/interaction", Interaction):
        planned = trajectory_from_msg(interaction.planned, robot.joint_names)
        executed = trajectory_from_msg(interaction.executed, robot.joint_names)
        assert not interaction.touched
        assert executed.duration == pytest.approx(planned.duration, abs=0.1)
        np.testing.assert_allclose(executed.resampled(20), planned.resampled(20), atol=0.05)
