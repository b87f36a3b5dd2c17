"""Each source of external torque through real nodes: one setting, and a push of the hand is a contact in `contact`."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import numpy as np
import pytest
from geometry_msgs.msg import WrenchStamped
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
from rclpy.action import ActionClient

sys.path.insert(0, str(Path(__file__).parent))
from session_helpers import session_files

from unifeed_msgs.action import ExecuteTrajectory
from unifeed_msgs.msg import Contact, TeachingState, TrackedRun
from unifeed_msgs.srv import SetMode
from unifeed_ros.core.robot import RobotModel, load_robot
from unifeed_ros.core.types import Trajectory
from unifeed_ros.nodes.conversions import seconds, trajectory_to_msg, wrench_to_msg
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.resources import config_path

FRICTION = "[0.4, 0.4, 0.4, 0.4, 0.2, 0.15, 0.1]"
SOURCES = {
    "field": {"external_torque.type": "std_msgs/msg/Float64MultiArray", "external_torque.field": "data",
              "external_torque.topic": "tau_ext"},
    "wrench": {},
    "momentum": {"external_torque.momentum.dry_friction": FRICTION,
                 "external_torque.momentum.viscous_friction": "[0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0.5]",
                 "external_torque.momentum.rotor_inertia": "[0.1, 0.1, 0.1, 0.1, 0.1, 0.1, 0.1]"}}


class Hand:
    """Push the tool and listen to what becomes of it."""

    def __init__(self, node, spin_until):
        self.contacts, self.modes, self.runs = [], [], []
        self._node, self._spin_until = node, spin_until
        self._wrenches = node.create_publisher(WrenchStamped, "hand_wrench", publisher_qos("hand_wrench"))
        node.create_subscription(Contact, "contact", self.contacts.append, subscriber_qos("contact"))
        node.create_subscription(TeachingState, "teaching_state", self.modes.append, subscriber_qos("teaching_state"))
        node.create_subscription(TrackedRun, "tracked_run", self.runs.append, subscriber_qos("tracked_run"))

    def push_until(self, condition, force, timeout=40.0):
        """Push until something happens."""
        def pushed():
            self._wrenches.publish(wrench_to_msg(np.array([*force, 0.0, 0.0, 0.0]), 0.0, "panda_link0"))
            return condition()
        self._spin_until(pushed, timeout)

    def wait(self, condition, timeout=40.0):
        """Let things happen."""
        self._spin_until(condition, timeout, lambda: f"({self.modes[-1].message})" if self.modes else "")


@pytest.fixture
def hand(ros_node, spin_until):
    return Hand(ros_node, spin_until)


@pytest.mark.timeout(150)
@pytest.mark.parametrize("source", sorted(SOURCES))
def test_a_push_is_a_contact_whatever_the_driver_offers(start_node, hand, source):
    parameters = {"external_torque.source": source, **SOURCES[source]}
    for name in ("sim_arm", "capture"):
        start_node(name, parameters, parameter_files=session_files())
    hand.wait(lambda: len(hand.contacts) > 150)
    assert {c.kind for c in hand.contacts} == {Contact.NONE}
    hand.push_until(lambda: hand.contacts[-1].kind != Contact.NONE, (0.0, 15.0, 0.0))
    touched = hand.contacts[-1]
    assert touched.kind == Contact.TOUCH and touched.link_joint == f"panda_joint{touched.link}"
    assert 0.0 <= seconds(touched.header.stamp) - seconds(touched.onset) < 0.3
    hand.wait(lambda: hand.contacts[-1].kind == Contact.NONE)
    free = next(c for c in reversed(hand.contacts) if c.kind == Contact.NONE)
    assert seconds(free.release) > seconds(touched.onset)


@pytest.mark.timeout(100)
@pytest.mark.parametrize(("settings", "word"), [
    ({"source": "field", "type": "no_such_msgs/msg/State", "field": "tau"}, "no_such_msgs"),
    ({"source": "field", "type": "std_msgs/msg/Float64MultiArray", "field": "tau"}, "field tau"),
    ({"source": "wrench", "frame": "tool0_controller"}, "tool0_controller")])
def test_a_source_that_cannot_work_is_refused_at_the_start(start_node, settings, word):
    node = start_node("capture", {f"external_torque.{key}": value for key, value in settings.items()},
                      parameter_files=session_files())
    assert node.wait(60.0) == 2
    assert word in node.output and len(node.output.strip().splitlines()) == 1


@pytest.mark.timeout(150)
def test_a_hit_stops_the_arm_and_nothing_is_learned_from_it(start_node, ros_node, hand, call, spin_until):
    for name in ("sim_arm", "capture", "shared_control"):
        start_node(name, parameter_files=session_files())
    for step in (Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE):
        request = ChangeState.Request(transition=Transition(id=step))
        assert call(ChangeState, "shared_control/change_state", request).success
    hand.wait(lambda: len(hand.contacts) > 100 and hand.modes)
    assert call(SetMode, "set_mode").success
    robot = RobotModel(load_robot(config_path("robots", "panda")))
    start = np.array(hand.modes[-1].positions)
    way = np.zeros(robot.n)
    way[0] = 1.0
    shape = (1.0 - np.cos(np.pi * np.linspace(0.0, 1.0, 50))) / 2.0
    motion = Trajectory(joint_names=robot.joint_names, times=np.linspace(0.0, 6.0, 50),
                        positions=start + np.outer(shape, way))
    client = ActionClient(ros_node, ExecuteTrajectory, "execute_trajectory")
    spin_until(client.server_is_ready)
    sent = client.send_goal_async(ExecuteTrajectory.Goal(trajectory=trajectory_to_msg(motion), motion_id="hit"))
    spin_until(sent.done)
    assert sent.result().accepted
    hand.wait(lambda: hand.modes[-1].mode == TeachingState.TRACK and hand.modes[-1].motion_time > 1.0)
    begun = time.monotonic()
    hand.push_until(lambda: hand.modes[-1].mode == TeachingState.STOPPED or time.monotonic() > begun + 20.0,
                    (0.0, 0.0, 70.0))  # upwards the heavy joints take it: none is too fast before it stops
    assert hand.modes[-1].mode == TeachingState.STOPPED
    assert "hit the arm" in hand.modes[-1].message
    hand.wait(lambda: hand.runs)
    [run] = hand.runs
    assert run.motion_id == "hit" and not run.feedback_ids
    assert len(run.motion_times) == len(run.in_contact) == len(run.measured.points)
