"""A session of real nodes: what they offer, what they answer, and what happens when one of them dies."""

from __future__ import annotations

import importlib
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import start_session

from unifeed_msgs.action import ExecuteTrajectory, OptimizeTrajectory
from unifeed_msgs.msg import LessonState, TeachingState
from unifeed_msgs.srv import AnswerQuery, EvaluateReward, ListFeedback, SelectQuery, SetMode, TrainReward, UndoFeedback
from unifeed_ros.nodes.services import SERVICES
from unifeed_ros.nodes.sim_teacher import DONE
from unifeed_ros.nodes.topics import TOPICS, publisher_qos, subscriber_qos

STARTUP_S = 60.0
"""Longest time in which the nodes of a session find each other on a busy machine [s]."""
OUTSIDE = ("sim_teacher", "console", "terminal")
"""Nodes that these sessions run without."""


class Session:
    """Listens to a session."""

    def __init__(self, node, processes, spin_until):
        self.processes, self.node, self.spin_until = processes, node, spin_until
        self.lesson, self.teaching = LessonState(), TeachingState()
        node.create_subscription(LessonState, "lesson_state", self._on_lesson, subscriber_qos("lesson_state"))
        node.create_subscription(TeachingState, "teaching_state", self._on_teaching, subscriber_qos("teaching_state"))

    def _on_lesson(self, msg):
        self.lesson = msg

    def _on_teaching(self, msg):
        self.teaching = msg

    def wait_phase(self, phase, timeout=60.0):
        self.spin_until(lambda: self.lesson.phase == phase, timeout, lambda: f"(lesson: {self.lesson.message})")

    def act(self, kind, name, goal, cancel_after=None, on_feedback=lambda _: None):
        """Send a goal to an action; gives its result, its status and the number of feedback messages."""
        client = ActionClient(self.node, kind, name)
        news = []
        self.spin_until(client.server_is_ready, 60.0, lambda: f"(action {name})")

        def listen(feedback):
            news.append(feedback)
            on_feedback(feedback)

        sent = client.send_goal_async(goal, feedback_callback=listen)
        self.spin_until(sent.done, 60.0)
        assert sent.result().accepted
        if cancel_after is not None:
            end = time.monotonic() + cancel_after
            self.spin_until(lambda: time.monotonic() > end, cancel_after + 5.0)
            sent.result().cancel_goal_async()
        answer = sent.result().get_result_async()
        self.spin_until(answer.done, 60.0)
        client.destroy()
        return answer.result().result, answer.result().status, len(news)


@pytest.fixture
def session(start_node, ros_node, spin_until, tmp_path):
    """Start a session on the simulated arm, with nobody to teach it, and wait until it is ready."""
    session = Session(ros_node, start_session(start_node, bag=tmp_path / "bag"), spin_until)
    session.wait_phase(LessonState.READY, STARTUP_S)
    return session


def test_the_nodes_are_what_the_tables_say(session, ros_node, spin_until):
    spin_until(lambda: {s.node for s in SERVICES} <= set(ros_node.get_node_names()), 60.0)
    for topic in TOPICS:
        writers = [w for w in topic.writer if w not in OUTSIDE]
        full = topic.name if topic.name.startswith("/") else f"/{topic.name}"
        spin_until(lambda full=full, writers=writers: {p.node_name for p in ros_node.get_publishers_info_by_topic(full)}
                   >= set(writers), 10.0, lambda topic=topic: f"(writers of {topic.name})")
        for end in ros_node.get_publishers_info_by_topic(full):
            if end.node_name in writers:
                wanted = publisher_qos(topic)
                assert end.topic_type == topic.type
                assert (end.qos_profile.reliability, end.qos_profile.durability) == (
                    wanted.reliability,
                    wanted.durability,
                )
        readers = {s.node_name for s in ros_node.get_subscriptions_info_by_topic(full)}
        ours = {r for r in topic.readers if r not in OUTSIDE}
        assert ours <= readers, f"readers of {topic.name}: the table says {sorted(ours)}, there are {sorted(readers)}"
        others = readers - ours - {"recorder_inputs", "test"}
        assert not others, f"{sorted(others)} read {topic.name} and are not in the table"
    offered = dict(ros_node.get_service_names_and_types())
    for service in SERVICES:
        if not service.is_action:
            assert offered[f"/{service.name}"] == [service.type]
        else:
            assert f"/{service.name}/_action/send_goal" in offered


def test_messages_come_at_the_rates_of_the_table(session, ros_node, spin_until):
    counts, first, last = {}, {}, {}

    def counter(name):
        def count(_):
            now = time.monotonic()
            first.setdefault(name, now)
            last[name] = now
            counts[name] = counts.get(name, 0) + 1
        return count

    slow = [t for t in TOPICS if 0 < t.rate <= 100 and "sim_teacher" not in t.writer and t.name != "/diagnostics"]
    for topic in slow:
        package, _, kind = topic.type.split("/")
        message = getattr(importlib.import_module(f"{package}.msg"), kind)
        ros_node.create_subscription(message, topic.name, counter(topic.name), subscriber_qos(topic))
    end = time.monotonic() + 3.0
    spin_until(lambda: time.monotonic() > end, 5.0)
    assert {t.name for t in slow} <= set(counts)
    for topic in slow:
        rate = (counts[topic.name] - 1) / (last[topic.name] - first[topic.name])
        assert 0.3 * topic.rate < rate < 1.6 * topic.rate, (
            f"{topic.name}: {rate:.0f} Hz, the table says {topic.rate:.0f}"
        )


def test_empty_requests_are_answered_with_a_sentence(session, call):
    for kind, name in (
        (TrainReward, "train_reward"),
        (EvaluateReward, "evaluate_reward"),
        (SelectQuery, "select_query"),
        (AnswerQuery, "answer_query"),
        (UndoFeedback, "undo_feedback"),
    ):
        answer = call(kind, name)
        assert not answer.success and len(answer.message) > 10, f"{name}: {answer}"
    nothing = call(ListFeedback, "list_feedback")
    assert nothing.success and nothing.ids == []
    for name in ("finish_demonstration", "save"):
        answer = call(Trigger, name)
        assert not answer.success and answer.message, f"{name}: {answer}"


def test_plans_are_made_refused_and_canceled(session):
    plan, status, news = session.act(OptimizeTrajectory, "optimize_trajectory", OptimizeTrajectory.Goal())
    assert status == 4 and plan.success and plan.status in ("solved", "time_budget") and plan.model_version == 0
    assert len(plan.trajectory.points) > 100 and news > 0
    far = OptimizeTrajectory.Goal()
    far.context.task = "table"
    far.context.goal.x = 3.0
    refused, status, _ = session.act(OptimizeTrajectory, "optimize_trajectory", far)
    assert status == 6 and not refused.success and "out of reach" in refused.message
    outside, status, _ = session.act(
        OptimizeTrajectory, "optimize_trajectory", OptimizeTrajectory.Goal(start=[9.0] * 7)
    )
    assert status == 6 and "outside its limits" in outside.message and "9.000 rad" in outside.message
    nothing, status, _ = session.act(ExecuteTrajectory, "execute_trajectory", ExecuteTrajectory.Goal())
    assert status == 6 and "without positions" in nothing.message


def test_a_motion_is_carried_out_stopped_and_recovered_from(session, call):
    plan, _, _ = session.act(OptimizeTrajectory, "optimize_trajectory", OptimizeTrajectory.Goal())
    done, status, _ = session.act(
        ExecuteTrajectory, "execute_trajectory", ExecuteTrajectory.Goal(trajectory=plan.trajectory)
    )
    assert status == 4 and done.success and not done.touched, done.message
    assert done.tracking_rms < 0.02
    end = np.array(done.executed.points[-1].positions)
    np.testing.assert_allclose(end, np.array(plan.trajectory.points[-1].positions), atol=0.05)

    again, status, _ = session.act(
        ExecuteTrajectory, "execute_trajectory", ExecuteTrajectory.Goal(trajectory=plan.trajectory)
    )
    assert status == 6 and "starts elsewhere" in again.message

    assert call(Trigger, "reset").success
    session.wait_phase(LessonState.RETURNING)
    session.wait_phase(LessonState.READY)
    canceled, status, _ = session.act(ExecuteTrajectory, "execute_trajectory",
                                      ExecuteTrajectory.Goal(trajectory=plan.trajectory), cancel_after=0.5)
    assert (status, canceled.message) == (5, "canceled; the arm holds")
    session.spin_until(lambda: session.teaching.mode == TeachingState.HOLD, 10.0)

    assert call(Trigger, "stop").success
    session.spin_until(lambda: session.teaching.mode == TeachingState.STOPPED, 10.0)
    assert call(SetMode, "set_mode").success
    session.spin_until(lambda: session.teaching.mode == TeachingState.HOLD, 10.0)


def test_a_demonstration_that_is_stopped_says_so_and_begins_anew_after_a_reset(session, call):
    assert call(Trigger, "start_demonstration").success
    session.wait_phase(LessonState.DEMONSTRATING)
    assert call(Trigger, "stop").success
    session.wait_phase(LessonState.FAULT, 5.0)
    assert "called stop" in session.lesson.message and "reset" in session.lesson.message
    assert call(Trigger, "reset").success
    session.wait_phase(LessonState.READY)
    assert call(Trigger, "start_demonstration").success
    session.wait_phase(LessonState.DEMONSTRATING)


def test_pause_and_reset_while_the_arm_moves(session, call):
    assert call(Trigger, "run").success
    session.wait_phase(LessonState.RUNNING)
    assert not call(Trigger, "start_demonstration").success
    assert call(Trigger, "pause").success
    session.wait_phase(LessonState.PAUSED, 5.0)
    assert call(Trigger, "reset").success
    session.wait_phase(LessonState.READY)


@pytest.mark.parametrize("victim", ["reward_learner", "capture"])
def test_a_node_that_dies_is_named_and_the_arm_stops(session, victim):
    session.processes[victim].send(signal.SIGKILL)
    session.wait_phase(LessonState.FAULT, 30.0)
    assert victim in session.lesson.message and "stopped" in session.lesson.message
    session.spin_until(lambda: session.teaching.mode == TeachingState.STOPPED, 10.0)


def test_who_died_is_still_told_when_the_motion_has_been_stopped(start_node, ros_node, spin_until, call):
    """The motion that is stopped because of the death fails too, and must not be told in its place."""
    changes = {"session": {"session.node_timeout": 3.0}}  # at half the speed, noticed before the motion of 6 s ends
    session = Session(ros_node, start_session(start_node, changes=changes, speed=0.5), spin_until)
    session.wait_phase(LessonState.READY, STARTUP_S)
    assert call(Trigger, "run").success
    session.spin_until(lambda: session.teaching.mode == TeachingState.TRACK, 20.0, lambda: session.lesson.message)
    session.processes["reward_learner"].send(signal.SIGKILL)
    session.spin_until(lambda: "reward_learner died" in session.lesson.message, 30.0, lambda: session.lesson.message)
    session.spin_until(lambda: session.teaching.mode == TeachingState.STOPPED, 10.0)
    end = time.monotonic() + 1.0
    session.spin_until(lambda: time.monotonic() > end, 3.0)
    assert session.lesson.phase == LessonState.FAULT and "reward_learner died" in session.lesson.message


def test_a_controller_that_got_no_processor_does_not_blame_the_driver(session):
    plan, _, _ = session.act(OptimizeTrajectory, "optimize_trajectory", OptimizeTrajectory.Goal())
    pauses = []

    def pause(_):
        if not pauses:
            session.processes["shared_control"].send(signal.SIGSTOP)
            time.sleep(0.3)
            session.processes["shared_control"].send(signal.SIGCONT)
        pauses.append(session.teaching.mode)

    done, status, _ = session.act(ExecuteTrajectory, "execute_trajectory",
                                  ExecuteTrajectory.Goal(trajectory=plan.trajectory), on_feedback=pause)
    assert pauses and status == 4 and done.success, done.message


def test_the_arm_stops_when_the_session_dies_in_a_motion(session, call):
    assert call(Trigger, "run").success
    session.spin_until(lambda: session.teaching.mode == TeachingState.TRACK, 20.0)
    session.processes["session"].send(signal.SIGKILL)
    session.spin_until(lambda: session.teaching.mode == TeachingState.STOPPED, 10.0)
    assert "session died" in session.teaching.message or "no joint state" in session.teaching.message


def test_the_arm_holds_itself_when_the_controller_dies(session, ros_node, spin_until):
    from sensor_msgs.msg import JointState

    positions = []
    ros_node.create_subscription(
        JointState, "joint_states", lambda m: positions.append(np.array(m.position)), subscriber_qos("joint_states"))
    spin_until(lambda: len(positions) > 10, 20.0)
    before = positions[-1]
    session.processes["shared_control"].send(signal.SIGKILL)
    end = time.monotonic() + 2.0
    spin_until(lambda: time.monotonic() > end, 4.0)
    assert np.abs(positions[-1] - before).max() < 0.05
    session.wait_phase(LessonState.FAULT, 30.0)
    assert "shared_control" in session.lesson.message


def test_a_person_with_nothing_to_correct_goes_on(start_node, ros_node, spin_until):
    """A push that capture does not take for one changes nothing, as that of a person who likes the motion."""
    deaf = {"contact.on_delay": 1000.0}
    start_session(start_node, taught_by="CC", changes={
        "capture": deaf, "shared_control": deaf, "sim_teacher": {"teacher.attempts": 1}})
    values = {}

    def listen(msg):
        values.update({v.key: v.value for s in msg.status if s.name.endswith("sim_teacher") for v in s.values})

    ros_node.create_subscription(DiagnosticArray, "/diagnostics", listen, publisher_qos("diagnostics"))
    spin_until(lambda: "outcome" in values, STARTUP_S + 60.0)
    assert values == {"outcome": DONE, "passed": "2"}
