"""Answers that the middleware dropped because it did not know their reader yet."""

from __future__ import annotations

import sys
import time
import warnings

import pytest
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from unifeed_msgs.action import ExecuteTrajectory
from unifeed_ros.nodes.answers import DROPPED, answer_until_seen


def dropping(times):
    """Give a way to send that is dropped so often, as rclpy tells of it, and the list of its tries."""
    tries = []

    def send():
        tries.append(time.monotonic())
        if len(tries) <= times:
            warnings.warn(f"{DROPPED}: client will not receive response", RuntimeWarning, stacklevel=1)

    return send, tries


def test_an_answer_that_was_dropped_is_sent_again_until_it_is_not(ros_node, spin_until):
    send, tries = dropping(2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer_until_seen(ros_node, send)
        spin_until(lambda: len(tries) == 3, 10.0)
    end = time.monotonic() + 0.5
    spin_until(lambda: time.monotonic() > end)
    assert len(tries) == 3 and not list(ros_node.timers)


def test_it_is_given_up_at_last(ros_node, spin_until):
    send, tries = dropping(100)
    answer_until_seen(ros_node, send, tries=2)
    end = time.monotonic() + 1.0
    spin_until(lambda: time.monotonic() > end)
    assert len(tries) == 2 and not list(ros_node.timers)


def test_other_warnings_are_no_reason_to_send_twice(ros_node):
    sent = []
    answer_until_seen(ros_node, lambda: (sent.append(1), warnings.warn("something else", stacklevel=1)))
    assert sent == [1] and not list(ros_node.timers)


NODE = """
import threading, warnings
from rclpy.impl.implementation_singleton import rclpy_implementation
from std_srvs.srv import Trigger
from unifeed_msgs.action import ExecuteTrajectory
from unifeed_ros.nodes.answers import DROPPED
from unifeed_ros.nodes.deferred import DeferredActionServer
from unifeed_ros.nodes.node import UnifeedNode
from unifeed_ros.nodes.spin import run_node

def drop_first(kind, name):
    send, dropped = getattr(kind, name), set()
    def dropping(self, *arguments):
        if arguments and name not in dropped:
            dropped.add(name)
            warnings.warn(DROPPED + ": client will not receive response", RuntimeWarning, stacklevel=1)
        else:
            send(self, *arguments)
    setattr(kind, name, dropping)

drop_first(rclpy_implementation.Service, "service_send_response")
drop_first(rclpy_implementation.ActionServer, "send_goal_response")
drop_first(rclpy_implementation.ActionServer, "send_result_response")

class Example(UnifeedNode):
    answers_later = {answers_later}

    def __init__(self):
        super().__init__("example")
        self.server = DeferredActionServer(self, ExecuteTrajectory, "act", self.begin)
        self.create_service(Trigger, "ask", self.ask)

    def begin(self, handle):
        self.server.finish(handle, self.conclude)

    def conclude(self, handle):
        handle.succeed()
        return ExecuteTrajectory.Result(success=True, message="done")

    def ask(self, request, response):
        response.message = "heard"
        return response

run_node(Example)
"""


@pytest.mark.parametrize("answers_later", [False, True])
def test_every_service_and_action_of_a_node_does_so(answers_later, start_process, ros_node, spin_until, call):
    start_process([sys.executable, "-c", NODE.replace("{answers_later}", str(answers_later))])
    client = ActionClient(ros_node, ExecuteTrajectory, "act")
    spin_until(client.server_is_ready, 30.0)
    goal = client.send_goal_async(ExecuteTrajectory.Goal())
    spin_until(goal.done, 10.0)
    assert goal.result().accepted
    result = goal.result().get_result_async()
    spin_until(result.done, 10.0)
    assert result.result().result.message == "done"
    client.destroy()
    assert call(Trigger, "ask", timeout=10.0).message == "heard"
