"""Runs the lesson's terminal beside a session that is there already."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import rclpy
from rcl_interfaces.msg import Parameter as ParameterMsg
from rclpy.executors import Executor
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.parameter_client import AsyncParameterClient
from rclpy.signals import SignalHandlerOptions

from unifeed_ros.console.state import LessonView
from unifeed_ros.console.terminal import TeachingTerminal
from unifeed_ros.core.errors import UnifeedError
from unifeed_ros.nodes.lesson_node import LessonNode
from unifeed_ros.nodes.spin import SPIN_S, make_executor

SESSION = "session"
"""Node that is asked which arm and which task are taught."""
PATIENCE_S = 10.0
"""Longest wait for a session [s]."""


class NoSessionError(UnifeedError):
    """There is no session to teach in."""


class TerminalNode(LessonNode):
    """Give the terminal what is known, carry its commands out.

    Args:
        parameters: Those of the session's robot and scene.
        **options: For the node.
    """

    def __init__(self, parameters: Sequence[Parameter], **options: Any) -> None:
        super().__init__("terminal", f"a terminal on {socket.gethostname()} ({os.getpid()})",
                         parameter_overrides=list(parameters), **options)
        self.connect()

    def view(self) -> LessonView:
        """Give what is known; a terminal draws nothing."""
        return replace(super().view(), drawn=False)


def parameters_of_session(node: Node, executor: Executor) -> list[Parameter]:
    """Ask a running session which robot and scene it has.

    Args:
        node: Any node.
        executor: Executor of that node; spun here.

    Returns:
        The parameters.

    Raises:
        NoSessionError: None answers.
    """
    client = AsyncParameterClient(node, SESSION)

    def ask(future: Any) -> Any:
        executor.spin_until_future_complete(future, timeout_sec=PATIENCE_S)
        if not future.done():
            raise NoSessionError("no session answers", expected="a node `session` on this ROS_DOMAIN_ID",
                                 mend="start one with `unifeed up`, or set ROS_DOMAIN_ID")
        return future.result()

    if not client.wait_for_services(timeout_sec=PATIENCE_S):
        raise NoSessionError("no session is running", expected="a node `session` on this ROS_DOMAIN_ID",
                             mend="start one with `unifeed up`, or set ROS_DOMAIN_ID")
    names = list(ask(client.list_parameters(["robot", "scene"], 0)).result.names)
    values = ask(client.get_parameters(names)).values
    pairs = [Parameter.from_parameter_msg(ParameterMsg(name=n, value=v)) for n, v in zip(names, values, strict=True)]
    return [pair for pair in pairs if pair.type_ is not Parameter.Type.NOT_SET]


def run_terminal() -> None:
    """Teach from this terminal until the person leaves it; the session runs on.

    Raises:
        NoSessionError: There is no session.
    """
    rclpy.init(args=["--ros-args", "--disable-stdout-logs"], signal_handler_options=SignalHandlerOptions.NO)
    asking = rclpy.create_node("terminal_asks")
    try:
        executor: Executor = rclpy.executors.SingleThreadedExecutor()
        executor.add_node(asking)
        parameters = parameters_of_session(asking, executor)
        executor.shutdown()
        node = TerminalNode(parameters)
        _run(node, make_executor(node))
    finally:
        asking.destroy_node()
        rclpy.try_shutdown()


def _run(node: TerminalNode, executor: Executor) -> None:
    ended = threading.Event()

    def spin() -> None:
        while not ended.is_set():
            executor.spin_once(timeout_sec=SPIN_S)

    thread = threading.Thread(target=spin, name="terminal", daemon=True)
    thread.start()
    try:
        TeachingTerminal(node).run()
    finally:
        node.close()
        ended.set()
        thread.join()
        executor.shutdown()
        node.destroy_node()
