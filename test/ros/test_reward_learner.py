"""The learner's node alone: it learns and chooses questions, and answers meanwhile."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import session_files

from unifeed_msgs.msg import Feedback, RewardModel, RewardStatus, TrackedRun
from unifeed_msgs.srv import ListFeedback, RankMotions, SelectQuery, TrainReward, UndoFeedback
from unifeed_ros.core.feedback.items import Demonstration
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.scene import load_scene
from unifeed_ros.nodes.conversions import feedback_to_msg
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.simulation.tasks import straight_line


def demonstration(files):
    robot, scene = RobotModel(load_robot(files[0])), load_scene(files[1])
    item = Demonstration(id="demo-1", robot=robot.config.name, context=scene.context(),
                         trajectory=straight_line(robot, scene, 60))
    return feedback_to_msg(item, 1.0, robot.config.base_frame)


@pytest.fixture
def taught_learner(start_node, ros_node, spin_until):
    """Start the node and demonstrate one motion: taught_learner(**parameters) gives its process."""

    def start(**parameters):
        process = start_node("reward_learner", {name.replace("__", "."): value for name, value in parameters.items()},
                             parameter_files=session_files())
        statuses = []
        ros_node.create_subscription(RewardStatus, "reward_status", statuses.append, subscriber_qos("reward_status"))
        feedback = ros_node.create_publisher(Feedback, "feedback", publisher_qos("feedback"))
        spin_until(lambda: feedback.get_subscription_count() > 0, 60.0)
        feedback.publish(demonstration(session_files()))
        spin_until(lambda: statuses and statuses[-1].demonstrations == 1, 30.0)
        return process

    return start


def test_the_newest_training_wins(taught_learner, ros_node, spin_until):
    taught_learner(training__steps=20000)  # a minute
    client = ros_node.create_client(TrainReward, "train_reward")
    spin_until(client.service_is_ready, 30.0)
    older = [client.call_async(TrainReward.Request()) for _ in range(2)]
    end = time.monotonic() + 2.0
    spin_until(lambda: time.monotonic() > end)
    assert not older[-1].done()  # the one that is under way; the other ends as soon as the worker has started
    newest = client.call_async(TrainReward.Request())
    spin_until(lambda: all(future.done() for future in older), 30.0)
    for future in older:
        assert not future.result().success and "a newer request took its place" in future.result().message
    assert not newest.done()


def test_a_model_comes_once_of_many_requests(taught_learner, ros_node, spin_until):
    taught_learner(training__steps=50)
    client = ros_node.create_client(TrainReward, "train_reward")
    spin_until(client.service_is_ready, 30.0)
    answers = [client.call_async(TrainReward.Request()) for _ in range(6)]
    spin_until(lambda: all(future.done() for future in answers), 60.0)
    versions = [future.result().version for future in answers if future.result().success]
    assert answers[-1].result().success and versions == sorted(set(versions))


def test_a_learner_that_was_killed_goes_on_with_what_it_was_taught(start_node, ros_node, spin_until, call, tmp_path):
    def start():
        return start_node("reward_learner", {"learner.folder": tmp_path / "taught", "training.steps": 50},
                          parameter_files=session_files())

    models, statuses = [], []
    ros_node.create_subscription(RewardModel, "reward_model", models.append, subscriber_qos("reward_model"))
    ros_node.create_subscription(RewardStatus, "reward_status", statuses.append, subscriber_qos("reward_status"))
    feedback = ros_node.create_publisher(Feedback, "feedback", publisher_qos("feedback"))
    first = start()
    spin_until(lambda: feedback.get_subscription_count() > 0, 60.0)
    for name in ("demonstration-1", "demonstration-2"):
        shown = demonstration(session_files())
        shown.id = name
        feedback.publish(shown)
    spin_until(lambda: statuses and statuses[-1].demonstrations == 2, 30.0)
    assert call(UndoFeedback, "undo_feedback").id == "demonstration-2"
    assert call(TrainReward, "train_reward").success
    spin_until(lambda: len(models) == 1, 30.0)
    first.kill()
    start()
    spin_until(lambda: len(models) == 2, 60.0)
    assert models[1].version > models[0].version and models[1].weights == models[0].weights
    answer = call(ListFeedback, "list_feedback")
    assert (list(answer.ids), list(answer.taken_back)) == (["demonstration-1"], ["demonstration-2"])
    shown.header.stamp.sec += 1  # given back
    feedback.publish(shown)
    spin_until(lambda: statuses[-1].demonstrations == 2, 30.0)
    assert call(TrainReward, "train_reward").success


def test_questions_are_chosen_while_the_node_answers(taught_learner, ros_node, spin_until, call):
    taught_learner(query__candidates=3000, training__steps=20)
    assert call(TrainReward, "train_reward").success

    order = []
    futures = []
    for kind, name in ((SelectQuery, "select_query"), (ListFeedback, "list_feedback")):
        client = ros_node.create_client(kind, name)
        spin_until(client.service_is_ready, 30.0)
        futures.append(client.call_async(kind.Request()))
        futures[-1].add_done_callback(lambda _, name=name: order.append(name))
    spin_until(lambda: len(order) == 2, 120.0)
    assert order == ["list_feedback", "select_query"]
    query = futures[0].result()
    assert query.success and len(query.query.options) == 2 and "3000 motions" in query.message, query.message
    assert 0.0 < query.query.information <= 1.0


def test_any_past_motions_can_be_ranked_and_a_ranking_taken_back(start_node, ros_node, spin_until, call):
    files = session_files()
    start_node("reward_learner", {"training.steps": 20}, parameter_files=files)
    statuses, taken = [], []
    ros_node.create_subscription(RewardStatus, "reward_status", statuses.append, subscriber_qos("reward_status"))
    ros_node.create_subscription(Feedback, "feedback", taken.append, subscriber_qos("feedback"))
    feedback = ros_node.create_publisher(Feedback, "feedback", publisher_qos("feedback"))
    runs = ros_node.create_publisher(TrackedRun, "tracked_run", publisher_qos("tracked_run"))
    spin_until(lambda: feedback.get_subscription_count() > 1 and runs.get_subscription_count() > 0, 60.0)
    shown = demonstration(files)
    feedback.publish(shown)
    for name in ("run 1", "run 2"):
        runs.publish(TrackedRun(motion_id=name, measured=shown.demonstration))
    known = ["demo-1", "run 1", "run 2"]
    spin_until(lambda: call(RankMotions, "rank_motions").known == known, 30.0)
    for wrong, ranks, word in ((["run 1", "run 3"], [0, 1], "run 3"), (["run 1"], [0], "two or more"),
                               (["run 1", "run 1"], [0, 1], "different"), (["run 1", "run 2"], [0], "ranks")):
        answer = call(RankMotions, "rank_motions", RankMotions.Request(motions=wrong, ranks=ranks))
        assert not answer.success and word in answer.message
    answer = call(RankMotions, "rank_motions",
                  RankMotions.Request(motions=["run 2", "demo-1", "run 1"], ranks=[1, 0, 1]))
    assert answer.success and answer.known == known, answer.message
    spin_until(lambda: any(f.id == answer.feedback_id for f in taken), 30.0)
    item = next(f for f in taken if f.id == answer.feedback_id)
    assert (item.kind, list(item.ranks), len(item.options)) == (Feedback.PREFERENCE, [1, 0, 1], 3)
    assert list(call(ListFeedback, "list_feedback").ids) == ["demo-1", answer.feedback_id]
    assert call(TrainReward, "train_reward").success
    assert call(UndoFeedback, "undo_feedback").id == answer.feedback_id
