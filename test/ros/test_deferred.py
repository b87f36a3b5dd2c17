"""Answers that take long: the node neither stops nor keeps a core busy until they come."""

from __future__ import annotations

import sys

import pytest
from rclpy.action import ActionClient
from std_srvs.srv import Trigger

from unifeed_msgs.action import ExecuteTrajectory

NODE = """
import threading, time
from concurrent.futures import Future
from rclpy.node import Node
from std_srvs.srv import Trigger
from unifeed_msgs.action import ExecuteTrajectory
from unifeed_ros.nodes.deferred import DeferredActionServer, patiently
from unifeed_ros.nodes.spin import run_node

LONG_S = 1.0

class Example(Node):
    answers_later = {answers_later}

    def __init__(self):
        super().__init__("example")
        self.server = DeferredActionServer(self, ExecuteTrajectory, "act", self.begin)
        self.create_service(Trigger, "ask", self.ask)

    def begin(self, handle):
        began = time.process_time()
        def finish():
            while time.monotonic() < end and not handle.is_cancel_requested:
                time.sleep(0.02)
            self.server.finish(handle, lambda _: self.conclude(handle, began))
        end = time.monotonic() + LONG_S
        threading.Thread(target=finish).start()

    def conclude(self, handle, began):
        canceled = handle.is_cancel_requested
        handle.canceled() if canceled else handle.succeed()
        return ExecuteTrajectory.Result(success=not canceled, tracking_rms=time.process_time() - began)

    async def ask(self, request, response):
        done, began = Future(), time.process_time()
        threading.Timer(LONG_S, lambda: done.set_result("done")).start()
        response.success = await patiently(done) == "done"
        response.message = str(time.process_time() - began)
        return response

run_node(Example)
"""
FEW_CPU_S = 0.4
"""Processor time that one second of waiting may take [s]; a coroutine that is asked all the time takes one second."""


@pytest.fixture
def act(ros_node, spin_until):
    """Send a goal: result and status; with a condition it is canceled once that holds."""
    client = ActionClient(ros_node, ExecuteTrajectory, "act")

    def send(cancel=False):
        spin_until(client.server_is_ready)
        sent = client.send_goal_async(ExecuteTrajectory.Goal())
        spin_until(sent.done)
        answer = sent.result().get_result_async()
        if cancel:
            sent.result().cancel_goal_async()
        spin_until(answer.done)
        return answer.result().result, answer.result().status

    yield send
    client.destroy()


@pytest.mark.parametrize("answers_later", [False, True], ids=["events", "single"])
def test_a_goal_that_takes_long_costs_no_processor_and_ends_as_it_says(start_process, act, answers_later):
    start_process([sys.executable, "-c", NODE.format(answers_later=answers_later)])
    result, status = act()
    assert (status, result.success) == (4, True) and result.tracking_rms < FEW_CPU_S
    result, status = act(cancel=True)
    assert (status, result.success) == (5, False)


def test_a_service_that_takes_long_costs_no_processor(start_process, call):
    start_process([sys.executable, "-c", NODE.format(answers_later=True)])
    answer = call(Trigger, "ask")
    assert answer.success and float(answer.message) < FEW_CPU_S
