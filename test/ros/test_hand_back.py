"""What a session does when a person lets go of the arm that they have pushed aside, and when its controller is lost."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path

import pytest
from geometry_msgs.msg import WrenchStamped
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import session_files, start_session

from unifeed_msgs.msg import Interaction, LessonState, TeachingState, TrackedRun
from unifeed_ros.nodes.table import SessionSetup, node_table
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos

STARTUP_S = 60.0


@pytest.fixture
def heard(ros_node):
    """The newest message of some topics, and all of others."""
    newest = {"lesson_state": LessonState(), "teaching_state": TeachingState()}
    every = {"trajectory": [], "interaction": [], "tracked_run": []}
    for topic, kind in (("lesson_state", LessonState), ("teaching_state", TeachingState)):
        ros_node.create_subscription(kind, topic, lambda m, topic=topic: newest.update({topic: m}),
                                     subscriber_qos(topic))
    for topic, kind in (("trajectory", JointTrajectory), ("interaction", Interaction), ("tracked_run", TrackedRun)):
        ros_node.create_subscription(kind, topic, every[topic].append, subscriber_qos(topic))
    return lambda topic: newest.get(topic, every.get(topic))


def test_the_rest_of_a_motion_goes_on_as_a_push_has_shown_and_a_lost_controller_is_told(
        start_node, ros_node, spin_until, call, heard):
    patient = {"session": {"session.steady": 0.7, "session.hand_back_patience": 20.0}}
    processes = start_session(start_node, changes=patient)
    hand = ros_node.create_publisher(WrenchStamped, "hand_wrench", publisher_qos("hand_wrench"))

    def wait(condition, seconds=60.0):
        spin_until(condition, seconds, lambda: heard("lesson_state").message)

    def push(force, seconds):
        end = time.monotonic() + seconds
        wrench = WrenchStamped()
        wrench.wrench.force.y = force
        while time.monotonic() < end:
            hand.publish(wrench)
            sooner = time.monotonic() + 0.02
            spin_until(lambda sooner=sooner: time.monotonic() > sooner, 5.0)

    wait(lambda: heard("lesson_state").phase == LessonState.READY, STARTUP_S)
    assert call(Trigger, "run").success
    wait(lambda: heard("teaching_state").motion_id.startswith("run") and heard("teaching_state").motion_time > 0.3)
    push(-30.0, 0.8)
    push(0.0, 0.1)
    wait(lambda: heard("teaching_state").motion_id.startswith("rest"))
    wait(lambda: "goes on as shown" in heard("lesson_state").message, 5.0)
    assert heard("lesson_state").phase == LessonState.RUNNING
    wait(lambda: heard("lesson_state").interactions == 1 and heard("lesson_state").phase == LessonState.READY)
    names = [motion.header.frame_id.split()[0] for motion in heard("trajectory")]
    assert names[-5:] == ["run", "rest", "return", "show", "return"], names
    run, rest = heard("trajectory")[-5:-3]
    assert list(rest.points[-1].positions) == pytest.approx(list(run.points[-1].positions), abs=1e-3)
    assert list(rest.points[0].positions) != pytest.approx(list(run.points[0].positions), abs=0.05)
    [interaction] = heard("interaction")
    assert interaction.kind == 2 and list(interaction.feedback_ids) == ["correction-1"] and not interaction.touched
    assert 0.1 < interaction.feedback_to_motion_s < 30.0
    runs = {run.motion_id.split()[0]: list(run.feedback_ids) for run in heard("tracked_run")}
    assert runs["run"] == ["correction-1"] and runs["rest"] == []

    assert call(Trigger, "run").success
    wait(lambda: heard("teaching_state").mode == TeachingState.TRACK)
    processes["shared_control"].send(signal.SIGKILL)
    specs = node_table(SessionSetup(parameter_files=session_files()))
    spec = next(spec for spec in specs if spec.executable == "shared_control")
    start_node("shared_control", spec.parameters, parameter_files=spec.parameter_files)
    wait(lambda: heard("lesson_state").phase == LessonState.FAULT)
    assert "shared_control was started anew" in heard("lesson_state").message
    assert call(Trigger, "reset").success
    wait(lambda: heard("lesson_state").phase == LessonState.READY)
