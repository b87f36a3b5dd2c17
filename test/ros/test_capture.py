"""The node `capture` on topics."""

from __future__ import annotations

import signal
import time
from itertools import pairwise

from rcl_interfaces.srv import GetParameters
from rclpy.serialization import serialize_message
from sensor_msgs.msg import JointState

from unifeed_msgs.msg import Contact
from unifeed_msgs.srv import ListFeedback
from unifeed_ros.nodes.capture import highest_numbers
from unifeed_ros.nodes.conversions import seconds, stamp
from unifeed_ros.nodes.topics import publisher_qos, subscriber_qos

from .session_helpers import session_files

NAMES = [f"panda_joint{k}" for k in range(1, 8)]


def test_samples_that_came_while_it_had_no_processor_are_not_lost(ros_node, start_node, spin_until, call):
    capture = start_node("capture", parameter_files=session_files())
    heard = []
    ros_node.create_subscription(
        Contact, "contact", lambda msg: heard.append(seconds(msg.header.stamp)), subscriber_qos("contact", depth=1000))
    torques, states = (ros_node.create_publisher(JointState, topic, publisher_qos(topic))
                       for topic in ("external_torques", "joint_states"))
    spin_until(lambda: torques.get_subscription_count() > 0 and states.get_subscription_count() > 0
               and ros_node.count_publishers("contact") > 0)

    def publish(topic, **values):
        message = JointState(name=NAMES, **values)
        message.header.stamp = stamp(at[0])
        topic.publish(serialize_message(message))

    def is_followed():  # the first messages may come before the node has discovered who sends them
        at[0] += 0.001
        publish(states, position=[0.0, -0.4, 0.0, -2.0, 0.0, 1.6, 0.8], velocity=[0.0] * 7)
        publish(torques, effort=[0.0] * 7)
        return bool(heard)

    at = [1.0]
    spin_until(is_followed)
    call(GetParameters, "capture/get_parameters")  # its answer comes when all this has been taken
    heard.clear()
    begun = at[0]
    capture.send(signal.SIGSTOP)
    for _ in range(200):
        at[0] += 0.001
        publish(torques, effort=[0.0] * 7)
    time.sleep(0.1)
    capture.send(signal.SIGCONT)
    spin_until(lambda: bool(heard) and heard[-1] > begun + 0.18, 20.0, lambda: str(heard))
    assert max(b - a for a, b in pairwise(heard)) < 0.02, heard
    assert heard[0] < begun + 0.02


def test_names_count_on_from_what_was_taught_before_the_node_began(ros_node, start_node, spin_until):
    asked = []

    def answer(request, response):
        asked.append(request)
        return response

    ros_node.create_service(ListFeedback, "list_feedback", answer)
    start_node("capture", parameter_files=session_files())
    spin_until(lambda: bool(asked), 60.0)
    assert highest_numbers(["demonstration-2", "correction-1", "demonstration-10", "preference-query-3", "mine"]) == {
        "demonstration": 10, "correction": 1, "preference-query": 3}
