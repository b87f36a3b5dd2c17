"""Call services and actions from a thread beside the executor, and stop waiting when the person interrupts."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from rclpy.action import ActionClient
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from unifeed_ros.core.errors import UnifeedError

SERVER_S = 5.0
"""Longest wait for a server to appear [s]."""
POLL_S = 0.05
"""Time between two looks at the interrupt [s]."""


class LessonError(UnifeedError):
    """A step of the lesson that did not succeed; the arm has been stopped or holds."""


class Interrupted(Exception):
    """The person paused or reset the lesson while a step was under way."""


@dataclass(frozen=True)
class Action:
    """An action that goes on."""

    handle: Any
    """Its goal's handle."""
    result: Future
    """Done when it has ended."""


class Waiting:
    """Send requests and wait for their answers in a thread that is not the executor's.

    Args:
        node: Whose executor completes the futures.
        fault_of: Gives the sentence of a fault that makes waiting useless, or an empty one.
    """

    def __init__(self, node: Node, fault_of: Callable[[], str]) -> None:
        self._node, self._fault_of = node, fault_of
        self.interrupt = threading.Event()
        """Set it to end every wait with Interrupted; the thread that waits clears it."""

    def call(self, client: Client, request: Any, timeout: float) -> Any:
        """Call a service.

        Args:
            client: Its client.
            request: The request.
            timeout: Longest wait for the answer [s].

        Returns:
            The response.

        Raises:
            LessonError: The service is not there, or does not answer in time.
            Interrupted: The person interrupted.
        """
        if not client.wait_for_service(timeout_sec=SERVER_S):
            raise LessonError(f"service {client.srv_name} is not there", mend="start its node, then reset")
        return self.answer(client.call_async(request), timeout, client.srv_name)

    def act(self, client: ActionClient, goal: Any, timeout: float) -> tuple[Any, int]:
        """Send a goal to an action and wait for its end; an interrupt cancels it.

        Args:
            client: Its client.
            goal: The goal.
            timeout: Longest wait for the result [s].

        Returns:
            Result and status.

        Raises:
            LessonError: The action is not there, refuses the goal, or does not end in time.
            Interrupted: The person interrupted.
        """
        return self.end(self.begin(client, goal), timeout)

    def begin(self, client: ActionClient, goal: Any) -> Action:
        """Send a goal to an action.

        Args:
            client: Its client.
            goal: The goal.

        Returns:
            What goes on now.

        Raises:
            LessonError: The action is not there, or refuses the goal.
            Interrupted: The person interrupted.
        """
        if not client.wait_for_server(timeout_sec=SERVER_S):
            raise LessonError("an action is not there", mend="start its node, then reset")
        handle = self.answer(self._in_executor(lambda: client.send_goal_async(goal)), 15.0, "action goal")
        if not handle.accepted:
            raise LessonError("motion refused by the controller or the optimizer", mend="see its log; reset goes on")
        return Action(handle, self._in_executor(handle.get_result_async))

    def end(self, action: Action, timeout: float | None) -> tuple[Any, int]:
        """Wait for the end of an action; an interrupt cancels it.

        Args:
            action: What goes on.
            timeout: Longest wait [s]; None: no limit.

        Returns:
            Result and status.

        Raises:
            LessonError: There is a fault, or it does not end in time.
            Interrupted: The person interrupted.
        """
        try:
            answer = self.answer(action.result, timeout, "action result")
        except Interrupted:
            self._in_executor(action.handle.cancel_goal_async)
            raise
        if self.interrupt.is_set():
            raise Interrupted
        return answer.result, answer.status

    def answer(self, future: Future, timeout: float | None, what: str) -> Any:
        """Wait for a future that the executor completes.

        Args:
            future: The future.
            timeout: Longest wait [s]; None: no limit.
            what: What answers, for the error.

        Returns:
            Its result.

        Raises:
            LessonError: There is a fault, or it does not come in time.
            Interrupted: The person interrupted.
        """
        done = threading.Event()
        future.add_done_callback(lambda _: done.set())
        deadline = None if timeout is None else time.monotonic() + timeout
        while not done.wait(POLL_S):
            if self.interrupt.is_set():
                raise Interrupted
            if fault := self._fault_of():
                raise LessonError(fault)
            if deadline is not None and time.monotonic() > deadline:
                raise LessonError(f"{what} did not answer", expected=f"within {timeout} s", mend="reset goes on")
        return future.result()

    def next(self, items: queue.Queue[Any], wanted: Callable[[Any], bool], timeout: float | None,
             ended: Callable[[], bool] = lambda: False) -> Any:
        """Take items out of a queue until a wanted one comes.

        Args:
            items: The queue.
            wanted: Says whether an item is the one waited for; others are dropped.
            timeout: Longest wait [s]; None: no limit.
            ended: Says when none can come any more.

        Returns:
            The item.

        Raises:
            queue.Empty: It did not come in time.
            LessonError: There is a fault.
            Interrupted: The person interrupted.
        """
        deadline = float("inf") if timeout is None else time.monotonic() + timeout
        while time.monotonic() < deadline and not ended():
            if self.interrupt.is_set():
                raise Interrupted
            if fault := self._fault_of():
                raise LessonError(fault)
            try:
                item = items.get(timeout=POLL_S)
            except queue.Empty:
                continue
            if wanted(item):
                return item
        raise queue.Empty

    def _in_executor(self, send: Callable[[], Future]) -> Future:
        """Send a request of an action from the executor's thread.

        rclpy's action client notes a request only after it has sent it: an answer that the executor's thread takes in
        between is dropped ("unexpected goal response"), and the request waits for ever.
        """
        sent: queue.Queue[Future] = queue.Queue()
        self._node.executor.create_task(lambda: sent.put(send()))
        try:
            return sent.get(timeout=5.0)
        except queue.Empty:
            raise LessonError("the node is too busy to send a request", mend="reset goes on") from None
