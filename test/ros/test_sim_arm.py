"""The node sim_arm by itself: what it does with commands that come too late."""

from __future__ import annotations

import time

import numpy as np
import pytest
from sensor_msgs.msg import JointState

from unifeed_ros.core.robot import load_robot
from unifeed_ros.nodes.conversions import header
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos
from unifeed_ros.resources import config_path

FILES = (config_path("robots", "panda"), config_path("tasks", "table"))
ROBOT = load_robot(FILES[0])
OLDER, SPAN_S = 0.2, 1.0
FAR_TOO_MUCH = [40.0] * len(ROBOT.joints)


@pytest.fixture
def states(start_node, ros_node, spin_until):
    """Give the states of a running arm, newest last."""
    heard = []
    ros_node.create_subscription(JointState, "joint_states", heard.append, subscriber_qos("joint_states"))
    start_node("sim_arm", parameter_files=FILES)
    spin_until(lambda: len(heard) > 100, 30.0)
    return heard


def test_a_command_that_answers_an_old_state_neither_moves_the_arm_nor_holds_its_time(states, ros_node, spin_until):
    """A controller that got no processor answers what had waited; the newest states may have been lost meanwhile."""
    commands = ros_node.create_publisher(JointState, "joint_command", publisher_qos("joint_command"))
    first, sent = states[-1], []

    def answer_late():
        if not sent or time.monotonic() - sent[-1] > 0.02:
            sent.append(time.monotonic())
            newest = states[-1].header.stamp
            answered = newest.sec + 1e-9 * newest.nanosec - OLDER
            commands.publish(JointState(header=header(answered), name=list(ROBOT.joints), effort=FAR_TOO_MUCH))
        return sent[-1] - sent[0] > SPAN_S

    spin_until(answer_late, 20.0)
    passed = _seconds(states[-1]) - _seconds(first)
    assert len(sent) > 10 and passed > 0.5 * SPAN_S
    assert np.abs(np.array(states[-1].position) - np.array(first.position)).max() < 0.01


def _seconds(msg):
    return msg.header.stamp.sec + 1e-9 * msg.header.stamp.nanosec

