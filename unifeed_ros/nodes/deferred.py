"""Answers that take long, given without waiting.

rclpy resumes a coroutine that waits for a future again and again until the future is done: one such coroutine
keeps a whole core busy for as long as it waits.
"""

from __future__ import annotations

import concurrent.futures
import types
from collections.abc import Callable, Generator
from typing import Any

from rclpy.action import ActionServer, CancelResponse
from rclpy.action.server import ServerGoalHandle
from rclpy.node import Node
from rclpy.task import Future

from unifeed_ros.nodes.answers import answer_until_seen, noticing_drops

POLL_S = 0.005
"""Time between two looks at a future; the rest of the node waits as long [s]."""


class DeferredActionServer(ActionServer):
    """An action server whose goals begin by a call and end by another one, whenever it comes; any goal may be canceled.

    Args:
        node: Whose action it is.
        kind: Type of the action.
        name: Name of the action.
        begin: Called with each goal that was accepted; its state is executing then. It returns at once.
        **options: The rest of ActionServer's arguments.
    """

    def __init__(self, node: Node, kind: Any, name: str, begin: Callable[[ServerGoalHandle], None],
                 **options: Any) -> None:
        super().__init__(node, kind, name, begin, cancel_callback=lambda _: CancelResponse.ACCEPT, **options)
        self._asked_node, self._begin_goal = node, begin

    def notify_execute(self, goal_handle: ServerGoalHandle, execute_callback: Callable[..., Any] | None) -> None:
        """Begin a goal; rclpy calls this when the goal has been accepted."""
        self._begin_goal(goal_handle)

    def finish(self, handle: ServerGoalHandle, conclude: Callable[[ServerGoalHandle], Any]) -> None:
        """End a goal; may be called from any thread.

        Args:
            handle: The goal.
            conclude: Called by the executor; sets the goal's last state and gives the result.
        """
        super().notify_execute(handle, conclude)

    async def _execute_goal_request(self, request: Any) -> None:
        """Decide on a goal; the answer also reaches a client that this process has not discovered yet."""
        header, goal = request

        def again() -> None:
            answer = self.action_type.Impl.SendGoalService.Response()
            answer.accepted = bytes(goal.goal_id.uuid) in self._goal_handles
            answer.stamp = self._asked_node.get_clock().now().to_msg()
            self._handle.send_goal_response(header, answer)

        with noticing_drops(self._asked_node, again):
            await super()._execute_goal_request(request)

    def _send_result_response(self, header: Any, result: Future) -> None:
        answer_until_seen(self._asked_node, lambda: super(DeferredActionServer, self)._send_result_response(
            header, result))


@types.coroutine
def patiently(future: concurrent.futures.Future[Any]) -> Generator[None, None, Any]:
    """Await a future, with a short sleep between two looks.

    Args:
        future: What another thread completes.

    Returns:
        Its result; raises its exception.
    """
    while not future.done():
        concurrent.futures.wait([future], POLL_S)
        yield
    return future.result()
